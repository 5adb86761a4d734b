"""What tests have workers do: a module that imports little, since every worker imports it."""

import logging
import os
import signal
import warnings
from multiprocessing import current_process

STEPS = 5


class TwoWordsError(Exception):
    """It cannot be pickled: its pickle has one word."""

    def __init__(self, one, other):
        super().__init__(f"{one} {other}")


def work(what, number, on_step):
    """A task: its number and its process. Something happens in workers alone, which this says of a task."""
    for _ in range(STEPS):
        on_step()
    if current_process().name != "MainProcess":
        if what == "warn":
            warnings.warn(f"task {number}", RuntimeWarning, stacklevel=1)
        elif what == "log":
            logging.getLogger("estlab").warning("task %d", number)
        elif what == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        elif what == "exit":
            raise SystemExit(3)
        elif what == "two words":
            raise TwoWordsError("one", "other")
        elif what is not None:
            raise what
    return number, os.getpid()
