"""The live line of a sweep and its failures as they happen, read from the jobs' directories, whoever runs them."""

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from estlab import rundir
from estlab.report.console import Console
from estlab.rundir import files
from estlab.rundir.layout import RECORD_BYTES
from estlab.sweeps import state

_EVERY = 0.5  # seconds between checks of the directories
_LINE_EVERY = 30.0  # seconds between lines without a terminal


@contextmanager
def watched(sweep: Path, total: int) -> Iterator[Callable[[Sequence[str], int], None]]:
    """Report on standard error while the body runs the jobs; it is given who runs which jobs, and how many are done."""
    # Jobs in this process replace sys.stderr; the line continues on the original.
    screen = Console(file=sys.stderr, highlight=False, soft_wrap=True)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    bar = Progress(
        *columns, console=screen, transient=True, redirect_stdout=False, redirect_stderr=False,
        disable=not screen.is_terminal, refresh_per_second=2,
    )  # fmt: skip
    ended = threading.Event()
    with bar:
        watch = _Watch(sweep, total, screen, bar)
        thread = threading.Thread(target=watch.until, args=[ended], daemon=True)
        thread.start()
        try:
            yield watch.expect
        finally:
            ended.set()
            thread.join()


class _Watch:
    def __init__(self, sweep: Path, total: int, screen: Console, bar: Progress) -> None:
        self.sweep, self.screen, self.bar = sweep, screen, bar
        self.pending: dict[str, None] = {}
        self.announced: set[tuple[str, int]] = set()
        self.failed: set[str] = set()
        self.done, self.new, self.total = 0, 0, total
        self.began = self.printed = time.monotonic()
        self.row = bar.add_task(self._words(), total=total)

    def expect(self, names: Sequence[str], done: int) -> None:
        """Watch the directories of these jobs too; so many more were done before."""
        self.done += done
        self.pending |= dict.fromkeys(names)

    def until(self, ended: threading.Event) -> None:
        while not ended.wait(_EVERY):
            self.look()
        self.look()

    def look(self) -> None:
        for name in list(self.pending):
            if not self._has_ended(name):
                continue
            found = state.outcome(self.sweep, name)
            self.failed.discard(name)
            if found.whole:
                self.done += 1
                self.new += 1
                del self.pending[name]
                if found.error:
                    self._announce(name, found)
            elif found.state == "failed":  # an unreadable file may be half written
                self.failed.add(name)
                self._announce(name, found)
        self.bar.update(self.row, completed=self.done + len(self.failed), description=self._words())
        if self.bar.disable and time.monotonic() - self.printed > _LINE_EVERY:
            self.printed = time.monotonic()
            self.screen.print(Text(f"estlab: sweep, {self._words()}{self._to_go()}"))

    def _has_ended(self, name: str) -> bool:
        """A quick check of the text: most jobs of a large sweep have not started."""
        try:
            return b'"status": "running"' not in files.read(self.sweep, f"{name}/{rundir.STATUS}", RECORD_BYTES)
        except OSError:
            return False

    def _announce(self, name: str, found: state.Outcome) -> None:
        attempt = len(state.attempts(self.sweep, name))
        if (name, attempt) not in self.announced:
            self.announced.add((name, attempt))
            how = "" if found.whole else " failed"
            self.screen.print(Text(f"estlab: job {name}{how}: {found.error} ({self.sweep / name})"))

    def _words(self) -> str:
        left = self.total - self.done - len(self.failed)
        return f"{self.done} done, {len(self.failed)} failed, {left} left"

    def _to_go(self) -> str:
        ended = self.new + len(self.failed)
        if not ended:
            return ""
        left = (self.total - self.done - len(self.failed)) * (time.monotonic() - self.began) / ended
        return f", {left / 60:.0f} min to go" if left >= 60 else f", {left:.0f} s to go"
