"""The files of the robot on video: positions and, for comparison, the heading angle alpha. Seed document 004.

Rows are frames, so NaN stands for what the camera missed.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from estlab.datasets.data_files import Files
from estlab.datasets.promises import Column, check_headings
from estlab.datasets.text_tables import format_table, place, read_table
from estlab.datasets.whole import write_text
from estlab.errors import UserError
from estlab.maths.space import Array

LAYOUT = {"positions": ("XYData_cm.csv",), "headings": ("HeadingAngle_rad.csv",)}
_POSITION = (Column("x", missing=True), Column("y", missing=True))
_HEADING = (Column("alpha", missing=True),)
_LEAST = 3  # frames: two for the initial estimate, and one to filter


@dataclass(frozen=True)
class EpuckRecording:
    """fixes: (2, N) x and y [cm]. alpha: (N,) heading [rad], measured in the same frames. NaN where not measured.

    first: the number of the first frame kept. The first two have a fix.
    """

    fixes: Array
    alpha: Array
    first: int = 0
    files: tuple[Path, ...] = ()
    remarks: tuple[str, ...] = ()


def read(files: Files) -> EpuckRecording:
    """Read positions and, if the file exists, headings, starting from the first two consecutive frames with a fix.

    Raises UserError that names file and line if a file is missing or does not follow the layout.
    """
    positions, headings = files.path("positions"), files.find("headings")
    fixes = read_table(positions, _POSITION, ",", timed=False).T
    alpha = np.full(fixes.shape[1], np.nan)
    if headings:
        alpha = read_table(headings, _HEADING, ",", timed=False)[:, 0]
        if fixes.shape[1] != alpha.size:
            raise UserError(
                f"{headings}: {alpha.size} rows for the {fixes.shape[1]} of {positions.name}; each needs one row "
                "per frame, with nan where nothing was measured"
            )
        check_headings(alpha, fixes[0], fixes[1], partial(place, headings, blank=True))
    seen = np.asarray(np.isfinite(fixes).all(axis=0))
    pairs = np.flatnonzero(seen[1:] & seen[:-1])
    if not pairs.size or fixes.shape[1] - pairs[0] < _LEAST:
        left = f"; no two consecutive frames of the first {seen.size - 1} have a fix" if seen.size >= _LEAST else ""
        raise UserError(
            f"{positions}: {seen.size} rows{left}; at least {_LEAST} are needed: two with a fix for the "
            "start, and one more"
        )
    first = int(pairs[0])
    remarks = (
        *_missing(positions, ~seen[first:], first, "fix"),
        *(
            [f"the first {first} of {seen.size} frames are left out: the start needs two consecutive fixes"]
            if first
            else []
        ),
        *(() if headings else (files.lacks("headings"),)),
        *(_missing(headings, np.isnan(alpha[first:]), first, "alpha") if headings else ()),
    )
    read = (positions, headings) if headings else (positions,)
    return EpuckRecording(fixes[:, first:], alpha[first:], first, read, remarks)


def write(recording: EpuckRecording, folder: Path, prefix: str) -> list[Path]:
    """Write both files, without a header like the originals. Returns the files written."""
    tables = {LAYOUT["positions"][0]: recording.fixes.T, LAYOUT["headings"][0]: recording.alpha[:, None]}
    return [
        write_text(folder / f"{prefix}{name}", format_table((), np.asarray(rows), ",")) for name, rows in tables.items()
    ]


def _missing(path: Path, missing: Array, first: int, what: str) -> tuple[str, ...]:
    """A remark about the frames (N,) without a value; ``first`` is the number of the first frame in the file."""
    if not missing.any():
        return ()
    where = place(path, first + int(missing.argmax()), blank=what == "alpha")
    return (
        f"{where}: no {what} in {int(missing.sum())} of {missing.size} frames, this is the first; treated as missing",
    )
