"""Jobs of a sweep on all cores of this machine: forked from the sweep's process, each worker runs job after job."""

import multiprocessing
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Self

from estlab.parallel.pool import can_fork, signals_held
from estlab.parallel.signals import ENDING
from estlab.parallel.worker import end_with_parent

_PATIENCE = 10.0  # seconds that a job has to say that it was interrupted

Work = Callable[[int], str]


class Forked:
    """Workers that are warm: what a job imports, they have. They are forked before this process has a second thread.

    work: what is done to a job, by its number; it gives the reason why the job never began, if it did not.
    """

    def __init__(self, work: Work, jobs: int, workers: int) -> None:
        self._work, self._jobs, self._count = work, jobs, workers
        self._workers: dict[Connection, BaseProcess] = {}

    def __enter__(self) -> Self:
        if self._count > 1 and can_fork():
            try:
                for _ in range(self._count):
                    self._start()
            except BaseException:
                self._end()
                raise
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    @property
    def ready(self) -> bool:
        """Whether there are workers."""
        return bool(self._workers)

    def run(self) -> dict[int, str]:
        """Do all jobs, as far as workers live; the reasons of those that never began."""
        waiting, reasons = list(range(self._jobs)), {}
        for worker in self._workers:
            self._give(worker, waiting)
        while self._workers:
            for end in wait(list(self._workers)):
                assert isinstance(end, Connection)
                try:
                    number, reason = end.recv()
                except (EOFError, OSError):  # it is done, or was killed, which the status of its job says
                    self._workers.pop(end).join()
                    end.close()
                    continue
                if reason:
                    reasons[number] = reason
                self._give(end, waiting)
        return reasons

    def _give(self, end: Connection, waiting: list[int]) -> None:
        """The next job, or none if there is none left."""
        with suppress(OSError):  # it is gone, as its end of the pipe says too
            end.send(waiting.pop(0) if waiting else None)

    def _start(self) -> None:
        context: Any = multiprocessing.get_context("fork")
        ours, theirs = context.Pipe()
        # Not of the kind that may start no processes: a job with a limit on its time is one of its own.
        process = context.Process(target=_serve, args=(self._work, theirs))
        with signals_held():
            process.start()
            self._workers[ours] = process
        theirs.close()

    def _end(self) -> None:
        """Interrupt what is still at work, and end it if that takes long."""
        for process in self._workers.values():
            process.terminate()
        for end, process in self._workers.items():
            process.join(_PATIENCE)
            if process.is_alive():
                process.kill()
                process.join()
            end.close()
        self._workers.clear()


def _serve(work: Work, end: Connection) -> None:
    """In a worker: do the jobs whose numbers come. It ends when its parent does, however that ends."""
    threading.Thread(target=end_with_parent, daemon=True).start()
    # What interrupts all processes of a terminal comes to the parent, which ends each of its workers, once.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
    with suppress(KeyboardInterrupt, EOFError, OSError):
        while (number := end.recv()) is not None:
            end.send((number, work(number)))
