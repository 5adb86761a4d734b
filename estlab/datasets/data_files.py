"""Finds the files of a recording by name and opens them: regular files of bounded size."""

import difflib
import os
import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from estlab.errors import UserError

MOST = 256 * 2**20  # bytes of a file, and of its unpacked content

_KINDS = (
    (stat.S_ISDIR, "Is a directory"),
    (stat.S_ISFIFO, "a pipe, not a file"),
    (stat.S_ISSOCK, "a socket, not a file"),
    (stat.S_ISCHR, "a device, not a file"),
    (stat.S_ISBLK, "a device, not a file"),
)


@dataclass(frozen=True)
class Options:
    """How to read recordings.

    names: file names by kind, where they differ from the layout's. clock_faults: the largest share of rows with
    repeated or backward times that may be left out. clock_gap: how long a command is held [s].
    """

    names: Mapping[str, str] = field(default_factory=dict)
    clock_faults: float = 0.05
    clock_gap: float = 2.0


DEFAULTS = Options()


@dataclass(frozen=True)
class Files:
    """The files of one recording.

    folder: that holds them, or the first file itself if the others may be missing. prefix: of their names. layout:
    the names of each kind of file, the original's first. names: other names, by kind.
    """

    folder: Path
    prefix: str
    layout: Mapping[str, Sequence[str]]
    names: Mapping[str, str] = field(default_factory=dict)

    def path(self, kind: str, shared: bool = False) -> Path:
        """The file of this kind. shared: it may lack the prefix.

        Raises UserError that names the file, similar files that exist, and the remedy.
        """
        found = self.find(kind, shared)
        if found is None:
            remedy = self.hint(kind) or (
                "data.path must be the folder that holds it, data.prefix the beginning of its name, "
                f"or data.files.{kind} its name"
            )
            raise UserError(f"{self._home / self._wanted(kind, shared)[0]}: no such file; {remedy}")
        return found

    def alone(self, kind: str) -> None:
        """Raise UserError if data.path is a file and this kind, which is also required, is not named."""
        if self._is_file and kind not in self.names:
            first, *_ = self.layout
            raise UserError(
                f"data.path: {self.folder} is one file of several; give the folder that holds "
                f"{self.prefix}{self.layout[first][0]} and {self.prefix}{self.layout[kind][0]}"
            )

    def find(self, kind: str, shared: bool = False) -> Path | None:
        """The file of this kind, in upper or lower case; None if there is none.

        Raises UserError for a folder that cannot be listed, for two names that differ only in case, and for a named
        file that does not exist.
        """
        if kind in self.names:
            named = self._home / Path(self.names[kind]).expanduser()
            if not named.exists():
                raise UserError(f"data.files.{kind}: {named}: no such file{self._near([named.name], self._present())}")
            return named
        if self._is_file and kind == next(iter(self.layout)):
            return self.folder
        present = self._present()
        for name in self._wanted(kind, shared):
            alike = [there for there in present if there.casefold() == name.casefold()]
            if name in alike or len(alike) == 1:
                return self._home / (name if name in alike else alike[0])
            if alike:
                raise UserError(
                    f"{self._home / name}: {' and '.join(alike)} differ only in case; choose one with "
                    f"data.files.{kind}={alike[0]}"
                )
        return None

    def hint(self, kind: str) -> str:
        """Files that resemble this kind, and how to select them; or nothing."""
        endings = [name.casefold() for name in self.layout[kind]]
        free = self._free(kind)
        starts = sorted({n[: -len(e)] for n in free for e in endings if n.casefold().endswith(e)} - {""})
        if starts:
            return f"set data.prefix to one of: {', '.join(map(repr, starts))}"
        return self._near(self._wanted(kind, shared=True), free, kind).removeprefix("; ")

    def lacks(self, kind: str) -> str:
        """The remark for a recording without the file of this kind."""
        hint = self.hint(kind)
        return f"no {self._wanted(kind, shared=False)[0]} in {self._home}" + (f"; {hint}" if hint else "")

    @property
    def _is_file(self) -> bool:
        return self.folder.exists() and not self.folder.is_dir()

    @property
    def _home(self) -> Path:
        return self.folder.parent if self._is_file else self.folder

    def _wanted(self, kind: str, shared: bool) -> list[str]:
        return [self.prefix + name for name in self.layout[kind]] + (list(self.layout[kind]) if shared else [])

    def _present(self) -> list[str]:
        if not self._home.is_dir():
            raise UserError(f"data.path: no folder {self.folder}")
        try:
            return sorted(there.name for there in self._home.iterdir())
        except OSError as error:
            raise UserError(f"data.path: {self._home} cannot be read ({error.strerror})") from error

    def _free(self, kind: str) -> list[str]:
        """Files that belong to no other kind; the longest matching ending decides the kind."""
        endings = sorted(
            ((n.casefold(), k) for k, names in self.layout.items() for n in names), key=lambda e: -len(e[0])
        )
        owner = {n: next((k for end, k in endings if n.casefold().endswith(end)), kind) for n in self._present()}
        return [name for name, whose in owner.items() if whose == kind]

    @staticmethod
    def _near(wanted: Sequence[str], present: Sequence[str], kind: str | None = None) -> str:
        by_stem = {Path(name).stem.casefold(): name for name in present}
        for name in wanted:
            close = difflib.get_close_matches(Path(name).stem.casefold(), list(by_stem), n=1, cutoff=0.7)
            if close:
                there = by_stem[close[0]]
                return f"; there is {there}" + (f": select it with data.files.{kind}={there}" if kind else "")
        return ""


def read_bytes(path: Path) -> bytes:
    """The content of a regular file of bounded size.

    Raises UserError for anything else. A pipe without a writer does not block.
    """
    try:
        mode = path.stat().st_mode
        for is_kind, what in _KINDS:
            if is_kind(mode):
                raise UserError(f"{path}: cannot be read ({what})")
        with open(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)), "rb") as stream:
            check_size(path, os.fstat(stream.fileno()).st_size)
            content = stream.read(MOST + 1)
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from error
    check_size(path, len(content))
    return content


def check_size(path: Path, size: int, what: str = "") -> None:
    """Raise UserError if a recording has more bytes than allowed."""
    if size > MOST:
        raise UserError(f"{path}: {what}{size / 1e9:.3g} GB; at most {MOST / 1e9:.2g} GB are read")
