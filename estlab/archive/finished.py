"""A run directory read as the data that it is: nothing in it is imported, executed, followed out of it or believed."""

import io
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from estlab import rundir
from estlab.errors import UserError, printable

if TYPE_CHECKING:
    from pandas import DataFrame

    from estlab.maths.space import Array

STATES = ("running", "ok", "failed", "interrupted")

# Beyond these a file is none of ours, or would fill the memory.
_CONFIG_BYTES, _RECORD_BYTES, _TABLE_BYTES, _ARRAY_BYTES = 2**18, 2**22, 2**30, 2**33

_DEEPEST = 50

_NAME = re.compile(r"\w[\w.+-]*(/\w[\w.+-]*)*")


@dataclass(frozen=True)
class Finished:
    """A run's directory, its status, what run.json says, and its configuration as plain data.

    scenario, filter: what they were called, which random numbers hang on; filter is the first of several filters.
    filters: all of them. changes: what was typed beside these.
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


def is_run(folder: Path) -> bool:
    """Whether a directory has the status file of a run."""
    return (folder / rundir.STATUS).is_file() and not (folder / rundir.STATUS).is_symlink()


def read(path: Path) -> Finished:
    """A run directory without its tables.

    Raises UserError, naming the file, for one that cannot be read or is not what a run writes.
    """
    found, facts, config = status(path), _json(path, rundir.RUN), _config(path)
    file, names = path / rundir.RUN, facts.get("names")
    if not isinstance(names, Mapping) or not {"scenario", "filter"} <= set(names):
        raise UserError(f"{file}: does not say what its scenario and filter were called; an earlier estlab wrote it")
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
    """What status.json says, whose status is one of STATES.

    Raises UserError as :func:`read`.
    """
    found = _json(path, rundir.STATUS)
    if found.get("status") not in STATES:
        raise UserError(f"{path / rundir.STATUS}: has no status that a run writes")
    return found


def unfinished(path: Path, found: Mapping[str, Any]) -> str:
    """Why a run with this status has no whole result; nothing if it has one.

    One that only did not find what it was expected to has: its expectations are the last table to be written.
    """
    state = str(found["status"])
    if state == "ok" or (state == "failed" and (path / rundir.EXPECTATIONS).is_file()):
        return ""
    if state == "running":
        return "still running" if rundir.at_work(found) else "unfinished, and its process is gone"
    return f"{state}: {found.get('error') or 'no reason given'}"


def table(folder: Path, name: str, words: Sequence[str], numbers: Sequence[str] | None = None) -> "DataFrame":
    """A table's columns of words and of numbers; numbers None: all the others.

    Raises UserError, naming the file, for one that is not such a table.
    """
    import pandas as pd

    text = _content(folder, name, _TABLE_BYTES)
    file = folder / name
    try:
        heads = list(pd.read_csv(io.BytesIO(text), nrows=0).columns)
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
    except Exception as error:  # pandas has many of its own
        raise UserError(f"{file}: is no table that a run writes ({' '.join(str(error).split())[:120]})") from error


def array_names(folder: Path, name: str) -> list[str]:
    """The names of the arrays of an .npz file, sorted.

    Raises UserError, naming the file, for one that is not such an archive.
    """
    import zipfile

    file = _regular(folder, name)
    try:
        with zipfile.ZipFile(file) as archive:
            if any(member.file_size > _ARRAY_BYTES for member in archive.infolist()):
                raise UserError(f"{file}: unpacks to more than what a run writes")
            return sorted(member.filename.removesuffix(".npy") for member in archive.infolist())
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise UserError(f"{file}: is no archive that a run writes") from error


def arrays(folder: Path, name: str) -> Iterator["Array"]:
    """The arrays of an .npz file, of numbers alone, one at a time in the order of their names; raises the same."""
    import numpy as np

    names = array_names(folder, name)
    file = _regular(folder, name)
    for key in names:
        try:
            with np.load(file, allow_pickle=False) as archive:
                found = archive[key]
        except Exception as error:  # whatever a broken archive makes zipfile and numpy raise
            raise UserError(f"{file}: its array {key} cannot be read") from error
        yield found


def text(folder: Path, name: str, most: int = _RECORD_BYTES) -> str:
    """A short text file.

    Raises UserError, naming the file, for one that is not there or too long.
    """
    try:
        return _content(folder, name, most).decode()
    except UnicodeDecodeError as error:
        raise UserError(f"{folder / name}: is not text") from error


def _content(folder: Path, name: str, most: int) -> bytes:
    """A file's bytes, if it is a regular file of this directory and not larger than that."""
    path = _regular(folder, name)
    try:
        with open(path, "rb") as stream:
            if os.fstat(stream.fileno()).st_size > most:
                raise UserError(f"{path}: is larger than what a run writes")
            return stream.read(most + 1)
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror})") from error


def _regular(folder: Path, name: str) -> Path:
    """The path of a regular file of the directory: no pipe, no device, no link that leads out of it."""
    path = folder / name
    try:
        if not path.resolve().is_relative_to(folder.resolve()):
            raise UserError(f"{path}: leads out of the run directory")
        if not path.is_file():
            raise UserError(f"{path}: is not {'a file' if os.path.lexists(path) else 'there'}")
    except (OSError, ValueError, RuntimeError) as error:  # a link to itself, a name with a zero byte
        raise UserError(f"{path}: cannot be read ({error})") from error
    return path


def _name(file: Path, name: object) -> str:
    """Names end up in paths."""
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise UserError(f"{file}: {str(name)[:40]!r} is no name of a scenario or filter")
    return name


def _json(folder: Path, name: str) -> dict[str, Any]:
    try:
        found = json.loads(text(folder, name))
    except (ValueError, RecursionError) as error:
        raise UserError(f"{folder / name}: cannot be read as JSON") from error
    if not isinstance(found, dict):
        raise UserError(f"{folder / name}: is not what a run writes")
    return found


def plain_yaml(content: str) -> Any:
    """A YAML text as plain data, by the loader that makes nothing else.

    Raises ValueError for anything else, for an alias, by which a short file could stand for an endless one, and for
    what lies deeper than any configuration.
    """
    depth = 0
    try:
        for event in yaml.parse(content, Loader=yaml.SafeLoader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if isinstance(event, yaml.AliasEvent) or depth > _DEEPEST:
                raise ValueError("an alias, or too deep")
        return yaml.safe_load(content)
    except (yaml.YAMLError, RecursionError, OverflowError) as error:
        raise ValueError("not plain YAML") from error


def _config(folder: Path) -> dict[str, Any]:
    file = folder / rundir.CONFIG
    try:
        found = plain_yaml(text(folder, rundir.CONFIG, _CONFIG_BYTES))
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
