"""The two MATLAB files of the kidnapped robot: measurements and truth. Seed document 000, problem IV.

Frames are steps. A sonar element that is empty or NaN is a missing reading; no encoder reading may be missing.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from estlab.datasets import agreement, frames, matlab
from estlab.datasets.data_files import Files, Options
from estlab.datasets.matlab import MatFile
from estlab.datasets.promises import Column, check_ascending, check_headings, check_noisy_distances, check_turns
from estlab.errors import UserError
from estlab.maths.space import Array

LAYOUT = {"data": ("problem4data.mat", "problem4dataMod.mat"), "truth": ("problem4truth.mat", "problem4truthMod.mat")}
BOUNDS = ("minx", "maxx", "miny", "maxy")
_MOVE = (Column("ds"), Column("dth", angle=True))
_RANGES = tuple(Column(name, missing=True) for name in ("nearest", "second", "third"))
_POSE = tuple(Column(name, missing=True) for name in ("x", "y", "heading"))
_HEADING = 2
_NOISE = 1.0  # [m] of a range, in the document
_SAME_TIME = 1e-6  # [s]


@dataclass(frozen=True)
class SonarRecording:
    """encoder: (2, N) ds [m], dth [rad]. ranges: (3, N) [m], NaN where not measured. time: (N,) [s].

    truth: (3, N), NaN where unknown. beacons: (2, B) [m]. bounds: minx, maxx, miny, maxy [m].
    """

    encoder: Array
    ranges: Array
    time: Array
    truth: Array
    beacons: Array
    bounds: Array
    files: tuple[Path, ...]
    remarks: tuple[str, ...]


def read(files: Files, dt: float, options: Options) -> SonarRecording:
    """Read the measurements and, if the file exists, the truth. dt: [s] between frames if the file has no times.

    Raises UserError that names file and element if one is missing or does not follow the layout.
    """
    path, truth_path = files.path("data"), files.find("truth")
    data = matlab.load(path)
    encoder, encoder_time = data.vectors("encoder", "u", _MOVE)
    ranges, sonar_time = data.vectors("sonar", "z", _RANGES)
    count = encoder.shape[1]
    if ranges.shape[1] != count:
        raise UserError(
            f"{path}: sonar has {ranges.shape[1]} elements, encoder has {count}; both need the same number; "
            "write a missing sonar reading as nan or empty"
        )
    beacons, bounds = _map(data)
    truth_file = matlab.load(truth_path).vectors(None, "x", _POSE) if truth_path else None
    place = partial(_element, path, "sonar", "z")
    check_noisy_distances(ranges, _NOISE, place)
    check_ascending(
        ranges, place, "they must be the ranges to the nearest, second and third nearest beacon, in this order"
    )
    clock: Callable[[int], str] = partial(_element, path, "encoder", "u")
    time = encoder_time if encoder_time is not None else sonar_time
    apart = _apart(path, encoder_time, sonar_time)
    if time is None and truth_file and truth_file[1] is not None and truth_file[1].size == count:
        time, clock = truth_file[1], lambda i: f"{truth_path}: element {i + 1}"
    kept = frames.kept(count, time, dt * np.arange(1, count + 1), clock, options.clock_faults)
    encoder, ranges = encoder[:, kept.frames], ranges[:, kept.frames]
    lost = np.asarray(np.isnan(ranges).any(axis=0))
    remarks = (
        *kept.remarks,
        *apart,
        *frames.missing(lambda i: place(int(kept.frames[i])), lost, "complete sonar reading"),
    )
    truth = np.full((3, kept.time.size), np.nan)
    if truth_path is None or truth_file is None:
        remarks += (f"nothing is scored: {files.lacks('truth')}",)
    else:
        poses, truth_time = truth_file
        check_headings(poses[_HEADING], poses[0], poses[1], lambda i: f"{truth_path}: element {i + 1}")
        truth, time_notes = frames.truth_of(
            path, kept, truth_path, poses, truth_time, (_HEADING,), options.clock_faults
        )
        remarks += time_notes
        remarks += agreement.of_lengths(encoder[0, 1:], truth[0], truth[1], np.roll(truth[_HEADING], -1), str(path))
        check_turns("dth", encoder[1, 1:], np.diff(truth[_HEADING]), f"{path}: encoder(i).u")
    read = (path, truth_path) if truth_path else (path,)
    return SonarRecording(encoder, ranges, kept.time, truth, beacons.T, bounds, read, remarks)


def _apart(path: Path, encoder: Array | None, sonar: Array | None) -> tuple[str, ...]:
    """A remark if encoder and sonar have different times in the same element.

    Raises UserError if they have no time in common.
    """
    if encoder is None or sonar is None or np.abs(encoder - sonar).max() <= _SAME_TIME:
        return ()
    far = f"{path}: sonar(i).t is up to {np.abs(encoder - sonar).max():.4g} s from encoder(i).t"
    if sonar.min() > encoder.max() or encoder.min() > sonar.max():
        raise UserError(f"{far}; they have no time in common; do their clocks agree?")
    return (f"{far}; the encoder's times are used; do their clocks agree?",)


def _element(path: Path, name: str, field: str, i: int) -> str:
    return f"{path}: {name}({i + 1}).{field}"


def _map(data: MatFile) -> tuple[Array, Array]:
    """The beacons (B, 2) and the bounds (4,) of the map."""
    beacons = data.array("beacons")
    if beacons.ndim != 2 or beacons.shape[0] < len(_RANGES) or beacons.shape[1] != 2:
        raise UserError(f"{data.path}: beacons must be {len(_RANGES)} or more rows x y; it is {beacons.shape}")
    values = {name: data.array(name) for name in BOUNDS}
    for name, value in values.items():
        if value.size != 1:
            raise UserError(f"{data.path}: {name} must be one number, a bound of the map [m]; it is {value.shape}")
    low_x, high_x, low_y, high_y = bounds = np.array([value.item() for value in values.values()])
    if not (low_x < high_x and low_y < high_y and np.abs(bounds).max() < 1e9):
        raise UserError(
            f"{data.path}: minx {low_x:g} must be below maxx {high_x:g}, miny {low_y:g} below maxy {high_y:g}"
        )
    return beacons, bounds
