"""The two MATLAB files of the car: LIDAR frames and the true states. Seed document 000, problem III.

Frames are steps. A frame that is empty or NaN is a missing reading.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estlab.datasets import frames, matlab
from estlab.datasets.data_files import Files, Options
from estlab.datasets.promises import Column, check, check_headings
from estlab.errors import UserError
from estlab.maths.space import Array

LAYOUT = {"data": ("problem3data.mat", "problem3dataMod.mat"), "truth": ("problem3truth.mat", "problem3truthMod.mat")}
_POINT = (Column("range", distance=True, missing=True), Column("bearing", angle=True, missing=True))
_STATE = tuple(Column(name, missing=True) for name in ("x", "y", "speed", "heading", "length", "width"))
_HEADING = 3


@dataclass(frozen=True)
class CarRecording:
    """points: (2, M) range [m] and bearing [rad], and the frame of each (M,). time: (N,) [s] of the frames.

    truth: (6, N), NaN where unknown.
    """

    points: Array
    owner: Array
    time: Array
    truth: Array
    files: tuple[Path, ...]
    remarks: tuple[str, ...]


def read(files: Files, dt: float, options: Options) -> CarRecording:
    """Read the frames and, if the file exists, the truth. dt: [s] between frames if the file has no times.

    Raises UserError that names file and element if one is missing or does not follow the layout.
    """
    path = files.path("data")
    lidar = matlab.load(path).frames("lidar", "z")
    kept = frames.kept(
        len(lidar.values),
        lidar.time,
        dt * np.arange(len(lidar.values)),
        lambda i: f"{path}: element {i + 1}",
        options.clock_faults,
    )
    scans = [_scan(path, lidar.name.format(i + 1), lidar.values[i]) for i in kept.frames]
    points = np.concatenate(scans, axis=1)
    owner = np.repeat(np.arange(len(scans)), [scan.shape[1] for scan in scans])

    def place(frame: int) -> str:
        return f"{path}: {lidar.name.format(int(kept.frames[frame]) + 1)}"

    there = ~np.isnan(points[:2]).any(axis=0)
    check(_POINT, points[:2, there], lambda i: place(owner[there][i]))
    seen = np.bincount(owner[there], minlength=len(scans)) > 0
    remarks = (*kept.remarks, *frames.missing(place, ~seen, "point"))
    if not there.all():
        remarks += (f"{place(owner[~there][0])}: nan in {int((~there).sum())} of {there.size} points, left out",)
    if any(lidar.values[i].shape[1] > 2 for i in kept.frames if lidar.values[i].size):
        remarks += (f"{path}: columns of {lidar.name.format('i')} after range and bearing are not read",)
    truth_path, truth = files.find("truth"), np.full((6, len(scans)), np.nan)
    if truth_path is None:
        remarks += (f"nothing is scored: {files.lacks('truth')}",)
    else:
        states, time = matlab.load(truth_path).vectors(None, "x", _STATE)
        check_headings(states[_HEADING], states[0], states[1], lambda i: f"{truth_path}: element {i + 1}")
        truth, time_notes = frames.truth_of(path, kept, truth_path, states, time, (_HEADING,), options.clock_faults)
        remarks += time_notes
    read = (path, truth_path) if truth_path else (path,)
    return CarRecording(points[:2, there], owner[there], kept.time, truth, read, remarks)


def _scan(path: Path, name: str, points: Array) -> Array:
    """One frame's points (2, N), empty if the LIDAR saw nothing; columns after the second are ignored."""
    if points.size == 0:
        return np.empty((2, 0))
    if points.ndim != 2 or points.shape[1] < 2:
        raise UserError(f"{path}: {name} must be N x 2, range [m] and bearing [rad]; it is {points.shape}")
    return points[:, :2].T
