"""What is on the disk of a sweep: its plan, its lock, and what each job's directory says of it."""

import contextlib
import csv
import fcntl
import json
import os
import platform
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

from estlab import rundir
from estlab.datasets.whole import write_text
from estlab.errors import UserError

PLAN, LOCK, STOP, ATTEMPTS = "sweep.json", ".lock", ".stop", "attempts"
PARTS_TOOK = "parts_wall_time_s"  # of a job put together from parts, in its run.json

# What may change between a job and its repetition without changing a figure of it.
_NO_MATTER = ("output", "plots", "report", "sweep", "part", "parts", "objective", "cores")

State = Literal["left", "running", "ok", "failed", "interrupted", "damaged"]


@dataclass(frozen=True)
class Planned:
    """A job of a sweep: its directory's name, what is typed for it, its values of the swept keys, its fingerprint.

    parts: in how many parts it runs, each a job of its own, before they are put together; see estlab.sweeps.split.
    """

    number: int
    name: str
    overrides: tuple[str, ...]
    values: dict[str, str]
    fingerprint: str
    parts: int = 1


@dataclass(frozen=True)
class Outcome:
    """What a job's directory says: rows are those of metrics.csv, as text."""

    state: State
    error: str = ""
    code: int = 0
    wall_time: float | None = None
    rows: list[dict[str, str]] = field(default_factory=list)


def fingerprint(plain: Mapping[str, Any], scenario: str, filter: str) -> str:
    """A hash of all that decides a job's figures: its resolved configuration and the names its randomness hangs on.

    Of a part of a job, the job's and which part.
    """
    decides = {key: value for key, value in plain.items() if key not in _NO_MATTER}
    whole = sha256(json.dumps([scenario, filter, decides], sort_keys=True, default=str).encode()).hexdigest()
    return of_part(whole, *plain["part"]) if plain.get("part") else whole


def of_part(whole: str, which: int, parts: int) -> str:
    """The fingerprint of a part of a job."""
    return f"{whole} part {which} of {parts}"


def outcome(folder: Path, fingerprint: str | None = None) -> Outcome:
    """Read a job's directory. With a fingerprint, it is ok only if it is that job's."""
    try:
        stamp = json.loads((folder / rundir.STATUS).read_text())
        state, error, code = stamp["status"], stamp.get("error", ""), stamp.get("exit_code", 0)
    except (FileNotFoundError, NotADirectoryError):
        return Outcome("left")
    except (OSError, ValueError, KeyError, TypeError):
        return Outcome("damaged", f"{rundir.STATUS} cannot be read", 1)
    if state not in ("running", "ok", "failed", "interrupted"):
        return Outcome("damaged", f"{rundir.STATUS} holds an unknown status", 1)
    try:
        facts = json.loads((folder / rundir.RUN).read_text())
        took = float(facts["wall_time_s"]) + float(facts.get(PARTS_TOOK, 0.0))
    except (OSError, ValueError, KeyError, TypeError):
        facts, took = {}, None
    if state != "ok":
        # One that did not find what it should has its figures all the same.
        return Outcome(state, str(error), int(code), took, _metrics(folder) or [])
    if fingerprint is not None and facts.get("fingerprint") != fingerprint:
        return Outcome("damaged", f"{rundir.RUN} cannot be read, or is of another configuration", 1)
    if facts.get("part"):
        whole = _is_readable(folder / rundir.PART)
        return Outcome("ok", "", 0, took) if whole else Outcome("damaged", f"{rundir.PART} cannot be read", 1)
    rows = _metrics(folder)
    if rows is None:
        return Outcome("damaged", f"{rundir.METRICS} cannot be read", 1)
    return Outcome("ok", "", 0, took, rows)


def _metrics(folder: Path) -> list[dict[str, str]] | None:
    """The rows of metrics.csv; None if they cannot be read."""
    try:
        with open(folder / rundir.METRICS, newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, ValueError, csv.Error):
        return None
    whole = rows and all(row.get("filter") and row.get("n") is not None for row in rows)
    return rows if whole else None


def _is_readable(archive: Path) -> bool:
    """Whether every array of a .npz is there to its last byte."""
    try:
        with zipfile.ZipFile(archive) as stored:
            return stored.testzip() is None
    except (OSError, ValueError, EOFError, NotImplementedError, zipfile.BadZipFile, zlib.error):
        return False


def at_work(folder: Path) -> int | None:
    """The process that runs a job at this moment on this machine, if its directory says so and the process lives."""
    try:
        stamp = json.loads((folder / rundir.STATUS).read_text())
        if stamp["status"] != "running" or stamp["node"] != platform.node() or stamp["pid"] == os.getpid():
            return None
        os.kill(int(stamp["pid"]), 0)
    except PermissionError:
        return int(stamp["pid"])
    except (OSError, ValueError, KeyError, TypeError, OverflowError):
        return None
    return int(stamp["pid"])


def set_aside(sweep: Path, name: str) -> None:
    """Move what an earlier attempt at a job left to attempts/<job>.<number>, so that nothing is lost or mixed."""
    folder, kept = sweep / name, sweep / ATTEMPTS / name
    if not (folder / rundir.STATUS).exists():
        return
    kept.parent.mkdir(parents=True, exist_ok=True)
    for number in range(1, 1_000_000):
        place = kept.with_name(f"{kept.name}.{number}")
        if not place.exists():
            folder.rename(place)
            return


def attempts(sweep: Path, name: str) -> list[Path]:
    """The directories of a job's earlier attempts, in their order."""
    found = (sweep / ATTEMPTS).glob(f"{name}.*")
    return sorted((p for p in found if p.suffix[1:].isdigit()), key=lambda p: int(p.suffix[1:]))


@contextmanager
def locked(sweep: Path) -> Iterator[None]:
    """Hold a sweep's directory for this process alone; the system lets go of it however the process ends.

    Raises UserError if another process holds it.
    """
    with open(sweep / LOCK, "a+", encoding="utf-8") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            stream.seek(0)
            raise UserError(
                f"{sweep}: another sweep is at work there ({stream.read().strip() or 'just begun'}); "
                "wait for it, or give this one another sweep.dir"
            ) from error
        except OSError as error:
            raise UserError(
                f"{sweep}: cannot be locked ({error.strerror}); set output or sweep.dir to another file system"
            ) from error
        stream.truncate(0)
        stream.write(f"process {os.getpid()} on {platform.node()}")
        stream.flush()
        yield
        stream.truncate(0)


def begin(sweep: Path, arguments: Sequence[str], jobs: Sequence[Planned], tuning: str = "") -> None:
    """Write the plan of a new sweep, or make sure that the one there is the same.

    tuning: what tells one tuning from another, whose jobs follow from each other and are not known before.
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
    told = f"{len(there)} jobs, {len(set(there) & set(here))} of them among the {len(here)} of this one"
    if tuned or tuning:
        told = f"there: {tuned or 'no tuning'}, here: {tuning or 'no tuning'}"
    raise UserError(
        f"{sweep}: holds another sweep ({told}); "
        "give this one another sweep.dir, or resume that one with estlab sweep --resume"
    )


def write_plan(sweep: Path, arguments: Sequence[str], jobs: Sequence[Planned], tuning: str = "") -> None:
    """Write the words that were typed and the jobs that they make."""
    plan: dict[str, Any] = {"arguments": list(arguments), "folder": str(Path.cwd()), "jobs": [asdict(j) for j in jobs]}
    write_text(sweep / PLAN, json.dumps(plan | ({"tuning": tuning} if tuning else {}), indent=1) + "\n")


def plan_of(sweep: Path) -> dict[str, Any]:
    """The plan of the sweep in a directory.

    Raises UserError for a directory that has none.
    """
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        plan = json.loads((sweep / PLAN).read_text())
        words, folder, jobs = plan["arguments"], plan["folder"], plan["jobs"]
        if all(isinstance(word, str) for word in [*words, folder, *(job["name"] for job in jobs)]):
            return dict(plan)
    raise UserError(
        f"{sweep}: there is no {PLAN} of a sweep that can be read; sweep.dir must be a sweep's or a new one"
    )
