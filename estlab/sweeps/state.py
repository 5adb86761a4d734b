"""The state of a sweep on the disk: its plan, its lock, and the outcome in each job's directory."""

import contextlib
import csv
import fcntl
import io
import itertools
import json
import os
import stat
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path, PurePath
from typing import Any, Literal, cast

from estlab import rundir
from estlab.config.settings import NEITHER, without
from estlab.errors import UserError, printable
from estlab.rundir import files, process
from estlab.rundir.finished import plugins_of
from estlab.rundir.layout import ARRAY_BYTES, ATTEMPTS, LOCK, PLAN, RECORD_BYTES, STOP

PARTS_TOOK = "parts_wall_time_s"  # for a job merged from parts, in its run.json

_METRICS_BYTES, _PLAN_BYTES = 2**26, 2**28  # bytes to read at most

State = Literal["left", "running", "ok", "unmet", "failed", "interrupted", "damaged"]


@dataclass(frozen=True)
class Planned:
    """A job of a sweep: its directory's name, its typed words, its values of the swept keys, its fingerprint.

    parts: the number of parts in which it runs, each a separate job, before they merge; see estlab.sweeps.split.
    composed: its configuration, pickled, as a worker is given it (see estlab.sweeps.job). own: the keys in which this
    part, or this job put together from parts, has other values than the configuration that was composed.
    """

    number: int
    name: str
    overrides: tuple[str, ...]
    values: dict[str, str]
    fingerprint: str
    parts: int = 1
    composed: bytes = field(default=b"", repr=False, compare=False)
    own: Mapping[str, Any] = field(default_factory=dict, compare=False)

    def facts(self) -> dict[str, Any]:
        """What the plan of a sweep says of it."""
        keys = ("number", "name", "overrides", "values", "fingerprint", "parts")
        return {key: getattr(self, key) for key in keys}


@dataclass(frozen=True)
class Outcome:
    """The outcome in a job's directory: rows of metrics.csv, as text; plugins: SHA-256 of each module's source."""

    state: State
    error: str = ""
    code: int = 0
    wall_time: float | None = None
    rows: list[dict[str, str]] = field(default_factory=list)
    plugins: dict[str, str] = field(default_factory=dict)

    @property
    def whole(self) -> bool:
        """Whether it has all its figures, whether expected or not."""
        return self.state in rundir.WHOLE


def fingerprint(plain: Mapping[str, Any], scenario: str, filter: str) -> str:
    """A hash of everything that determines a job's figures: its resolved configuration and the names that determine
    its random numbers.

    For a part of a job, the job's and the part's number.
    """
    decides = without(plain, NEITHER)
    whole = sha256(json.dumps([scenario, filter, decides], sort_keys=True, default=str).encode()).hexdigest()
    return of_part(whole, *plain["part"]) if plain.get("part") else whole


def of_part(whole: str, which: int, parts: int) -> str:
    """The fingerprint of a part of a job."""
    return f"{whole} part {which} of {parts}"


def outcome(sweep: Path, name: str, fingerprint: str | None = None) -> Outcome:
    """Read a job's directory. With a fingerprint, it is complete only if it belongs to that job."""
    folder = PurePath(name)
    try:
        stamp = _record(sweep, folder / rundir.STATUS)
        state, error, code = rundir.state_of(stamp), stamp.get("error", ""), int(stamp.get("exit_code", 0))
    except (FileNotFoundError, NotADirectoryError):
        return Outcome("left")
    except files.RefusedError as refused:
        return Outcome("damaged", f"{PurePath(refused.filename).name} {refused.strerror}", 1)
    except (OSError, ValueError, KeyError, TypeError, OverflowError):
        return Outcome("damaged", f"{rundir.STATUS} cannot be read", 1)
    if state not in rundir.STATES:
        return Outcome("damaged", f"{rundir.STATUS} holds an unknown status", 1)
    try:
        facts = _record(sweep, folder / rundir.RUN)
        took = float(facts["wall_time_s"]) + float(facts.get(PARTS_TOOK, 0.0))
    except (OSError, ValueError, KeyError, TypeError, OverflowError):
        facts, took = {}, None
    if state not in rundir.WHOLE:
        # A job that failed late still has figures.
        return Outcome(cast(State, state), str(error), code, took, _metrics(sweep, folder) or [])
    if fingerprint is not None and facts.get("fingerprint") != fingerprint:
        return Outcome("damaged", f"{rundir.RUN} cannot be read, or belongs to another configuration", 1)
    if facts.get("part"):
        whole = _is_readable(sweep, folder / rundir.PART)
        return Outcome("ok", "", 0, took) if whole else Outcome("damaged", f"{rundir.PART} cannot be read", 1)
    rows = _metrics(sweep, folder)
    if rows is None:
        return Outcome("damaged", f"{rundir.METRICS} cannot be read", 1)
    return Outcome(cast(State, state), str(error), code, took, rows, plugins_of(facts))


def _record(sweep: Path, file: PurePath) -> dict[str, Any]:
    try:
        found = json.loads(files.read(sweep, str(file), RECORD_BYTES))
    except RecursionError as error:
        raise ValueError("nested deeper than anything that a run writes") from error
    if not isinstance(found, dict):
        raise TypeError("not an object")
    return found


def _metrics(sweep: Path, folder: PurePath) -> list[dict[str, str]] | None:
    """The rows of metrics.csv; None if they cannot be read."""
    try:
        text = files.read(sweep, str(folder / rundir.METRICS), _METRICS_BYTES).decode()
        rows = list(csv.DictReader(io.StringIO(text, newline="")))
    except (OSError, ValueError, csv.Error):
        return None
    whole = rows and all(row.get("filter") and row.get("n") is not None for row in rows)
    return rows if whole else None


def _is_readable(sweep: Path, archive: PurePath) -> bool:
    """Whether every array of an .npz can be read to its last byte."""
    try:
        with files.opened(sweep, str(archive), ARRAY_BYTES) as stream, zipfile.ZipFile(stream) as stored:
            if any(member.compress_type != zipfile.ZIP_STORED for member in stored.infolist()):
                return False  # a part stores its arrays uncompressed; one that unpacks to more is invalid
            return stored.testzip() is None
    except (OSError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error):
        return False


def at_work(sweep: Path, name: str) -> int | None:
    """The process that is running a job on this machine, if its directory says so and the process is alive."""
    try:
        stamp = _record(sweep, PurePath(name) / rundir.STATUS)
    except (OSError, ValueError, TypeError):
        return None
    elsewhere = rundir.worker(stamp) == "alive" and stamp["pid"] != os.getpid()
    return int(stamp["pid"]) if elsewhere else None


def set_aside(sweep: Path, name: str, whatever: bool = False) -> None:
    """Move what an earlier attempt at a job left to attempts/<job>.<number>, so that nothing is lost or mixed.

    Anything else in the job's place that is not a run directory, such as a link, moves too. whatever: moves even a
    folder in which no run has begun.

    Raises OSError if a folder on the way is a link.
    """
    place = PurePath(name)
    with contextlib.suppress(FileNotFoundError), files.folder(sweep, place.parent) as above:
        there = stat.S_ISDIR(os.stat(place.name, dir_fd=above, follow_symlinks=False).st_mode)
        if there and not whatever and not files.has(sweep, str(place / rundir.STATUS)):
            return
        with files.folder(sweep, PurePath(ATTEMPTS) / place.parent, make=True) as kept:
            taken = set(files.names(sweep, PurePath(ATTEMPTS) / place.parent))
            number = next(n for n in itertools.count(1) if f"{place.name}.{n}" not in taken)
            os.rename(place.name, f"{place.name}.{number}", src_dir_fd=above, dst_dir_fd=kept)


def attempts(sweep: Path, name: str) -> list[str]:
    """The names of a job's earlier attempts, relative to the sweep, in order."""
    place = PurePath(ATTEMPTS) / name
    found = []
    with contextlib.suppress(OSError):
        for entry in files.names(sweep, place.parent):
            job, _, number = entry.rpartition(".")
            if job == place.name and number.isdecimal():
                found.append((int(number), str(place.parent / entry)))
    return [entry for _, entry in sorted(found)]


def stop(sweep: Path) -> None:
    """Prevent further jobs of the sweep from starting."""
    with contextlib.suppress(FileExistsError):
        files.create(sweep, STOP, b"")


def stopped(sweep: Path) -> bool:
    """Whether no further job may start, because of fail_fast or because the sweep's directory was removed."""
    return files.has(sweep, STOP) or is_gone(sweep)


def is_gone(sweep: Path) -> bool:
    """Whether the directory of a sweep that has begun was removed, even if another of its name was made."""
    return not files.is_file(sweep, PLAN)


@contextmanager
def locked(sweep: Path) -> Iterator[None]:
    """Lock a sweep's directory for this process; the system releases the lock however the process ends.

    Raises UserError if another process holds it.
    """
    with files.in_place(sweep, LOCK) as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            by = holder(sweep)
            who = f"process {by.get('pid')} on {printable(str(by.get('node')))}" if by else "just begun"
            raise UserError(
                f"{sweep}: another sweep is at work there ({who}); wait for it, or give this one another sweep.dir"
            ) from error
        except OSError as error:
            raise UserError(
                f"{sweep}: cannot be locked ({error.strerror}); set output or sweep.dir to another file system"
            ) from error
        stream.truncate(0)
        stream.write(json.dumps(process.marks()).encode())
        yield
        stream.truncate(0)


def holder(sweep: Path) -> dict[str, Any]:
    """The identity of the process that holds a sweep's directory; empty if none does."""
    try:
        return _record(sweep, PurePath(LOCK))
    except (OSError, ValueError, TypeError):
        return {}


def begin(sweep: Path, arguments: Sequence[str], jobs: Sequence[Planned], tuning: str = "") -> None:
    """Write the plan of a new sweep, or check that the existing one is the same.

    tuning: what distinguishes one tuning from another, whose jobs depend on each other and are not known in advance.
    Raises UserError for a directory that holds another sweep or something else.
    """
    if not [path for path in sweep.iterdir() if not path.name.startswith(".")]:
        write_plan(sweep, arguments, jobs, tuning)
        return
    plan = plan_of(sweep)
    there = [(job["name"], job["fingerprint"]) for job in plan["jobs"]]
    here = [(job.name, job.fingerprint) for job in jobs]
    tuned = plan.get("tuning", "")
    if tuned == tuning and (tuning or there == here):
        return
    what_differs = f"{len(there)} jobs, {len(set(there) & set(here))} of them among the {len(here)} of this one"
    if tuned or tuning:
        what_differs = f"there: {tuned or 'no tuning'}, here: {tuning or 'no tuning'}"
    raise UserError(
        f"{sweep}: holds another sweep ({what_differs}); "
        "give this one another sweep.dir, or resume that one with estlab sweep --resume"
    )


def write_plan(sweep: Path, arguments: Sequence[str], jobs: Sequence[Planned], tuning: str = "") -> None:
    """Write the typed words and the jobs that they make."""
    plan: dict[str, Any] = {
        "arguments": list(arguments),
        "folder": str(Path.cwd()),
        "jobs": [job.facts() for job in jobs],
    }
    files.write_text(sweep, PLAN, json.dumps(plan | ({"tuning": tuning} if tuning else {}), indent=1) + "\n")


def plan_of(sweep: Path) -> dict[str, Any]:
    """The plan of the sweep in a directory.

    Raises UserError for a directory that has none.
    """
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
        plan = json.loads(files.read(sweep, PLAN, _PLAN_BYTES))
        words, folder, jobs = plan["arguments"], plan["folder"], plan["jobs"]
        names = [text for job in jobs for text in (job["name"], job["fingerprint"])]
        if all(isinstance(word, str) for word in [*words, folder, *names]):
            return dict(plan)
    raise UserError(f"{sweep}: no readable {PLAN}; sweep.dir must be a sweep's directory or a new one")
