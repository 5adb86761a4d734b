"""The layout of evaluation-input.npy: one robot's commands, path and bearings, as named arrays in one archive.

The archive is written by numpy.savez, under a name that ends in .npy.
"""

import io
import math
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from estlab.datasets.data_files import check_size, read_bytes
from estlab.datasets.promises import Column, check, check_headings
from estlab.datasets.whole import write_whole
from estlab.errors import UserError
from estlab.maths.space import Array

LAYOUT = {"data": ("evaluation-input.npy", "evaluation-input.npz")}

_MOTION = (Column("rot1", angle=True), Column("trans"), Column("rot2", angle=True))
_READING = (Column("bearing", angle=True, missing=True), Column("landmark", missing=True))
_POSE = tuple(Column(name, missing=True) for name in ("x", "y", "heading"))
# The columns of each array; every array has one row per step. NaN means not measured, or unknown.
_ARRAYS = {
    "noise_free_motion": _MOTION,
    "real_observations": _READING,
    "noise_free_observations": _READING,
    "real_robot_path": _POSE,
    "noise_free_robot_path": _POSE,
}
_STEPS = "num_steps"
_NEEDED = (_STEPS, "noise_free_motion", "real_observations")


@dataclass(frozen=True)
class Evaluation:
    """One robot's steps.

    motion: (T, 3) commanded rot1 [rad], trans [cm], rot2 [rad]. path, exact_path: (T, 3) x, y [cm], heading [rad]
    after each step, as driven and as commanded. readings, exact_readings: (T, 2) bearing [rad] from the driven path,
    with and without noise, and the landmark's number from 0.
    """

    motion: Array
    readings: Array
    exact_readings: Array
    path: Array
    exact_path: Array


def read(path: Path, landmarks: int) -> tuple[Evaluation, tuple[str, ...]]:
    """Read an archive with readings of this many landmarks. Returns it with its remarks.

    Raises UserError that names the file and the array if one is missing or does not follow the layout.
    """
    arrays = _load(path)
    steps = int(arrays[_STEPS])
    for name, columns in _ARRAYS.items():
        check(columns, arrays[name].T, lambda i, name=name: f"{path}: {name}[{i}]")  # type: ignore[misc]
    for name in ("real_observations", "noise_free_observations"):
        bearing, target = arrays[name].T
        measured = np.isfinite(bearing)
        unknown = np.flatnonzero(measured & ~((target == np.rint(target)) & (target >= 0) & (target < landmarks)))
        if unknown.size:
            at = int(unknown[0])
            raise UserError(f"{path}: {name}[{at}] is of landmark {target[at]:g}; landmarks are 0 to {landmarks - 1}")
        arrays[name][~measured, 1] = 0.0
    for name in ("real_robot_path", "noise_free_robot_path"):
        x, y, heading = arrays[name].T
        check_headings(heading, x, y, lambda i, name=name: f"{path}: {name}[{i}]")  # type: ignore[misc]
        arrays[name][np.isnan(arrays[name]).any(axis=1)] = np.nan
    lost, unknown = (np.isnan(arrays[name][:, 0]) for name in ("real_observations", "real_robot_path"))
    if lost.all():
        raise UserError(f"{path}: no bearing in any of the {steps} rows of real_observations")
    remarks = (f"{path}: no bearing in {int(lost.sum())} of {steps} steps",) * bool(lost.any())
    if unknown.all():
        remarks += (f"nothing is scored: no real_robot_path in {path.name}",)
    elif unknown.any():
        remarks += (f"{path}: truth is unknown in {int(unknown.sum())} of {steps} steps",)
    return Evaluation(*(arrays[name] for name in _ARRAYS)), remarks


def write(evaluation: Evaluation, path: Path) -> Path:
    """Write the archive. Returns its path."""
    e = evaluation
    columns = (e.motion, e.readings, e.exact_readings, e.path, e.exact_path)
    arrays: dict[str, Any] = {_STEPS: np.array(e.motion.shape[0]), **dict(zip(_ARRAYS, columns, strict=True))}
    return write_whole(path, lambda stream: np.savez(stream, allow_pickle=False, **arrays))


def _load(path: Path) -> dict[str, Array]:
    """The arrays of the layout; optional arrays that are missing are NaN."""
    content = read_bytes(path)
    if content.startswith(b"\x93NUMPY"):
        raise UserError(
            f"{path}: one array, not an archive of arrays; expected {', '.join(_wanted())}, as by numpy.savez"
        )
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            return _arrays(path, archive)
    except UserError:
        raise
    except Exception as error:  # zipfile, zlib and numpy raise many kinds of error for a damaged archive
        raise UserError(f"{path}: not an archive of plain arrays as numpy.savez writes it") from error


def _wanted() -> tuple[str, ...]:
    return (_STEPS, *_ARRAYS)


def _arrays(path: Path, archive: zipfile.ZipFile) -> dict[str, Array]:
    there = {name.removesuffix(".npy") for name in archive.namelist()}
    missing = [name for name in _NEEDED if name not in there]
    if missing:
        raise UserError(f"{path}: no array {missing[0]}; the archive holds {', '.join(sorted(there)) or 'nothing'}")
    count = _array(path, archive, _STEPS, None)
    if count.dtype.kind not in "iu" or count < 1:
        raise UserError(f"{path}: {_STEPS} must be one integer >= 1; it is {_described(count.dtype, (), count)}")
    arrays = {_STEPS: count}
    for name, columns in _ARRAYS.items():
        shape = int(count), len(columns)
        arrays[name] = (
            np.array(_array(path, archive, name, shape), dtype=float) if name in there else np.full(shape, np.nan)
        )
    return arrays


def _array(path: Path, archive: zipfile.ZipFile, name: str, shape: tuple[int, int] | None) -> Array:
    """One array, with declared shape and kind checked before it is unpacked. shape: None for a single number."""
    with archive.open(f"{name}.npy") as stream:
        version = np.lib.format.read_magic(stream)
        header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        declared, _, dtype = header(stream)
        if declared != (shape or ()) or dtype.kind not in "fiu":
            described = _described(dtype, declared)
            if dtype.hasobject:
                raise UserError(
                    f"{path}: not an archive of plain arrays as numpy.savez writes it; {name} is {described}"
                )
            expected = f"{shape[0]} x {shape[1]} numbers" if shape else "one integer >= 1"
            raise UserError(f"{path}: {name} must be {expected}; it is {described}")
    check_size(path, math.prod(declared) * dtype.itemsize, f"unpacked, {name} is ")
    with archive.open(f"{name}.npy") as stream:
        return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))


def _described(dtype: np.dtype[Any], shape: tuple[int, ...], value: Any = "") -> str:
    return f"{dtype.name} {' x '.join(map(str, shape)) or value}".rstrip()
