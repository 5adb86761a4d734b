"""Tables of numbers in text files: columns separated by white space or by a delimiter; ``#`` starts a comment."""

import io
import itertools
import warnings
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from estlab.datasets.data_files import read_bytes
from estlab.datasets.promises import Column, check
from estlab.errors import UserError
from estlab.maths.space import Array

_LONGEST = 2**16  # bytes of a line
_COMPRESSED = (b"\x1f\x8b", b"PK\x03\x04", b"BZh", b"\xfd7zXZ", b"\x28\xb5\x2f\xfd")
_DELIMITERS = {",": "commas", ";": "semicolons", "\t": "tabs", None: "white space"}
_HEADING = "a line that is not data must begin with #"


def read_table(path: Path, columns: Sequence[Column], delimiter: str | None = None, timed: bool = True) -> Array:
    """The numbers in a file, (rows, columns). delimiter: between cells; None for white space.

    timed: rows carry times, so one may be removed; otherwise each row is a step. Between delimiters an empty cell is
    NaN, and in a table of one column so is an empty line.
    Raises UserError that names file and line if the file is missing or empty, a row has the wrong number of cells, or
    a cell is not the number that its column requires.
    """
    content = read_bytes(path)
    _check_text(path, content)
    # Bytes that are not UTF-8 may stand in a comment; in a cell they are not a number.
    text = content.decode("utf-8-sig", errors="replace")
    if delimiter:
        rows = _data_lines(text, delimiter, blank=len(columns) == 1)
        words = [_word(column) for column in columns]
        text = "\n".join(
            delimiter.join(
                cell or word for cell, word in itertools.zip_longest(cells, words[: len(cells)], fillvalue="")
            )
            for _, cells in rows
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # we report an empty file ourselves
            table = np.loadtxt(io.StringIO(text, newline=None), ndmin=2, comments="#", delimiter=delimiter)
    except ValueError as error:
        raise UserError(_first_fault(path, columns, delimiter)) from error
    if table.size == 0:
        raise UserError(f"{path}: no data rows; expected the columns {_names(columns)}")
    if table.shape[1] != len(columns):
        raise UserError(_first_fault(path, columns, delimiter))
    if delimiter and len(columns) == 2 and (table[0] == [0.0, 1.0]).all():
        raise UserError(f"{place(path, 0)}: the row 0 1 numbers columns and is not data; {_HEADING}")
    check(columns, table.T, partial(place, path, blank=delimiter is not None and len(columns) == 1), timed)
    return np.asarray(table)


def place(path: Path, row: int, blank: bool = False) -> str:
    """File and line, from 1, of a data row, from 0. blank: empty lines between others are rows."""
    text = read_bytes(path).decode("utf-8-sig", errors="replace")
    lines = (number for number, _ in _data_lines(text, None, blank))
    return f"{path}:{next(itertools.islice(lines, row, None), 0)}"


def format_table(header: tuple[str, ...], rows: Array, delimiter: str = "\t") -> str:
    """Comment lines and delimited rows, every number written so that it reads back the same."""
    comments = "".join(f"# {line}\n" for line in header)
    body = "".join(delimiter.join(_shortest(cell) for cell in row) + "\n" for row in rows.tolist())
    return comments + body


def _shortest(value: float) -> str:
    return str(int(value)) if value.is_integer() and abs(value) < 1e6 else repr(value)


def _shown(cell: str) -> str:
    """A cell in quotes, short and in plain characters, whatever it contains."""
    plain = cell if cell.isascii() and cell.isprintable() else ascii(cell)[1:-1]
    return f"'{plain[:30]}'" + ("..." if len(plain) > 30 else "")


def _check_text(path: Path, content: bytes) -> None:
    """Raise UserError if the bytes are not text, or have endless lines."""
    if content.startswith(_COMPRESSED):
        raise UserError(f"{path}: is compressed; unpack it first")
    if b"\0" in content:
        raise UserError(f"{path}: not a text table of numbers; it must be text in UTF-8")
    signs = np.frombuffer(content, np.uint8)
    ends = np.flatnonzero((signs == ord("\n")) | (signs == ord("\r")))
    lengths = np.diff(np.concatenate([[-1], ends, [signs.size]]))
    if lengths.max() > _LONGEST:
        raise UserError(f"{path}:{int(lengths.argmax()) + 1}: a line of {lengths.max()} bytes; not a table of numbers")


def _data_lines(text: str, delimiter: str | None, blank: bool = False) -> Iterator[tuple[int, list[str]]]:
    """The number of each line with data, from 1, and its cells without quotes."""
    skipped: list[int] = []
    begun = False
    for number, line in enumerate(io.StringIO(text, newline=None), start=1):
        data = line.split("#", 1)[0].strip()
        if data:
            if blank and begun:
                yield from ((empty, [""]) for empty in skipped)
            begun, skipped = True, []
            cells = data.split(delimiter)
            yield number, [cell.strip().strip('"').strip() for cell in cells] if delimiter else cells
        elif not line.strip():
            skipped.append(number)


def _word(column: Column) -> str:
    """What an empty cell means."""
    return "nan" if column.missing else "nothing"


def _names(columns: Sequence[Column]) -> str:
    return " ".join(column.name for column in columns)


def _first_fault(path: Path, columns: Sequence[Column], delimiter: str | None) -> str:
    expected = f"expected the {_counted(len(columns))} {_names(columns)}".replace("the 1 column", "the column")
    first = True
    text = read_bytes(path).decode("utf-8-sig", errors="replace")
    for number, cells in _data_lines(text, delimiter, blank=delimiter is not None and len(columns) == 1):
        line = text.splitlines()[number - 1]
        if len(cells) != len(columns):
            return f"{path}:{number}: {_counted(len(cells))}; {expected}{_why(line, cells, len(columns), delimiter)}"
        for column, cell in zip(columns, cells, strict=True):
            if not _is_number(cell or _word(column)):
                if first and not any(map(_is_number, cells)):
                    hint = f"; {_HEADING}"
                elif cell[-1:] in ",;":
                    hint = f"; separate cells with {_DELIMITERS[delimiter]} only"
                elif _is_number(cell.replace(",", ".")):
                    hint = "; write decimals with a point"
                else:
                    hint = "; write nan where nothing was measured" if column.missing else ""
                return f"{path}:{number}: {column.name} is {_shown(cell)}, not a number; {expected}{hint}"
        first = False
    return f"{path}: not a text table of numbers; {expected}"


def _why(line: str, cells: Sequence[str], size: int, delimiter: str | None) -> str:
    """A likely reason for a wrong number of cells, with the remedy; or nothing."""
    for other, name in _DELIMITERS.items():
        if other != delimiter and size > 1 and len(line.strip().split(other)) == size:
            return f"; cells are separated by {name}; separate them with {_DELIMITERS[delimiter]}"
    if not _is_number(cells[0]) and cells[0]:
        return f"; {_HEADING}"
    return "; remove an index column and all other columns" if len(cells) > size else ""


def _counted(columns: int) -> str:
    return f"{columns} column" + "s" * (columns != 1)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return cell.isascii() and "_" not in cell
