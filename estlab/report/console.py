"""Standard output and a progress bar; plain lines without a terminal."""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import rich.console
from rich.segment import Segment
from rich.text import Text

from estlab.errors import printable

_EVERY = 0.1  # seconds between updates of the bar


class Console(rich.console.Console):
    """A console on which no text steers the terminal, whoever wrote it: names and errors come from files."""

    def render(self, *arguments: Any, **options: Any) -> Iterable[Segment]:
        for text, style, control in super().render(*arguments, **options):
            lines = text if control else "\n".join(map(printable, text.split("\n")))
            yield Segment(lines, style, control)


def console() -> Console:
    """Standard output; wide enough for the tables where it is not a terminal."""
    out = Console(highlight=False)
    return out if out.is_terminal else Console(highlight=False, width=240, color_system=None)


def print_line(line: str, style: str = "") -> None:
    """Print a line on standard output, however long it is."""
    console().print(Text(line, style=style), soft_wrap=True)


@contextmanager
def progress(what: str) -> Iterator[Callable[[int], Callable[[int], None]]]:
    """Print a line on standard output, of any length."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    screen = Console(stderr=True)
    if not screen.is_terminal:
        yield lambda total: lambda steps: None
        return
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=screen, transient=True) as bar:

        def begin(total: int) -> Callable[[int], None]:
            task = bar.add_task(what, total=total)
            done, updated = 0, time.monotonic()

            def count(steps: int) -> None:
                nonlocal done, updated
                done += steps
                if time.monotonic() - updated > _EVERY:
                    bar.update(task, completed=done)
                    updated = time.monotonic()

            return count

        yield begin
