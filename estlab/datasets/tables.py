"""Tables of numbers in text files: columns in any white space or between delimiters, ``#`` begins a comment."""

import math
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from estlab.errors import UserError
from estlab.maths.space import Array


def read_table(path: Path, columns: tuple[str, ...], delimiter: str | None = None) -> Array:
    """The numbers in a file, (rows, columns). delimiter: what stands between cells; None for white space.

    Raises UserError, naming file and line, where the file is missing or empty, a row has another number of cells,
    or a cell is not a finite number.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an empty file is ours to report
            table = np.loadtxt(path, ndmin=2, comments="#", delimiter=delimiter, encoding="utf-8-sig")
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from error
    except ValueError as error:
        raise UserError(_first_fault(path, columns, delimiter)) from error
    if table.size == 0:
        raise UserError(f"{path}: no data rows; expected the columns {' '.join(columns)}")
    if table.shape[1] != len(columns) or not np.isfinite(table).all():
        raise UserError(_first_fault(path, columns, delimiter))
    return np.asarray(table)


def check_times(path: Path, time: Array, repeats: bool = False) -> None:
    """Raise UserError, naming the line, unless times ascend; equal neighbours pass if ``repeats``."""
    step = np.diff(time)
    bad = np.flatnonzero(step < 0.0 if repeats else step <= 0.0)
    if bad.size:
        row = int(bad[0]) + 1
        fault = "goes back" if step[row - 1] < 0.0 else "repeats the line before"
        raise UserError(
            f"{path}:{line_of_row(path, row)}: time {time[row]:.3f} {fault}; sort the file by its first column"
        )


def line_of_row(path: Path, row: int) -> int:
    """The line number, from 1, of a data row, from 0."""
    for position, (number, _) in enumerate(_data_lines(path)):
        if position == row:
            return number
    return 0


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
    with open(path, encoding="utf-8", errors="replace") as stream:
        for number, line in enumerate(stream, start=1):
            text = line.split("#", 1)[0].strip()
            if text:
                yield number, [cell.strip() for cell in text.split(delimiter)]


def _first_fault(path: Path, columns: tuple[str, ...], delimiter: str | None) -> str:
    expected = f"expected the {len(columns)} columns {' '.join(columns)}"
    for number, cells in _data_lines(path, delimiter):
        if len(cells) != len(columns):
            return f"{path}:{number}: {len(cells)} columns; {expected}"
        for name, cell in zip(columns, cells, strict=True):
            try:
                finite = math.isfinite(float(cell))
            except ValueError:
                return f"{path}:{number}: {name} is {_shown(cell)}, not a number; {expected}"
            if not finite:
                return f"{path}:{number}: {name} is {cell}; remove the row, a gap is better than a guess"
    return f"{path}: not a text table of numbers; {expected}"
