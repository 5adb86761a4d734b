"""From the words of a command line to run directories."""

import glob
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from estlab.errors import UserError
from estlab.rundir.finished import is_run
from estlab.rundir.layout import ATTEMPTS

_DEEPEST = 8  # folders between the named one and a run

# A sweep's earlier attempts at its jobs.
_PASSED_OVER = (ATTEMPTS,)


def run_directories(words: Sequence[str]) -> list[Path]:
    """Each run directory that the words name: itself, one in a folder at any depth, or by a shell pattern; once.

    Links in a folder are not followed, because ``latest`` is beside its target; a link that is named itself is
    followed.

    Raises UserError for a word that matches nothing.
    """
    found: dict[Path, Path] = {}
    for word in words:
        matches = [Path(word)] if os.path.lexists(word) else sorted(_matches(word), key=lambda p: _natural(str(p)))
        if not matches:
            raise UserError(f"there is no {word}; name runs, folders of runs, or a pattern: 'runs/*/*_car_*'")
        for match in matches:
            for run in within(match):
                found.setdefault(run.resolve(), run)
    return list(found.values())


def _matches(pattern: str) -> list[Path]:
    return [Path(match) for match in glob.glob(pattern)]  # noqa: PTH207 (Path.glob takes no absolute pattern)


def within(folder: Path, depth: int = 0) -> Iterator[Path]:
    """The run directories in a folder, or the folder itself; a run's own folders contain none."""
    if is_run(folder):
        yield folder
    elif depth < _DEEPEST:
        for child in folders_in(folder):
            yield from within(child, depth + 1)


def folders_in(folder: Path) -> list[Path]:
    """The folders in a folder that are not links, hidden or a sweep's earlier attempts; 2_car before 10_car."""
    try:
        children = [Path(entry.path) for entry in os.scandir(folder) if entry.is_dir(follow_symlinks=False)]
    except OSError:
        return []
    return sorted(_seen(children), key=lambda path: _natural(path.name))


def _seen(children: Iterable[Path]) -> list[Path]:
    return [path for path in children if not path.name.startswith(".") and path.name not in _PASSED_OVER]


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name) if part]
