"""A worker process: does the tasks that it receives until there are none left."""

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

_EVERY = 0.05  # seconds between progress messages


def serve(work: Callable[[int, Callable[[], None]], Any], end: Connection) -> None:
    """Do the tasks whose numbers arrive and send their results. Ends when its parent does, however that ends."""
    left_to_parent()
    cores.keep_memory()
    threading.Thread(target=end_with_parent, daemon=True).start()
    messages = _Messages(end)
    messages.take_over_logging()
    with cores.one_thread_meanwhile():
        while (number := _next(end)) is not None:
            try:
                messages.send(DONE, (number, work(number, messages.on_step)))
            except (Exception, SystemExit) as error:
                messages.send(FAILED, _portable(error))


def _next(end: Connection) -> int | None:
    try:
        return end.recv()
    except (EOFError, OSError):
        os._exit(1)  # the parent is gone


class _Messages:
    """Messages from a worker to its parent."""

    def __init__(self, end: Connection) -> None:
        self._end, self._count, self._last = end, 0, time.monotonic()

    def send(self, kind: str, content: Any) -> None:
        """Send a message, preceded by the number of steps done so far. A worker without a parent ends."""
        if kind != STEPS:
            self._send_steps()
        message = pickle.dumps((kind, content), pickle.HIGHEST_PROTOCOL)
        try:
            self._end.send_bytes(message)
        except OSError:
            os._exit(1)

    def on_step(self) -> None:
        """Count a step."""
        self._count += 1
        if time.monotonic() - self._last > _EVERY:
            self._send_steps()

    def _send_steps(self) -> None:
        count, self._count, self._last = self._count, 0, time.monotonic()
        if count:
            self.send(STEPS, count)

    def take_over_logging(self) -> None:
        """Send warnings and log records to the parent, which knows what to do with them."""

        def show(
            message: Any, category: Any, filename: str, lineno: int, file: object = None, line: object = None
        ) -> None:
            self.send(WARNING, {"message": message, "category": category, "filename": filename, "lineno": lineno})

        warnings.showwarning = show
        logging.getLogger().handlers = [_Handler(self)]
        ours = logging.getLogger("estlab")
        ours.handlers, ours.propagate = [], True
        ours.setLevel(logging.INFO)


class _Handler(logging.handlers.QueueHandler):
    """Passes records on, with messages formatted so that they can be pickled."""

    def __init__(self, messages: _Messages) -> None:
        super().__init__(messages)  # type: ignore[arg-type]
        self._messages = messages

    def enqueue(self, record: logging.LogRecord) -> None:
        self._messages.send(LOG, record)


def _portable(error: BaseException) -> bytes:
    """The error, with its traceback as a note, or only its message if it cannot be pickled."""
    error.add_note(f"in a worker process:\n{''.join(traceback.format_exception(error))}")
    error.frames_in_worker = frames(error)  # type: ignore[attr-defined]
    try:
        carried = pickle.dumps(error)
        pickle.loads(carried)
    except Exception:
        plain = RuntimeError(f"{type(error).__name__}: {error}")
        plain.frames_in_worker = frames(error)  # type: ignore[attr-defined]
        return pickle.dumps(plain)
    return carried


def end_with_parent() -> NoReturn:
    """End this process when the one that started it has ended, however that ends."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
