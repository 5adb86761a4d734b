"""Tables of numbers in text files: columns in any white space or between delimiters, ``#`` begins a comment."""

import io
import itertools
import warnings
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from estlab.datasets.files import read_bytes
from estlab.datasets.promises import Column, check
from estlab.errors import UserError
from estlab.maths.space import Array

_LONGEST = 2**16  # bytes of a line


def read_table(path: Path, columns: Sequence[Column], delimiter: str | None = None, timed: bool = True) -> Array:
    """The numbers in a file, (rows, columns). delimiter: what stands between cells; None for white space.

    timed: rows carry times, so that one may be removed; else each is a step.
    Raises UserError, naming file and line, where the file is missing or empty, a row has another number of cells,
    or a cell is not the number that is promised.
    """
    content = read_bytes(path)
    signs = np.frombuffer(content, np.uint8)
    ends = np.flatnonzero((signs == ord("\n")) | (signs == ord("\r")))
    lengths = np.diff(np.concatenate([[-1], ends, [signs.size]]))
    if lengths.max() > _LONGEST:
        raise UserError(f"{path}:{int(lengths.argmax()) + 1}: a line of {lengths.max()} bytes; not a table of numbers")
    try:
        text = io.StringIO(content.decode("utf-8-sig"), newline=None)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an empty file is ours to report
            table = np.loadtxt(text, ndmin=2, comments="#", delimiter=delimiter)
    except ValueError as error:
        raise UserError(_first_fault(path, columns, delimiter)) from error
    if table.size == 0:
        raise UserError(f"{path}: no data rows; expected the columns {_names(columns)}")
    if table.shape[1] != len(columns):
        raise UserError(_first_fault(path, columns, delimiter))
    check(columns, table.T, partial(place, path), timed)
    return np.asarray(table)


def place(path: Path, row: int) -> str:
    """Where a data row, from 0, is: file and line, from 1."""
    lines = (number for number, _ in _data_lines(path))
    return f"{path}:{next(itertools.islice(lines, row, None), 0)}"


def format_table(header: tuple[str, ...], rows: Array, delimiter: str = "\t") -> str:
    """Comment lines and delimited rows, every number written so that it reads back the same."""
    comments = "".join(f"# {line}\n" for line in header)
    body = "".join(delimiter.join(_shortest(cell) for cell in row) + "\n" for row in rows.tolist())
    return comments + body


def _shortest(value: float) -> str:
    return str(int(value)) if value.is_integer() and abs(value) < 1e6 else repr(value)


def _shown(cell: str) -> str:
    """A cell in quotes, short and of plain signs, whatever is in it."""
    plain = cell if cell.isascii() and cell.isprintable() else ascii(cell)[1:-1]
    return f"'{plain[:30]}'" + ("..." if len(plain) > 30 else "")


def _data_lines(path: Path, delimiter: str | None = None) -> Iterator[tuple[int, list[str]]]:
    text = io.StringIO(read_bytes(path).decode("utf-8-sig", errors="replace"), newline=None)
    for number, line in enumerate(text, start=1):
        cells = line.split("#", 1)[0].strip()
        if cells:
            yield number, [cell.strip() for cell in cells.split(delimiter)]


def _names(columns: Sequence[Column]) -> str:
    return " ".join(column.name for column in columns)


def _first_fault(path: Path, columns: Sequence[Column], delimiter: str | None) -> str:
    expected = f"expected the {len(columns)} columns {_names(columns)}"
    for number, cells in _data_lines(path, delimiter):
        if len(cells) != len(columns):
            return f"{path}:{number}: {len(cells)} columns; {expected}"
        for column, cell in zip(columns, cells, strict=True):
            try:
                float(cell)
            except ValueError:
                hint = "; write nan for what was not measured" if column.missing and not cell else ""
                return f"{path}:{number}: {column.name} is {_shown(cell)}, not a number; {expected}{hint}"
    return f"{path}: not a text table of numbers; {expected}"
