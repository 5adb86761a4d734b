"""What a worker process does: pieces of a job, as they are given to it, until it is told that nothing is left."""

import logging
import logging.handlers
import multiprocessing
import os
import pickle
import threading
import time
import traceback
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, NoReturn

from estlab.errors import frames
from estlab.parallel import cores
from estlab.parallel.signals import left_to_parent

STEPS, DONE, FAILED, WARNING, LOG = "steps", "done", "failed", "warning", "log"

_EVERY = 0.05  # seconds between words on how far it is


def serve(work: Callable[[int, Callable[[], None]], Any], end: Connection) -> None:
    """Do the pieces whose numbers come and say what became of them. It ends when its parent does, however that ends."""
    left_to_parent()
    cores.keep_memory()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    voice = _Voice(end)
    voice.speak_for_the_process()
    while (number := _next(end)) is not None:
        try:
            voice.say(DONE, (number, work(number, voice.tick)))
        except (Exception, SystemExit) as error:
            voice.say(FAILED, _portable(error))


def _next(end: Connection) -> int | None:
    try:
        return end.recv()
    except (EOFError, OSError):
        os._exit(1)  # the parent is gone


class _Voice:
    """What a worker says to its parent."""

    def __init__(self, end: Connection) -> None:
        self._end, self._count, self._last = end, 0, time.monotonic()

    def say(self, what: str, said: Any) -> None:
        """Say it, the steps done before it first. A worker that nobody hears ends."""
        if what != STEPS:
            self._say_steps()
        message = pickle.dumps((what, said), pickle.HIGHEST_PROTOCOL)
        try:
            self._end.send_bytes(message)
        except OSError:
            os._exit(1)

    def tick(self) -> None:
        """Count a step."""
        self._count += 1
        if time.monotonic() - self._last > _EVERY:
            self._say_steps()

    def _say_steps(self) -> None:
        count, self._count, self._last = self._count, 0, time.monotonic()
        if count:
            self.say(STEPS, count)

    def speak_for_the_process(self) -> None:
        """Warnings and what is logged go to the parent, which knows what to do with them."""

        def show(
            message: Any, category: Any, filename: str, lineno: int, file: object = None, line: object = None
        ) -> None:
            self.say(WARNING, {"message": message, "category": category, "filename": filename, "lineno": lineno})

        warnings.showwarning = show
        logging.getLogger().handlers = [_Handler(self)]
        ours = logging.getLogger("estlab")
        ours.handlers, ours.propagate = [], True
        ours.setLevel(logging.INFO)


class _Handler(logging.handlers.QueueHandler):
    """Hands records on, their messages formatted so that they can be pickled."""

    def __init__(self, voice: _Voice) -> None:
        super().__init__(voice)  # type: ignore[arg-type]
        self._voice = voice

    def enqueue(self, record: logging.LogRecord) -> None:
        self._voice.say(LOG, record)


def _portable(error: BaseException) -> bytes:
    """The error, with its traceback as a note, or what it says where it cannot be pickled."""
    error.add_note(f"in a worker process:\n{''.join(traceback.format_exception(error))}")
    error.frames_in_worker = frames(error)  # type: ignore[attr-defined]
    try:
        carried = pickle.dumps(error)
        pickle.loads(carried)
    except Exception:
        said = RuntimeError(f"{type(error).__name__}: {error}")
        said.frames_in_worker = frames(error)  # type: ignore[attr-defined]
        return pickle.dumps(said)
    return carried


def _end_with_parent() -> NoReturn:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
