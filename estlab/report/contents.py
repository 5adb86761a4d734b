"""The content of a directory, read as data: bounded, without following links, importing or running anything."""

import contextlib
import csv
import io
import json
import os
from pathlib import Path
from typing import Any, NamedTuple

from estlab.rundir import files

_BYTES = 4 * 2**20  # bytes of a text file to read
_PLOT_BYTES = 8 * 2**20
_ROWS = 5000
_PLOTS = 60
_FILES = 500
_PNG = b"\x89PNG\r\n\x1a\n"


class UnusableError(Exception):
    """A file that is missing or invalid, in a sentence for the page."""


class Table(NamedTuple):
    """Rows of a CSV file as text, and a remark if some are left out."""

    rows: list[dict[str, str]]
    remark: str = ""


class File(NamedTuple):
    """Path below the directory, and bytes."""

    name: str
    size: int


class Contents:
    """The files of one directory."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def content(self, name: str, most: int, last: bool = False) -> tuple[bytes, bool]:
        """The first (or last) bytes of a file, and whether some are left out.

        Raises UnusableError for a file that is missing, cannot be read, is a link or is not a regular file.
        """
        try:
            with files.opened(self.path, name) as stream:
                size = os.fstat(stream.fileno()).st_size
                stream.seek(max(0, size - most) if last else 0)
                return stream.read(most), size > most
        except FileNotFoundError as error:
            raise UnusableError(f"{name} is missing.") from error
        except files.RefusedError as error:
            where = Path(error.filename).relative_to(self.path)
            within = "" if str(where) == name else f"{name} cannot be read: "
            raise UnusableError(f"{within}{where} {error.strerror}.") from error
        except OSError as error:
            raise UnusableError(f"{name} cannot be read ({error.strerror}).") from error

    def text(self, name: str, most: int = _BYTES, last: bool = False) -> tuple[str, str]:
        """A file's text, and a remark if it is cut.

        Raises UnusableError like :meth:`content`.
        """
        content, cut = self.content(name, most, last)
        remark = f"Only the {'last' if last else 'first'} {size(most)} of {name} are shown." if cut else ""
        return content.decode("utf-8", "replace"), remark

    def table(self, name: str) -> Table:
        """A CSV file.

        Raises UnusableError if it is missing or is not a table.
        """
        text, cut = self.text(name)
        whole = text.rpartition("\n")[0] if cut else text
        rows: list[dict[str, str]] = []
        try:
            reader = csv.DictReader(io.StringIO(whole, newline=""))
            headings = reader.fieldnames or []
            for cells in reader:
                if len(rows) == _ROWS:
                    cut = "more"
                    break
                rows.append({heading: cells.get(heading) or "" for heading in headings})
        except csv.Error as error:
            raise UnusableError(f"{name} cannot be read as a table ({error}).") from error
        if not headings:
            raise UnusableError(f"{name} is empty.")
        return Table(rows, f"Only the first {len(rows)} rows of {name} are shown." if cut else "")

    def record(self, name: str) -> dict[str, Any]:
        """A JSON file that contains an object.

        Raises UnusableError if it is missing or contains none.
        """
        text, _ = self.text(name)
        try:
            found = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise UnusableError(f"{name} cannot be read as JSON.") from error
        if not isinstance(found, dict):
            raise UnusableError(f"{name} contains no object.")
        return found

    def plots(self, folder: str) -> tuple[dict[str, bytes], list[str]]:
        """The PNG files of a folder by name, and a remark for each that is left out."""
        try:
            names = [name for name in files.names(self.path, folder) if name.endswith(".png")]
        except files.RefusedError as error:
            return {}, [f"{folder}/ {error.strerror}."]
        except OSError:
            return {}, []
        found, remarks = {}, []
        for name in names[:_PLOTS]:
            try:
                content, cut = self.content(f"{folder}/{name}", _PLOT_BYTES)
            except UnusableError as error:
                remarks.append(str(error))
                continue
            if cut or not content.startswith(_PNG):
                remarks.append(f"{folder}/{name} is {'too large' if cut else 'not a PNG picture'} and is left out.")
            else:
                found[name] = content
        if len(names) > _PLOTS:
            remarks.append(f"{len(names) - _PLOTS} more plots are in {folder}/.")
        return found, remarks

    def files(self, *folders: str) -> list[File]:
        """The regular files of the directory and of these folders in it, by name, without hidden files and links."""
        found = []
        for folder in ("", *folders):
            with contextlib.suppress(OSError), files.folder(self.path, folder) as handle, os.scandir(handle) as entries:
                for entry in entries:
                    if entry.is_file(follow_symlinks=False) and not entry.name.startswith("."):
                        name = f"{folder}/{entry.name}" if folder else entry.name
                        found.append(File(name, entry.stat(follow_symlinks=False).st_size))
        return sorted(found)[:_FILES]

    def has(self, name: str) -> bool:
        """Whether there is anything of this name, even a link to nowhere."""
        return files.has(self.path, name)

    def is_folder(self, name: str) -> bool:
        """Whether a name is that of a folder in the directory itself, not a link."""
        path = self.path / name
        return Path(name).name == name and name not in ("", ".", "..") and path.is_dir() and not path.is_symlink()


def size(count: int) -> str:
    """A number of bytes in words."""
    for unit, scale in (("MB", 2**20), ("kB", 2**10)):
        if count >= scale:
            return f"{count / scale:.3g} {unit}"
    return f"{count} bytes"


def as_number(text: str | None) -> float:
    """A cell's number; NaN if it contains none."""
    try:
        return float(text or "nan")
    except ValueError:
        return float("nan")
