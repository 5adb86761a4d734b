"""The directory of one run: claimed, written, finished."""

import contextlib
import errno
import io
import json
import logging
import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

from estlab.errors import UserError
from estlab.python_warnings import in_a_line
from estlab.rundir import files, provenance, status
from estlab.rundir.layout import LOG, PLUGINS, RUN, STATUS
from estlab.rundir.sources import sources


class RunDirectory:
    """A directory that belongs to one run. Every file in it is written whole or not at all, and through no link."""

    def __init__(self, path: Path, within: Path | None = None, **facts: Any) -> None:
        """Claim a directory, creating it if needed; facts go to run.json.

        within: the folder above, such as a sweep's, below which no link is followed; by default the path itself.

        Raises UserError if another run has it or it cannot be written.
        """
        self.path = path
        self._root = within or path
        self._name = path.relative_to(self._root)
        self._began, self._clock = time.time(), time.monotonic()
        self._facts: dict[str, Any] = facts
        self._kept: dict[str, dict[str, str]] = {}
        self._written: set[str] = set()
        try:
            self._root.mkdir(parents=True, exist_ok=True)
            files.create(self._root, str(self._name / STATUS), status.stamp("running", self._began))
            with files.folder(self._root, self._name) as handle:
                # While it is held open, no other folder has its number.
                self._held, self._identity = os.dup(handle), os.fstat(handle)
        except FileExistsError as error:
            if not path.is_dir():
                raise UserError(f"{path}: this is a file, not a folder; set hydra.run.dir or output") from error
            raise UserError(f"{path}: already holds a run; set another hydra.run.dir") from error
        except files.RefusedError as error:
            raise UserError(
                f"{error.filename}: {error.strerror}; remove it, or set output to another folder"
            ) from error
        except OSError as error:
            raise UserError(
                f"{path}: the run directory cannot be written ({error.strerror}); set output to another folder"
            ) from error

    def finish(self, state: status.State, message: str = "", code: int = 0) -> None:
        """Set the final status and exit code, in place if there is no room for a new file.

        Raises OSError if the directory is gone or cannot be written at all.
        """
        try:
            self._must_be_there()
            with contextlib.suppress(OSError):
                self.describe()
            status.replace(self._root, str(self._name / STATUS), status.stamp(state, self._began, message, code))
        finally:
            os.close(self._held)

    @contextmanager
    def logged(self) -> Iterator[None]:
        """Send log records, warnings and the traceback of any exception to log.txt."""
        logger = logging.getLogger("estlab")
        level, propagate, raise_exceptions = logger.level, logger.propagate, logging.raiseExceptions
        logging.raiseExceptions = False  # a full disk is reported once, by the file that matters
        with files.in_place(self._root, str(self._name / LOG)) as stream:
            stream.seek(0, os.SEEK_END)
            handler = logging.StreamHandler(io.TextIOWrapper(stream, encoding="utf-8", write_through=True))
            handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
            logger.setLevel(logging.INFO)
            logger.propagate = False
            logger.addHandler(handler)
            try:
                with in_a_line(logger.warning):
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
                logger.setLevel(level)
                logger.propagate, logging.raiseExceptions = propagate, raise_exceptions

    def write(self, name: str, write: Callable[[BinaryIO], object]) -> Path:
        """Write a file of the directory; creates folders in its name.

        Raises OSError if it cannot be written, or if the directory is no longer the one that was claimed.
        """
        self._must_be_there()
        path = files.write(self._root, str(self._name / name), write, sync=False)
        self._written.add(str(self._name / name))
        return path

    def sync(self) -> None:
        """Wait until the disk has everything written so far. Raises OSError if it refuses some of it."""
        self._must_be_there()
        files.sync(self._root, sorted(self._written))

    def write_text(self, name: str, text: str) -> Path:
        """:meth:`write` for text."""
        return self.write(name, lambda stream: stream.write(text.encode()))

    def describe(self, **facts: Any) -> None:
        """Add to run.json, which records what ran, on what, and from which data."""
        self._facts |= facts
        self.write_text(RUN, json.dumps(self.facts(), indent=2) + "\n")

    def facts(self) -> dict[str, Any]:
        """The current content of run.json."""
        return {
            **provenance.origin(),
            **self._facts,
            "began": status.iso(self._began),
            "wall_time_s": round(time.monotonic() - self._clock, 3),
            "peak_memory_mb": round(provenance.peak_memory() / 2**20, 1),
        }

    def keep_sources(self, packages: Iterable[str]) -> None:
        """Store the source of each imported module of these packages, as text only, and its hash in run.json."""
        found = [one for one in sources(packages) if one.module not in self._kept]
        for one in found:
            if one.text is not None:
                self.write(f"{PLUGINS}/{one.module}.txt", partial(_write, one.text))
            self._kept[one.module] = {"module": one.module, "file": one.file, "sha256": one.sha256}
        if found:
            self.describe(plugins=list(self._kept.values()))

    def link_latest(self, root: Path) -> None:
        """Make ``latest`` in the folder of all runs point here."""
        link_latest(self.path, root)

    def is_there(self) -> bool:
        """Whether the directory is still the one that was claimed."""
        try:
            with files.folder(self._root, self._name) as handle:
                return os.path.samestat(os.fstat(handle), self._identity)
        except OSError:
            return False

    def _must_be_there(self) -> None:
        if not self.is_there():
            raise OSError(errno.ENOENT, "was removed or replaced while the run wrote to it", str(self.path))


def _write(content: bytes, stream: BinaryIO) -> None:
    stream.write(content)


def link_latest(path: Path, root: Path) -> None:
    """Make ``latest`` in the folder of all runs point to a directory in it. Does nothing without symbolic links.

    Anything of that name that is not a link belongs to somebody, and stays.
    """
    with contextlib.suppress(OSError):
        if not path.resolve().is_relative_to(root.resolve()):
            return
        if os.path.lexists(root / "latest") and not (root / "latest").is_symlink():
            return
        link = root / f".latest.{os.getpid()}"
        try:
            link.unlink(missing_ok=True)
            link.symlink_to(path.resolve().relative_to(root.resolve()), target_is_directory=True)
            os.replace(link, root / "latest")
        finally:
            link.unlink(missing_ok=True)
