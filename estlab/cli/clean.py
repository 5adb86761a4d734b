"""estlab clean: lists run directories that may be deleted, and deletes them if asked."""

import argparse
import contextlib
import os
import re
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from estlab.cli.parser import Checked, Parser
from estlab.errors import UserError
from estlab.launch.launcher import FAILED, OK, complain
from estlab.rundir.layout import LOCK, PLAN, STATUS

_SECONDS = {"s": 1, "m": 60, "h": 3600, "d": 86400, "w": 7 * 86400}


class CleanOptions(argparse.Namespace):
    """The options of the command line. older_than: seconds; keep_last: how many of the newest stay."""

    folders: list[Path]
    failed: bool
    older_than: float | None
    keep_last: int | None
    yes: bool

    @property
    def folder(self) -> Path:
        return self.folders[0] if self.folders else Path("runs")


def parser() -> Parser:
    """The command line of estlab clean."""
    found = Parser(
        "clean",
        "clean [FOLDER] [--failed] [--older-than 7d] [--keep-last N]\n                    [--yes]",
        "Lists run directories in FOLDER that you may delete, with size, age, status\n"
        "and reason, and deletes them only with --yes. Without further flags these are\n"
        "the runs that failed, were interrupted, or whose process is gone. Runs that\n"
        "only missed an expectation are complete, and stay.\n"
        "\n"
        "A sweep is deleted as a whole, and only by age. Nothing is touched that is at\n"
        "work, cannot be read, is a link, or holds other runs.",
        "exit codes: 0 ok, 1 something could not be deleted, 2 usage",
    )
    found.add_argument("folders", metavar="FOLDER", type=Path, nargs="*", help="the folder of runs (runs)")
    found.add_argument("--failed", action="store_true", help="runs that failed; combines with other conditions")
    age = Checked(_seconds, "a number and s, m, h, d or w, for example 7d")
    found.add_argument(
        "--older-than", type=age, metavar="7d", help="runs that ended longer ago than this: s, m, h, d or w"
    )
    count = Checked(_count, "a whole number from 1")
    found.add_argument("--keep-last", type=count, metavar="N", help="all but the newest N")
    found.add_argument("--yes", action="store_true", help="delete them")
    return found


@dataclass(frozen=True)
class RunFolder:
    """The directory of a run or a sweep. state: its status in a word; stays: why it must not be deleted, if so.

    ended: seconds since 1970; for an unfinished run, its beginning.
    """

    path: Path
    state: str
    ended: float
    broken: bool
    stays: str = ""


def clean(arguments: Sequence[str]) -> int:
    """List what may be deleted, and delete it with --yes. Returns the exit code."""
    options = _read(arguments)
    from estlab.report import grids
    from estlab.report.console import print_line

    there = list(_found(options.folder))
    for one in there:
        if one.stays:
            complain(f"note: {one.path} stays: {one.stays}")
    chosen = _chosen(there, options)
    if not chosen:
        print_line(f"nothing to delete in {options.folder}")
        return OK
    sizes = [_size(one.path) for one, _ in chosen]
    lines = [
        [str(one.path), f"{size / 1e6:.1f} MB", _age(one.ended), one.state, why]
        for (one, why), size in zip(chosen, sizes, strict=True)
    ]
    grids.show(grids.Grid("", ["directory", "size", "age", "status", "why"], lines, 1))
    count = f"{len(chosen)} director{'y' if len(chosen) == 1 else 'ies'}, {sum(sizes) / 1e6:.1f} MB"
    if not options.yes:
        print_line(f"{count}; add --yes to delete them")
        return OK
    kept = [line for one, _ in chosen if (line := _delete(one, options.folder))]
    _mend_latest(options.folder)
    for line in kept:
        complain(line, FAILED)
    print_line(f"deleted {len(chosen) - len(kept)} of {count}")
    return FAILED if kept else OK


def _read(arguments: Sequence[str]) -> CleanOptions:
    """Parse the command line. Raises UserError for invalid words."""
    from estlab.rundir.finished import is_run

    options = parser().read(arguments, CleanOptions())
    if len(options.folders) > 1:
        raise UserError(f"estlab clean takes one folder of runs, got {', '.join(map(str, options.folders))}")
    if not options.folder.is_dir():
        raise UserError(f"{options.folder}: there is no such folder of runs")
    if is_run(options.folder) or (options.folder / PLAN).exists():
        raise UserError(f"{options.folder}: is a run or sweep itself; name the folder that contains it")
    return options


def _seconds(text: str) -> float:
    if not (age := re.fullmatch(r"([0-9]{1,6}(?:\.[0-9]{1,6})?)([smhdw])", text)):
        raise ValueError(text)
    return float(age[1]) * _SECONDS[age[2]]


def _count(text: str) -> int:
    if not re.fullmatch(r"[1-9][0-9]{0,8}", text):
        raise ValueError(text)
    return int(text)


def _found(folder: Path, depth: int = 0) -> "list[RunFolder]":
    """The runs and sweeps in a folder at any depth; links are not followed."""
    from estlab.rundir.finished import is_run
    from estlab.rundir.search import folders_in

    found: list[RunFolder] = []
    for path in folders_in(folder) if depth < 6 else []:
        if (path / PLAN).is_file():
            found.append(_sweep(path))
        elif is_run(path):
            found.append(_run(path))
        else:
            found += _found(path, depth + 1)
    return found


def _run(path: Path) -> RunFolder:
    from estlab import rundir
    from estlab.rundir import finished

    try:
        status = finished.status(path)
    except UserError as error:
        return RunFolder(path, "", 0.0, False, f"its status cannot be read ({error})")
    state = str(status["status"])
    ended = _stamp(status, path)
    if (worker := rundir.worker(status)) != "gone":
        where = "" if worker == "alive" else ", or was on another machine"
        return RunFolder(path, state, ended, False, f"it is at work{where}")
    if len(_statuses(path)) > 1:
        return RunFolder(path, state, ended, False, "it holds other runs")
    return RunFolder(path, "unfinished" if state == "running" else state, ended, state not in rundir.WHOLE)


def _sweep(path: Path) -> RunFolder:
    """A sweep, dated by its newest job; it stays while one of its jobs, or the sweep itself, is at work."""
    from estlab.rundir.finished import is_run
    from estlab.rundir.search import folders_in

    jobs = [_run(job) for job in folders_in(path) if is_run(job)]
    ok = sum(job.state == "ok" for job in jobs)
    state = f"sweep, {ok} of {len(jobs)} jobs ok"
    ended = max([job.ended for job in jobs], default=path.stat().st_mtime)
    stays = next((f"of its job {job.path.name}: {job.stays}" for job in jobs if job.stays), "")
    return RunFolder(path, state, ended, False, "it is at work" if _locked(path) else stays)


def _locked(sweep: Path) -> bool:
    """Whether a process holds the lock of a sweep."""
    import fcntl

    from estlab.rundir import files

    try:
        with files.opened(sweep, LOCK) as stream:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return False


def _stamp(status: dict[str, Any], path: Path) -> float:
    """When a run ended or, failing that, began; the age of its status file if it has no time."""
    with contextlib.suppress(ValueError, TypeError, OverflowError, OSError):
        return datetime.fromisoformat(status.get("ended") or status["began"]).timestamp()
    return (path / STATUS).stat().st_mtime


def _statuses(path: Path) -> list[Path]:
    return [Path(folder) for folder, _, files in os.walk(path) if STATUS in files]


def _chosen(there: Sequence[RunFolder], options: CleanOptions) -> list[tuple[RunFolder, str]]:
    """The directories that meet all given conditions, and why."""
    newest = sorted(there, key=lambda one: -one.ended)[: options.keep_last or 0]
    only_failed = options.failed or (options.older_than is None and options.keep_last is None)
    chosen = []
    for one in there:
        old = options.older_than is None or time.time() - one.ended > options.older_than
        if one.stays or one in newest or not old or (only_failed and not one.broken):
            continue
        reasons = [one.state] * only_failed
        reasons += ["old"] * (options.older_than is not None)
        reasons += [f"not of the newest {options.keep_last}"] * (options.keep_last is not None)
        chosen.append((one, ", ".join(reasons)))
    return chosen


def _delete(one: RunFolder, folder: Path) -> str:
    """Delete a directory and the empty ones that this leaves in the folder. Returns the reason if it fails."""
    inside = one.path.resolve().is_relative_to(folder.resolve()) and one.path.resolve() != folder.resolve()
    again = _sweep(one.path) if (one.path / PLAN).is_file() else _run(one.path)
    if not inside or one.path.is_symlink() or again.stays or again.state != one.state:
        return f"{one.path}: changed since it was listed, and stays"
    try:
        shutil.rmtree(one.path)
    except OSError as error:
        return f"{error.filename or one.path}: cannot be deleted ({error.strerror})"
    for parent in one.path.parents:
        if parent == folder:
            break
        with contextlib.suppress(OSError):
            parent.rmdir()  # a folder that is not empty stays
    return ""


def _mend_latest(folder: Path) -> None:
    """Make ``latest`` point to the newest remaining run, if its target is gone."""
    from estlab import rundir

    latest = folder / "latest"
    if not latest.is_symlink() or latest.exists():
        return
    with contextlib.suppress(OSError):
        latest.unlink()
        if left := _found(folder):
            rundir.link_latest(max(left, key=lambda one: one.ended).path, folder)


def _size(path: Path) -> int:
    """Size in bytes, counting links themselves."""
    total = 0
    for folder, _, files in os.walk(path):
        for name in files:
            with contextlib.suppress(OSError):
                total += (Path(folder) / name).lstat().st_size
    return total


def _age(ended: float) -> str:
    seconds = max(0.0, time.time() - ended)
    for unit in ("w", "d", "h", "m"):
        if seconds >= _SECONDS[unit] * (2 if unit == "w" else 1):
            return f"{seconds / _SECONDS[unit]:.0f} {unit}"
    return f"{seconds:.0f} s"
