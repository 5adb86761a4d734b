"""Tasks of one job in several processes: this process and workers, which it starts, feeds, listens to and ends."""

import logging
import multiprocessing
import pickle
import signal
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, Self, TypeVar

from estlab.errors import WorkerLostError
from estlab.parallel import cores, worker
from estlab.parallel.signals import ENDING

R = TypeVar("R")
OnStep = Callable[[], None]
Work = Callable[[int, OnStep], R]

_EVERY = 0.05  # seconds between checks for messages from workers
_AHEAD = 2  # tasks that a worker holds at a time, so that it need not wait for this process
# Seconds of remaining work from which it pays to start workers that import everything, a quarter of a second each.
_WORTH = 1.0


class Workers(Generic[R]):
    """Processes that share the tasks of a job with this one. Each takes the next task when it finishes one.

    work: does a task, given its number and a callback for each step; results are pickled. tasks: their numbers; this
    process does the first. wanted: how many processes, this one included; None for as many as there are cores and
    tasks, if they pay.

    A process with one thread is forked, which takes 5 ms: its workers start at once. Otherwise, and on systems other
    than Linux, workers import everything. Unless they are wanted, they start only when the first task has shown that
    they pay.
    """

    def __init__(self, work: Work[R], tasks: Sequence[int], wanted: int | None) -> None:
        self._work, self.tasks, self._left = work, tasks, tasks[1:]
        self._processes: dict[Connection, BaseProcess] = {}
        self._given: Counter[Connection] = Counter()
        self._finished: list[tuple[int, R]] = []
        self._steps: Callable[[int], None] = lambda count: None
        self._heard = 0.0
        self._most = cores.processes(wanted, len(tasks))
        self.cores = 1  # processes at work, this one included
        self._forks = can_fork()
        self._at_once = self._forks or wanted is not None

    def __enter__(self) -> Self:
        cores.keep_memory()
        if self._at_once:
            self._start()
        return self

    def __exit__(self, error: object, *_: object) -> None:
        self._end(at_once=error is not None)

    def results(self, here: Work[R], steps: Callable[[int], None]) -> Iterator[tuple[int, R]]:
        """The number and result of each task, as they arrive.

        here: the work as this process does it. steps: called with the number of steps done, here or elsewhere.

        Raises what the work raises, in any process, and WorkerLostError for a worker that died.
        """
        self._steps = steps
        for number in self.tasks[:1]:
            began = time.monotonic()
            result = here(number, self._on_step)
            if self.cores == 1 and (time.monotonic() - began) * len(self._left) > _WORTH:
                self._start()
            yield number, result
        while self._left or self._given.total() or self._finished:
            # While a task ran here, workers may have finished any number of theirs.
            if self._finished:
                yield self._finished.pop(0)
            elif self._left:
                number, self._left = self._left[0], self._left[1:]
                yield number, here(number, self._on_step)
                self._hear(0.0)
            else:
                self._hear(None)

    def _on_step(self) -> None:
        self._steps(1)
        if self._processes and time.monotonic() - self._heard > _EVERY:
            self._hear(0.0)

    def _start(self) -> None:
        """Start the workers and give them tasks: one to each before a second to any."""
        if self._most == 1:
            return
        context: Any = multiprocessing.get_context("fork" if self._forks else "spawn")
        if not self._forks:
            resource_tracker.ensure_running()  # it would let signals through in the body below
        try:
            for _ in range(self._most - 1):
                ours, theirs = context.Pipe()
                process = context.Process(target=worker.serve, args=(self._work, theirs), daemon=True)
                with signals_held(), _script_left_out():
                    process.start()
                    self._processes[ours] = process
                theirs.close()
            self.cores = self._most
            for _ in range(_AHEAD):
                for end in self._processes:
                    self._give(end)
        except BaseException:
            self._end(at_once=True)
            raise

    def _give(self, end: Connection) -> None:
        if self._left:
            number, self._left = self._left[0], self._left[1:]
            self._given[end] += 1
            try:
                end.send(number)
            except OSError as error:
                raise self._lost(end) from error

    def _hear(self, timeout: float | None) -> None:
        """Receive messages from workers, waiting at most so long for the first one."""
        self._heard = time.monotonic()
        for end in wait(list(self._processes), timeout):
            assert isinstance(end, Connection)
            try:
                kind, content = end.recv()
            except (EOFError, OSError) as error:
                raise self._lost(end) from error
            self._receive(end, kind, content)

    def _receive(self, end: Connection, kind: str, content: Any) -> None:
        if kind == worker.STEPS:
            self._steps(content)
        elif kind == worker.DONE:
            self._given[end] -= 1
            self._finished.append(content)
            self._give(end)
        elif kind == worker.FAILED:
            raise pickle.loads(content)
        elif kind == worker.WARNING:
            warnings.warn_explicit(**content)
        elif kind == worker.LOG and (logger := logging.getLogger(content.name)).isEnabledFor(content.levelno):
            logger.handle(content)

    def _lost(self, end: Connection) -> WorkerLostError:
        process = self._processes[end]
        process.join(1.0)
        code = process.exitcode
        how = f"exit code {code}"
        if code is not None and code < 0:
            how = signal.Signals(-code).name
        if code == -signal.SIGKILL:
            how += ", as the system does when memory runs out"
        return WorkerLostError(f"a worker process ended by {how}; set cores=1 or a smaller block_runs")

    def _end(self, at_once: bool) -> None:
        """End the workers, by force if necessary."""
        for end, process in self._processes.items():
            if at_once:
                process.kill()
            with suppress(OSError):
                end.send(None)
        for end, process in self._processes.items():
            process.join()
            process.close()
            end.close()
        self._processes.clear()


def can_fork() -> bool:
    """Whether this process has only one thread, so that no lock is held that nobody in the child would release."""
    return sys.platform == "linux" and len(list(Path("/proc/self/task").iterdir())) == 1


@contextmanager
def _script_left_out() -> Iterator[None]:
    """A worker that imports everything does not import the script that runs: none of its tasks is in there.

    A script that calls estlab.run, and does not ask whether it is the main module, would run it in each worker again.
    """
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


@contextmanager
def signals_held() -> Iterator[None]:
    """Defer interruptions: a worker that is just starting does not handle them yet."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
