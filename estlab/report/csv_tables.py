"""Tables as CSV files."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, BinaryIO

import numpy as np

from estlab.maths.space import Array

Table = Mapping[str, Any] | Sequence[Mapping[str, Any]]
Columns = dict[str, Array]
Spelled = dict[tuple[str, bytes], list[str]]


def of_filters(by_filter: Mapping[str, Table], seed: int) -> Columns:
    """Columns of the tables of several filters one after another; the filter begins each line, the seed ends it."""
    parts = {name: _by_column(table) for name, table in by_filter.items()}
    sizes = [next((column.size for column in part.values()), 0) for part in parts.values()]
    columns: Columns = {"filter": np.repeat(list(parts), sizes)}
    for name in dict.fromkeys(name for part in parts.values() for name in part):
        columns[name] = np.concatenate([part[name] for part in parts.values() if name in part])
    return {**columns, "seed": np.full(sum(sizes), seed)}


def of_rows(rows: Sequence[Mapping[str, Any]], seed: int) -> Columns:
    """Columns of a table by row, the seed last in each line."""
    return {**_by_column(rows), "seed": np.full(len(rows), seed)}


def write(columns: Mapping[str, Any], stream: BinaryIO) -> None:
    """Write a table by column."""
    spelled: Spelled = {}
    texts = [_texts(_array(values), spelled) for values in columns.values()]
    lines = [",".join(map(_quoted, columns)), *map(",".join, zip(*texts, strict=True)), ""]
    stream.write("\n".join(lines).encode())


def _by_column(table: Table) -> dict[str, Array]:
    if not isinstance(table, Mapping):
        table = {name: [row[name] for row in table] for name in (table[0] if table else ())}
    return {name: _array(values) for name, values in table.items()}


def _array(values: Iterable[Any]) -> Array:
    """A column: of numbers, which are whole if all are; else as they are. None is missing."""
    if isinstance(values, np.ndarray):
        return values
    found = [np.nan if value is None else value for value in values]
    return np.array(found, dtype=object if any(isinstance(value, str | bool) for value in found) else None)


def _texts(column: Array, spelled: Spelled) -> list[str]:
    """The cells of a column; nothing for NaN. spelled: magnitudes that have been spelled already."""
    if column.dtype.kind in "fiu":
        return _numbers(column, spelled)
    cells = column.tolist()
    if column.dtype.kind == "U":
        known = {text: _quoted(text) for text in set(cells)}
        return [known[text] for text in cells]
    return ["" if cell != cell else _quoted(str(cell)) for cell in cells]


def _numbers(column: Array, spelled: Spelled) -> list[str]:
    """Numbers in full, so that they read back the same.

    Spelling is what a table of many lines takes its time for, so equal neighbours are spelled once, and so are columns
    that differ in sign alone: both bounds of a band, an error and the root of its square.
    """
    magnitude = np.nan_to_num(np.abs(column), nan=-1.0, posinf=np.inf)
    key = column.dtype.char, magnitude.tobytes()
    if key not in spelled:
        new = np.append(True, magnitude[1:] != magnitude[:-1])[: magnitude.size]
        texts = ["" if value < 0 else repr(value) for value in magnitude[new].tolist()]
        spelled[key] = texts if new.all() else [texts[place] for place in (np.cumsum(new) - 1).tolist()]
    minus = np.signbit(column) & ~np.isnan(column)
    if not minus.any():
        return spelled[key]
    return ["-" + text if below else text for text, below in zip(spelled[key], minus.tolist(), strict=True)]


def _quoted(text: str) -> str:
    """A cell as it stands in the file: in quotes where it has a comma, a quote or a line's end."""
    return '"' + text.replace('"', '""') + '"' if any(sign in text for sign in ',"\r\n') else text
