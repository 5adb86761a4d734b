"""The run directory's contract: its files, how they are written, its status and its provenance."""

import contextlib
import json
import logging
import os
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, BinaryIO, Literal

from estlab import __version__
from estlab.datasets.whole import write_whole
from estlab.errors import UserError

State = Literal["running", "ok", "failed", "interrupted"]

CONFIG, OVERRIDES, RUN, STATUS, LOG = "config.yaml", "overrides.yaml", "run.json", "status.json", "log.txt"
ERRORS, NEES, NIS, NOTES, METRICS = "errors.csv", "nees.csv", "nis.csv", "notes.csv", "metrics.csv"
TESTS, VERDICTS, COVERAGE, HISTOGRAMS = "tests.csv", "verdicts.csv", "coverage.csv", "histograms.csv"
COMPARISON, RUNS = "comparison.csv", "runs.csv"
ESTIMATES, PLOTS, EXPECTATIONS, PART = "estimates.npz", "plots", "expectations.csv", "part.npz"

_PACKAGES = ("numpy", "scipy", "hydra-core", "omegaconf", "pandas", "matplotlib", "rich")
# The status is padded to this size, so that "failed" fits where "running" stood even on a full disk.
_STATUS_BYTES = 2048


class RunDirectory:
    """A directory that one run has to itself. Every file in it is written whole or not at all."""

    def __init__(self, path: Path, **facts: Any) -> None:
        """Claim a directory, which is made if it is not there; facts are for run.json.

        Raises UserError if another run has it or it cannot be written.
        """
        self.path = path
        self._began = time.time()
        self._facts: dict[str, Any] = facts
        self._git = _git_state(Path(__file__).parent)
        try:
            path.mkdir(parents=True, exist_ok=True)
            with open(path / STATUS, "xb") as stream:
                stream.write(_stamp("running", self._began, os.getpid()))
        except FileExistsError as error:
            if not path.is_dir():
                raise UserError(
                    f"{path}: a file stands where the run directory should be; set hydra.run.dir or output"
                ) from error
            raise UserError(f"{path}: holds a run already; give this one another hydra.run.dir") from error
        except OSError as error:
            raise UserError(
                f"{path}: the run directory cannot be written ({error.strerror}); set output to another folder"
            ) from error

    def finish(self, state: State, message: str = "", code: int = 0) -> None:
        """Set the final status and exit code, in place if there is no room for a new file."""
        with contextlib.suppress(OSError):
            self.describe()
        _replace(self.path / STATUS, _stamp(state, self._began, os.getpid(), message, code))

    @contextmanager
    def logged(self) -> Iterator[None]:
        """Send what estlab logs to log.txt, and the traceback of whatever is raised."""
        logging.raiseExceptions = False  # a full disk is reported once, by the file that matters
        handler = logging.FileHandler(self.path / LOG, encoding="utf-8")
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
        logger = logging.getLogger("estlab")
        logger.setLevel(logging.INFO)
        logger.propagate = False
        logger.addHandler(handler)
        try:
            yield
        except KeyboardInterrupt:
            logger.warning("interrupted")
            raise
        except Exception:
            logger.exception("the run failed")
            raise
        finally:
            logger.removeHandler(handler)
            handler.close()

    def write(self, name: str, write: Callable[[BinaryIO], object]) -> Path:
        """Write a file of the directory; folders in its name are made."""
        path = self.path / name
        path.parent.mkdir(exist_ok=True)
        return write_whole(path, write)

    def write_text(self, name: str, text: str) -> Path:
        """:meth:`write` for text."""
        return self.write(name, lambda stream: stream.write(text.encode()))

    def describe(self, **facts: Any) -> None:
        """Add to run.json, which says all that is needed to know what ran, on what, and from which data."""
        self._facts |= facts
        record = {
            "estlab": __version__,
            "python": platform.python_version(),
            "packages": {name: _version(name) for name in _PACKAGES},
            "git": self._git,
            "machine": {"node": platform.node(), "system": platform.platform(), "cores": os.cpu_count()},
            **self._facts,
            "began": _iso(self._began),
            "wall_time_s": round(time.time() - self._began, 3),
            "peak_memory_mb": round(_peak_memory() / 2**20, 1),
        }
        self.write_text(RUN, json.dumps(record, indent=2) + "\n")

    def link_latest(self, root: Path) -> None:
        """Make ``latest`` in the folder of all runs point here."""
        link_latest(self.path, root)


def link_latest(path: Path, root: Path) -> None:
    """Make ``latest`` in the folder of all runs point to a directory in it. Without symbolic links it goes without."""
    if not path.resolve().is_relative_to(root.resolve()):
        return
    link = root / f".latest.{os.getpid()}"
    try:
        link.symlink_to(path.resolve().relative_to(root.resolve()), target_is_directory=True)
        os.replace(link, root / "latest")
    except OSError:
        link.unlink(missing_ok=True)


def end(path: Path, message: str) -> None:
    """Set "failed" in the directory of a run whose process is gone, which is made if the process never did."""
    path.mkdir(parents=True, exist_ok=True)
    try:
        began = datetime.fromisoformat(json.loads((path / STATUS).read_text())["began"]).timestamp()
    except (OSError, ValueError, KeyError, TypeError):
        began = time.time()
    _replace(path / STATUS, _stamp("failed", began, os.getpid(), message, 1))


def _replace(status: Path, stamp: bytes) -> None:
    try:
        write_whole(status, lambda stream: stream.write(stamp))
    except OSError:
        with open(status, "r+b") as stream:
            stream.write(stamp)


def _stamp(state: State, began: float, pid: int, message: str = "", code: int = 0) -> bytes:
    stamp: dict[str, Any] = {"status": state, "began": _iso(began), "pid": pid, "node": platform.node()}
    if state != "running":
        stamp |= {"ended": _iso(time.time()), "error": message[:1000], "exit_code": code}
    return (json.dumps(stamp, indent=2) + "\n").encode().ljust(_STATUS_BYTES)


def at_work(status: Mapping[str, Any]) -> bool:
    """Whether the process of an unfinished run is alive, by its status; also where that cannot be known from here."""
    pid, node = status.get("pid"), status.get("node")
    if status.get("status") != "running":
        return False
    if not isinstance(pid, int) or isinstance(pid, bool) or not 0 < pid < 2**31 or node != platform.node():
        return True
    try:
        os.kill(pid, 0)  # it sends nothing, and asks alone
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def hashes(files: Iterable[Path]) -> list[dict[str, str]]:
    """Each file with its SHA-256."""
    return [{"file": str(path.resolve()), "sha256": sha256(path.read_bytes()).hexdigest()} for path in files]


def _iso(stamp: float) -> str:
    return datetime.fromtimestamp(stamp).astimezone().isoformat()


@cache
def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _git_state(folder: Path) -> dict[str, object] | None:
    """Commit and whether the tree differs from it, where estlab runs from a checkout; else None."""
    if not (folder.parent / ".git").exists():
        return None
    try:
        ask = ["git", "-C", str(folder.parent)]
        commit = subprocess.run([*ask, "rev-parse", "HEAD"], capture_output=True, text=True, timeout=10, check=True)
        changes = subprocess.run(
            [*ask, "status", "--porcelain"], capture_output=True, text=True, timeout=10, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return {"commit": commit.stdout.strip(), "dirty": bool(changes.stdout.strip())}


def _peak_memory() -> int:
    """Bytes. The kernel counts in kB, macOS in bytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
