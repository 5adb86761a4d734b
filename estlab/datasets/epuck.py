"""The files of the robot on video: its positions and, for comparison, its heading angle alpha. Seed document 004."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estlab.datasets.tables import format_table, read_table
from estlab.datasets.whole import write_text
from estlab.errors import UserError
from estlab.maths.space import Array

_POSITIONS, _HEADINGS = "XYData_cm.csv", "HeadingAngle_rad.csv"
_LEAST = 3  # rows: two make the initial estimate, and one more is something to filter


@dataclass(frozen=True)
class Recording:
    """fixes: (2, N) x and y [cm]. alpha: (N,) heading [rad], measured in the same frames."""

    fixes: Array
    alpha: Array
    files: tuple[Path, ...] = ()


def read(folder: Path, prefix: str) -> Recording:
    """Read both files.

    Raises UserError, naming file and line, where one is missing or not as the layout says.
    """
    positions, headings = (_find(folder, prefix, name) for name in (_POSITIONS, _HEADINGS))
    fixes, alpha = read_table(positions, ("x", "y"), ","), read_table(headings, ("alpha",), ",")
    if len(fixes) != len(alpha):
        raise UserError(
            f"{headings}: {len(alpha)} rows for the {len(fixes)} of {positions.name}; one row a frame in each"
        )
    if len(fixes) < _LEAST:
        raise UserError(f"{positions}: {len(fixes)} rows; at least {_LEAST} are needed, the first two for the start")
    return Recording(fixes.T, alpha[:, 0], (positions, headings))


def write(recording: Recording, folder: Path, prefix: str) -> list[Path]:
    """Write both files, without a header as the originals; the files written."""
    tables = {_POSITIONS: recording.fixes.T, _HEADINGS: recording.alpha[:, None]}
    return [
        write_text(folder / f"{prefix}{name}", format_table((), np.asarray(rows), ",")) for name, rows in tables.items()
    ]


def _find(folder: Path, prefix: str, name: str) -> Path:
    path = folder / f"{prefix}{name}"
    if not folder.is_dir():
        raise UserError(f"data.path: no folder {folder}")
    if not path.is_file():
        raise UserError(
            f"{path}: no such file; data.path must be the folder that holds it, data.prefix what its name begins with"
        )
    return path
