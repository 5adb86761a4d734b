"""Tables of numbers as spreadsheets and scripts write them: read, or refused in one line that names the cure."""

import gzip

import numpy as np
import pytest

from estlab.datasets.promises import Column
from estlab.datasets.text_tables import place, read_table
from estlab.errors import UserError

XY = (Column("x", missing=True), Column("y", missing=True))
ALPHA = (Column("alpha", missing=True),)
COMMAND = (Column("time"), Column("v"), Column("w", angle=True))
WHITE = b"0 1.5 0.1\n1 2.5 0.2\n"


def table(path, content, columns, delimiter=None, timed=True):
    path.write_bytes(content)
    return read_table(path, columns, delimiter, timed)


@pytest.mark.parametrize(
    "content",
    [
        WHITE,
        b"\xef\xbb\xbf" + WHITE,
        WHITE.replace(b"\n", b"\r\n"),
        WHITE.replace(b"\n", b"\r"),
        WHITE.replace(b" ", b"\t").replace(b"\n", b" \t\n"),
        WHITE.rstrip(),
        b"# heading\n\n" + WHITE.replace(b"\n", b" # note\n\n"),
        b"# caf\xe9, in Latin-1\n" + WHITE,
    ],
)
def test_line_ends_marks_and_comments_of_any_system_are_read(content, tmp_path):
    np.testing.assert_array_equal(table(tmp_path / "t", content, COMMAND), [[0, 1.5, 0.1], [1, 2.5, 0.2]])


@pytest.mark.parametrize(
    "content", [b"1,2\n,\n,3\n4,5\n", b'"1","2"\n"",""\n"","3"\n"4","5"\n', b"1 , 2\n , \n ,3\n4,5\n"]
)
def test_an_empty_cell_is_a_missing_reading(content, tmp_path):
    found = table(tmp_path / "t", content, XY, ",", timed=False)
    np.testing.assert_array_equal(found, [[1, 2], [np.nan, np.nan], [np.nan, 3], [4, 5]])


@pytest.mark.parametrize("empty", [b"", b'""', b"nan", b" "])
def test_an_empty_line_of_one_column_is_a_missing_reading(empty, tmp_path):
    path = tmp_path / "t"
    found = table(path, b"# heading\n\n1\n" + empty + b"\n3\n\n", ALPHA, ",", timed=False)
    np.testing.assert_array_equal(found[:, 0], [1, np.nan, 3])
    assert place(path, 2, blank=True) == f"{path}:5", "lines are counted as a person counts them"


REFUSED = {
    "heading": (
        b"x,y\n1,2\n",
        XY,
        ",",
        ":1: x is 'x', not a number; expected the 2 columns x y; a line that is not data",
    ),
    "numbered columns": (b"0,1\n1,2\n", XY, ",", ":1: the row 0 1 numbers columns and is not data"),
    "index": (b",x,y\n0,1,2\n", XY, ",", ":1: 3 columns; expected the 2 columns x y; remove an index"),
    "semicolons": (b"1;2\n", XY, ",", "cells are separated by semicolons; separate them with commas"),
    "decimal commas": (b"1,5;2,5\n", XY, ",", "cells are separated by semicolons; separate them with commas"),
    "words": (b"1,2\nNA,NA\n", XY, ",", ":2: x is 'NA', not a number; expected the 2 columns x y; write nan where"),
    "commas": (
        WHITE.replace(b" ", b","),
        COMMAND,
        None,
        "cells are separated by commas; separate them with white space",
    ),
    "commas and blanks": (WHITE.replace(b" ", b", "), COMMAND, None, "separate cells with white space only"),
    "decimal comma": (WHITE.replace(b".", b","), COMMAND, None, ":1: v is '1,5', not a number"),
    "heading without sign": (
        b"time v w\n" + WHITE,
        COMMAND,
        None,
        ":1: time is 'time', not a number; expected the 3 col",
    ),
    "percent": (
        b"% Time [s] v w\n" + WHITE,
        COMMAND,
        None,
        ":1: 5 columns; expected the 3 columns time v w; a line that",
    ),
    "underscore": (b"1_0 1 1\n", COMMAND, None, ":1: time is '1_0', not a number"),
    "other digits": ("\u0661 1 1\n".encode(), COMMAND, None, r":1: time is '\u0661', not a number"),
    "compressed": (gzip.compress(WHITE), COMMAND, None, ": is compressed; unpack it first"),
    "wide letters": (WHITE.decode().encode("utf-16"), COMMAND, None, "must be text in UTF-8"),
    "empty where needed": (b"1,\n", (Column("x"), Column("y")), ",", ":1: y is '', not a number"),
    "columns exchanged": (b"1 0.5 9\n", COMMAND, None, "convert degrees; the columns are time v w, in this order"),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_what_is_no_such_table_is_refused_with_the_cure(fault, tmp_path):
    content, columns, delimiter, said = REFUSED[fault]
    with pytest.raises(UserError) as refusal:
        table(tmp_path / "t", content, columns, delimiter)
    assert said in str(refusal.value)
    assert "\n" not in str(refusal.value)
