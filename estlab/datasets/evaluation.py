"""The layout of evaluation-input.npy: one robot's commands, path and bearings, as named arrays in one archive.

It is what numpy.savez writes, under a name that ends in .npy.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from estlab.datasets.whole import write_whole
from estlab.errors import UserError
from estlab.maths.space import Array

NAME = "evaluation-input.npy"

# How many numbers each row of an array has; every array has a row a step.
_WIDTHS = {
    "noise_free_motion": 3,
    "real_observations": 2,
    "noise_free_observations": 2,
    "real_robot_path": 3,
    "noise_free_robot_path": 3,
}
_STEPS = "num_steps"


@dataclass(frozen=True)
class Evaluation:
    """One robot's steps.

    motion: (T, 3) commanded rot1 [rad], trans [cm], rot2 [rad]. path, exact_path: (T, 3) x, y [cm], heading [rad] after
    each step, as driven and as commanded. readings, exact_readings: (T, 2) bearing [rad] from the driven path, with and
    without noise, and the landmark's number from 0.
    """

    motion: Array
    readings: Array
    exact_readings: Array
    path: Array
    exact_path: Array


def read(path: Path, landmarks: int) -> Evaluation:
    """Read an archive whose readings are of this many landmarks.

    Raises UserError, naming the file and the array, where one is missing or not as the layout says.
    """
    arrays = _load(path)
    steps = arrays[_STEPS]
    if steps.shape != () or steps.dtype.kind not in "iu" or steps < 1:
        raise UserError(f"{path}: {_STEPS} must be one whole number >= 1; it is {_described(steps)}")
    rows = int(steps)
    for name, width in _WIDTHS.items():
        _check_numbers(path, name, arrays[name], (rows, width))
    for name in ("real_observations", "noise_free_observations"):
        target = arrays[name][:, 1]
        unknown = np.flatnonzero((target != np.rint(target)) | (target < 0) | (target >= landmarks))
        if unknown.size:
            at = int(unknown[0])
            raise UserError(f"{path}: {name}[{at}] is of landmark {target[at]:g}; landmarks are 0 to {landmarks - 1}")
    return Evaluation(*(np.asarray(arrays[name], dtype=float) for name in _WIDTHS))


def write(evaluation: Evaluation, path: Path) -> Path:
    """Write the archive; its path."""
    e = evaluation
    columns = (e.motion, e.readings, e.exact_readings, e.path, e.exact_path)
    arrays: dict[str, Any] = {_STEPS: np.array(e.motion.shape[0]), **dict(zip(_WIDTHS, columns, strict=True))}
    return write_whole(path, lambda stream: np.savez(stream, allow_pickle=False, **arrays))


def _load(path: Path) -> dict[str, Array]:
    """The arrays of the layout, as they are in the archive."""
    wanted = (_STEPS, *_WIDTHS)
    try:
        # Opened here, since numpy leaves a damaged archive open.
        with open(path, "rb") as stream:
            return _arrays(path, np.load(stream, allow_pickle=False), wanted)
    except UserError:
        raise
    except FileNotFoundError as error:
        raise UserError(
            f"{path}: no such file; data.path must be the folder that holds it, data.prefix what its name begins with"
        ) from error
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from error
    except Exception as error:  # zipfile, zlib and numpy raise many kinds for a damaged archive
        raise UserError(f"{path}: not an archive of plain arrays as numpy.savez writes it") from error


def _arrays(path: Path, archive: Any, wanted: tuple[str, ...]) -> dict[str, Array]:
    if not isinstance(archive, np.lib.npyio.NpzFile):
        raise UserError(f"{path}: one array, not an archive of arrays; expected {', '.join(wanted)}, as by numpy.savez")
    missing = [name for name in wanted if name not in archive]
    if missing:
        raise UserError(f"{path}: no array {missing[0]}; the archive holds {', '.join(archive.files) or 'nothing'}")
    return {name: np.asarray(archive[name]) for name in wanted}


def _check_numbers(path: Path, name: str, array: Array, shape: tuple[int, int]) -> None:
    if array.dtype.kind not in "fiu" or array.shape != shape:
        raise UserError(f"{path}: {name} must be {shape[0]} x {shape[1]} numbers; it is {_described(array)}")
    wrong = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if wrong.size:
        raise UserError(f"{path}: {name}[{wrong[0]}] is not finite; every step must be known")


def _described(array: Array) -> str:
    return f"{array.dtype.name} {' x '.join(map(str, array.shape)) or array[()]}"
