"""Reports the progress of a run: on the terminal, in a notebook, or by calling a function."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from estlab.experiment.compute import Progress, unseen
from estlab.report import console

Report = Callable[[int, int], object]
Begin = Callable[[int], Callable[[int], None]]


def progress_of(wanted: bool | Report, title: str) -> Progress:
    """The progress display for a run of this title: none, a bar, or calls of a function."""
    if callable(wanted):
        return partial(_reported, wanted)
    if not wanted:
        return unseen
    if sys.stderr.isatty():
        return partial(console.progress, title)
    return partial(_reported, _Lines(title))


@contextmanager
def _reported(report: Report) -> Iterator[Begin]:
    """Calls of the report with the steps done and the total."""

    def begin(total: int) -> Callable[[int], None]:
        done = 0

        def count(steps: int) -> None:
            nonlocal done
            done += steps
            report(done, total)

        return count

    yield begin


class _Lines:
    """A line on standard error for each tenth, without a terminal: in a notebook and in a log."""

    def __init__(self, title: str) -> None:
        self.title, self.shown = title, 0

    def __call__(self, done: int, total: int) -> None:
        tenth = 10 * done // max(total, 1)
        if tenth > self.shown:
            self.shown = tenth
            print(f"{self.title}: {10 * tenth} %", file=sys.stderr)
