"""The only writer of CSV: tables by column or by row, with numbers in full."""

from collections.abc import Iterable, Mapping, Sequence
from numbers import Integral
from typing import Any, BinaryIO

import numpy as np

from estlab.maths.space import Array

Table = Mapping[str, Any] | Sequence[Mapping[str, Any]]
Spelled = dict[tuple[str, bytes], list[str]]


def write(table: Table, stream: BinaryIO) -> None:
    """Write one table, by column or by row. None and NaN become empty cells."""
    _write(stream, by_column(table))


def of_filters(by_filter: Mapping[str, Table], seed: int) -> dict[str, Array]:
    """The tables of several filters as one: the filter is the first column, the seed the last."""
    parts = {name: by_column(table) for name, table in by_filter.items()}
    sizes = [next((column.size for column in part.values()), 0) for part in parts.values()]
    columns = {"filter": np.repeat(list(parts), sizes)}
    for name in dict.fromkeys(name for part in parts.values() for name in part):
        columns[name] = np.concatenate([part[name] for part in parts.values() if name in part])
    return {**columns, "seed": np.full(sum(sizes), seed)}


def by_column(table: Table) -> dict[str, Array]:
    """A table by column, in either form."""
    if not isinstance(table, Mapping):
        table = {name: [row[name] for row in table] for name in (table[0] if table else ())}
    return {name: _array(values) for name, values in table.items()}


def _array(values: Iterable[Any]) -> Array:
    """A column: integers if all numbers are; otherwise the values unchanged. None means missing."""
    if isinstance(values, np.ndarray):
        return values
    found = [np.nan if value is None else value for value in values]
    known = [value for value in found if value == value]
    words = any(isinstance(value, str | bool) for value in known)
    # An array of floats would turn 12 into 12.0 if a number is missing beside it.
    counts_with_gaps = 0 < len(known) < len(found) and all(isinstance(value, Integral) for value in known)
    return np.array(found, dtype=object if words or counts_with_gaps else None)


def _write(stream: BinaryIO, columns: Mapping[str, Array]) -> None:
    spelled: Spelled = {}
    texts = [_texts(column, spelled) for column in columns.values()]
    lines = [",".join(map(_quoted, columns)), *map(",".join, zip(*texts, strict=True)), ""]
    stream.write("\n".join(lines).encode())


def _texts(column: Array, spelled: Spelled) -> list[str]:
    """The cells of a column; empty for NaN. spelled: magnitudes that are already formatted."""
    if column.dtype.kind in "fiu":
        return _numbers(column, spelled)
    cells = column.tolist()
    if column.dtype.kind == "U":
        known = {text: _quoted(text) for text in set(cells)}
        return [known[text] for text in cells]
    return ["" if cell != cell else _quoted(str(cell)) for cell in cells]


def _numbers(column: Array, spelled: Spelled) -> list[str]:
    """Numbers in full, so that they read back the same.

    Formatting takes most of the time for a long table, so equal neighbours are formatted once, and so are columns
    that differ only in sign: both bounds of a band, an error and the root of its square.
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
    """A cell as it stands in the file: in quotes if it contains a comma, a quote or a line break."""
    return '"' + text.replace('"', '""') + '"' if any(sign in text for sign in ',"\r\n') else text
