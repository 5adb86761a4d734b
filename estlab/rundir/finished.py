"""Reads a run directory as untrusted data: nothing in it is imported, executed, followed or trusted."""

import io
import json
import os
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import yaml

from estlab import rundir
from estlab.errors import UserError, printable
from estlab.rundir import files
from estlab.rundir.layout import ARRAY_BYTES, CONFIG_BYTES, RECORD_BYTES, TABLE_BYTES

if TYPE_CHECKING:
    from pandas import DataFrame

    from estlab.maths.space import Array

_DEEPEST = 50

_UNFINISHED = {
    "alive": "still running",
    "gone": "unfinished, and its process is gone",
    "unknown": "unfinished; whether it is still running cannot be seen from here",
}

_NAME = re.compile(r"\w[\w.+-]*(/\w[\w.+-]*)*")


@dataclass(frozen=True)
class Finished:
    """A run's directory, its status, the content of run.json, and its configuration as plain data.

    scenario, filter: their names, which determine random numbers; filter is the first of several filters. filters:
    all of them. changes: the words typed in addition.
    """

    path: Path
    status: Mapping[str, Any]
    facts: Mapping[str, Any]
    config: Mapping[str, Any]
    scenario: str
    filter: str
    filters: tuple[str, ...]
    changes: tuple[str, ...]

    @property
    def data(self) -> dict[str, str]:
        """SHA-256 of each data file by its path."""
        listed = self.facts.get("data")
        files = [one for one in listed if isinstance(one, Mapping)] if isinstance(listed, list) else []
        return {str(one.get("file")): str(one.get("sha256")) for one in files}

    @property
    def plugins(self) -> dict[str, str]:
        """SHA-256 of the source of each module of plugins by its name."""
        return plugins_of(self.facts)


def plugins_of(facts: Mapping[str, Any]) -> dict[str, str]:
    """SHA-256 of the source of each module of plugins, by its name, from run.json."""
    listed = facts.get("plugins")
    modules = [one for one in listed if isinstance(one, Mapping)] if isinstance(listed, list) else []
    return {printable(str(one.get("module")))[:100]: printable(str(one.get("sha256"))) for one in modules[:1000]}


def is_run(folder: Path) -> bool:
    """Whether a directory has the status file of a run."""
    return files.is_file(folder, rundir.STATUS)


def read(path: Path) -> Finished:
    """A run directory without its tables.

    Raises UserError that names the file if one cannot be read or was not written by a run.
    """
    found, facts, config = status(path), _json(path, rundir.RUN), _config(path)
    file, names = path / rundir.RUN, facts.get("names")
    if not isinstance(names, Mapping) or not {"scenario", "filter"} <= set(names):
        raise UserError(f"{file}: lacks the names of scenario and filter, because an earlier estlab wrote it")
    scenario, filter = (_name(file, names[part]) for part in ("scenario", "filter"))
    several, changes = config.get("filters"), names.get("changes")
    filters = several if isinstance(several, Mapping) and several else (filter,)
    return Finished(
        path,
        found,
        facts,
        config,
        scenario,
        filter,
        tuple(_name(path / rundir.CONFIG, name) for name in filters),
        tuple(printable(str(change))[:100] for change in changes[:100]) if isinstance(changes, list) else (),
    )


def status(path: Path) -> dict[str, Any]:
    """The content of status.json, whose status is one of rundir.STATES.

    Raises UserError like :func:`read`.
    """
    found = _json(path, rundir.STATUS)
    if found.get("status") not in rundir.STATES:
        raise UserError(f"{path / rundir.STATUS}: contains no status of a run")
    return found | {"status": rundir.state_of(found)}


def unfinished(found: Mapping[str, Any]) -> str:
    """Why a run with this status has no complete result; empty if it has one, whether or not expectations were met."""
    state = str(found["status"])
    if state in rundir.WHOLE:
        return ""
    if state == "running":
        return _UNFINISHED[rundir.worker(found)]
    return f"{state}: {found.get('error') or 'no reason given'}"


def table(
    folder: Path, name: str, words: Sequence[str], numbers: Sequence[str] | None = None, all_of_them: bool = True
) -> "DataFrame":
    """A table's columns of words and of numbers; numbers None: all the others.

    all_of_them: whether a table that lacks one of the words is refused; an earlier estlab may have written it.

    Raises UserError that names the file if it is not such a table.
    """
    import pandas as pd

    text = _content(folder, name, TABLE_BYTES)
    file = folder / name
    try:
        heads = list(pd.read_csv(io.BytesIO(text), nrows=0).columns)
        words = words if all_of_them else [column for column in words if column in heads]
        lacking = [column for column in (*words, *(numbers or ())) if column not in heads]
        if lacking:
            raise UserError(f"{file}: has no column {lacking[0]}")
        wanted = [column for column in heads if column not in words] if numbers is None else list(numbers)
        types: dict[Any, Any] = {**dict.fromkeys(words, str), **dict.fromkeys(wanted, float)}
        empty: dict[Any, list[str]] = {column: [""] for column in wanted}
        return pd.read_csv(
            io.BytesIO(text), usecols=[*words, *wanted], dtype=types, na_values=empty, keep_default_na=False
        )
    except UserError:
        raise
    except Exception as error:  # pandas raises many kinds
        raise UserError(f"{file}: is not a table of a run ({' '.join(str(error).split())[:120]})") from error


def array_names(folder: Path, name: str) -> list[str]:
    """The names of the arrays of an .npz file, sorted.

    Raises UserError that names the file if it is not such an archive.
    """
    with _archive(folder, name) as stream:
        return sorted(_array_names(folder / name, stream))


def arrays(folder: Path, name: str) -> Iterator["Array"]:
    """The arrays of an .npz file, numbers only, one at a time in the order of their names; raises the same."""
    for _, array in _arrays(folder, name, sorted):
        yield array


def stored(folder: Path, name: str) -> dict[str, "Array"]:
    """All arrays of an .npz file by their names, in the file's order; raises the same."""
    return dict(_arrays(folder, name, list))


def _arrays(folder: Path, name: str, ordered: Callable[[list[str]], list[str]]) -> Iterator[tuple[str, "Array"]]:
    import numpy as np

    file = folder / name
    with _archive(folder, name) as stream:
        names = ordered(_array_names(file, stream))
        stream.seek(0)
        with np.load(stream, allow_pickle=False) as archive:
            for key in names:
                try:
                    found = archive[key]
                except Exception as error:  # whatever zipfile and numpy raise for a broken archive
                    raise UserError(f"{file}: its array {key} cannot be read") from error
                yield key, found


@contextmanager
def _archive(folder: Path, name: str) -> Iterator[BinaryIO]:
    with _readable(folder / name), files.opened(folder, name, ARRAY_BYTES) as stream:
        yield stream


def _array_names(file: Path, stream: BinaryIO) -> list[str]:
    """A run stores its arrays uncompressed, so an archive that unpacks to more was not written by a run."""
    try:
        size = os.fstat(stream.fileno()).st_size
        with zipfile.ZipFile(stream) as archive:
            members = archive.infolist()
    except (OSError, ValueError, RuntimeError, zipfile.BadZipFile) as error:
        raise UserError(f"{file}: is not an archive of a run") from error
    stored = all(member.compress_type == zipfile.ZIP_STORED for member in members)
    if not stored or sum(member.file_size for member in members) > size:
        raise UserError(f"{file}: unpacks to more than any file of a run")
    return [member.filename.removesuffix(".npy") for member in members]


def text(folder: Path, name: str, most: int = RECORD_BYTES) -> str:
    """A short text file.

    Raises UserError that names the file if it is missing or too long.
    """
    try:
        return _content(folder, name, most).decode()
    except UnicodeDecodeError as error:
        raise UserError(f"{folder / name}: is not text") from error


def _content(folder: Path, name: str, most: int) -> bytes:
    """A file's bytes, if it is a regular file of this directory and not larger than that."""
    with _readable(folder / name):
        return files.read(folder, name, most)


@contextmanager
def _readable(file: Path) -> Iterator[None]:
    """The body reads this file; failures become a UserError that names it."""
    try:
        yield
    except FileNotFoundError as error:
        raise UserError(f"{file}: no such file") from error
    except files.RefusedError as error:
        raise UserError(f"{error.filename}: {error.strerror}") from error
    except OSError as error:
        raise UserError(f"{file}: cannot be read ({error.strerror})") from error


def _name(file: Path, name: object) -> str:
    """Names end up in paths."""
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise UserError(f"{file}: {str(name)[:40]!r} is not the name of a scenario or filter")
    return name


def _json(folder: Path, name: str) -> dict[str, Any]:
    try:
        found = json.loads(text(folder, name))
    except (ValueError, RecursionError) as error:
        raise UserError(f"{folder / name}: cannot be read as JSON") from error
    if not isinstance(found, dict):
        raise UserError(f"{folder / name}: was not written by a run")
    return found


def plain_yaml(content: str) -> Any:
    """A YAML text as plain data, by the loader that makes nothing else.

    Raises ValueError for anything else, for an alias, by which a short file could stand for an endless one, and for
    values nested deeper than in any configuration.
    """
    depth = 0
    try:
        for event in yaml.parse(content, Loader=yaml.SafeLoader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if isinstance(event, yaml.AliasEvent) or depth > _DEEPEST:
                raise ValueError("an alias, or nested too deep")
        return yaml.safe_load(content)
    except (yaml.YAMLError, RecursionError, OverflowError) as error:
        raise ValueError("not plain YAML") from error


def _config(folder: Path) -> dict[str, Any]:
    file = folder / rundir.CONFIG
    try:
        found = plain_yaml(text(folder, rundir.CONFIG, CONFIG_BYTES))
    except ValueError as error:
        raise UserError(f"{file}: cannot be read as plain YAML") from error
    if not isinstance(found, dict) or not _named(found):
        raise UserError(f"{file}: is not a run's configuration")
    return found


def _named(node: Any) -> bool:
    """Whether all keys are texts."""
    if isinstance(node, dict):
        return all(isinstance(key, str) and _named(value) for key, value in node.items())
    return not isinstance(node, list) or all(map(_named, node))
