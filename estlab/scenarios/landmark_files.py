"""A recording among landmarks on one time line: where it starts, where its truth is known, and what is left out."""

from dataclasses import dataclass

import numpy as np

from estlab.datasets import agreement, mrclam
from estlab.datasets.clocks import covered, long_steps
from estlab.datasets.truth import on_timeline, trusted_heading
from estlab.errors import UserError
from estlab.maths.space import Array

_TOGETHER = 1.0  # [s] within which a robot has hardly moved
_FEW_KNOWN = 0.2  # of the steps with truth: fewer do not happen by chance
_SPREAD = 1.0  # [m] between the landmarks from which a pose is estimated


@dataclass(frozen=True)
class Timeline:
    """The steps of a recording, in seconds from its first command on.

    start: [s]; begin: (3,) pose there, and sds: (3,) of its error if it was estimated from readings, or None if the
    truth is known. time: (T,); truth: (3, T), NaN where unknown; control: (2, T). step: (N,) and taken: (M,) the
    readings used, true for N of all M.
    """

    start: float
    begin: Array
    sds: Array | None
    time: Array
    truth: Array
    control: Array
    step: Array
    taken: Array
    remarks: tuple[str, ...]


def timeline(
    recording: mrclam.LandmarkRecording, truth_gap: float, clock_gap: float, reading_sds: list[float]
) -> Timeline:
    """The steps from the first time at which the robot's pose is known.

    truth_gap: truth is not interpolated over a longer gap; clock_gap: readings later than this after the last command
    [s] are left out. reading_sds: of range [m] and bearing [rad], for a start without truth.
    Raises UserError if the files have no time in common.
    """
    origin = float(recording.odometry[0, 0])
    command_time, reading_time = recording.odometry[:, 0] - origin, recording.reading_time - origin
    in_time = covered(reading_time, command_time, clock_gap)
    if recording.truth.size:
        truth = _Truth(recording.truth, truth_gap, origin)
        start, sds = truth.start(command_time, recording), None
        begin = truth.at(np.array([start]))[:, 0]
    else:
        truth = None
        start, begin, sds = _pose_from_readings(recording, reading_time, in_time, reading_sds)
    taken = in_time & (reading_time > start)
    moving = command_time > start
    if not taken.any():
        raise UserError(
            f"{recording.paths['measurement']}: no reading while the truth is known and "
            f"{recording.paths['odometry'].name} lasts; do their times agree?"
        )
    time = np.unique(np.concatenate([command_time[moving], reading_time[taken]]))
    before = np.concatenate([[start], time[:-1]])
    held = np.searchsorted(command_time, before, side="right") - 1
    poses = truth.at(time) if truth else np.full((3, time.size), np.nan)
    remarks = (
        *_left_out(recording, reading_time, in_time, command_time, clock_gap),
        *_late_start(start, clock_gap, truth is not None),
        *long_steps(np.append(start, time), clock_gap),
    )
    if truth:
        remarks += (*_agreement(recording, truth, command_time, reading_time), *_truth_remarks(poses))
    control = recording.odometry[held, 1:].T
    return Timeline(start, begin, sds, time, poses, control, np.searchsorted(time, reading_time[taken]), taken, remarks)


class _Truth:
    """The known truth of the pose, and where its heading is trusted."""

    def __init__(self, table: Array, gap: float, origin: float) -> None:
        self._time, self._poses, self._gap, self._origin = table[:, 0], table[:, 1:].T, gap, origin
        self._trusted = trusted_heading(table[:, 0], table[:, 1], table[:, 2], table[:, 3], gap)

    def at(self, time: Array) -> Array:
        """Pose (3, T): NaN over gaps; where the heading is not trusted it is NaN and the position remains."""
        time = time + self._origin
        pose = on_timeline(time, self._time, self._poses, (2,), self._gap)
        good = on_timeline(time, self._time, self._trusted[None].astype(float), (), self._gap)
        pose[2, ~(good[0] == 1.0)] = np.nan
        return pose

    def start(self, command_time: Array, recording: mrclam.LandmarkRecording) -> float:
        """The first command time at which the whole pose is known."""
        known = np.isfinite(self.at(command_time)).all(axis=0)
        if not known.any():
            raise UserError(
                f"{recording.paths['groundtruth']}: no trusted truth at any time of "
                f"{recording.paths['odometry'].name}; does it belong to another robot or another clock?"
            )
        return float(command_time[known.argmax()])


def _pose_from_readings(
    recording: mrclam.LandmarkRecording, time: Array, in_time: Array, reading_sds: list[float]
) -> tuple[float, Array, Array]:
    """When two distant landmarks are first seen together, the pose that fits them best, and its accuracy.

    The least-squares rotation and translation that map the observed points onto the landmarks. Umeyama 1991.
    """
    usable = np.flatnonzero(in_time)
    for first in usable:
        group = usable[(time[usable] >= time[first]) & (time[usable] <= time[first] + _TOGETHER)]
        distance, bearing = recording.readings[:, group]
        seen = distance * np.stack([np.cos(bearing), np.sin(bearing)])
        there = recording.landmarks[:, recording.landmark_number[group]]
        if np.hypot(*np.ptp(there, axis=1)) < _SPREAD:
            continue
        p, q = seen - seen.mean(axis=1, keepdims=True), there - there.mean(axis=1, keepdims=True)
        heading = np.arctan2((p[0] * q[1] - p[1] * q[0]).sum(), (p * q).sum())
        cos, sin = np.cos(heading), np.sin(heading)
        place = there.mean(axis=1) - np.array([[cos, -sin], [sin, cos]]) @ seen.mean(axis=1)
        across = np.hypot(reading_sds[0], distance.mean() * reading_sds[1])
        sds = np.array([across, across, reading_sds[1]])
        return float(time[group[-1]]), np.append(place, heading), sds
    raise UserError(
        f"{recording.paths['measurement']}: two landmarks more than {_SPREAD:g} m apart are never seen "
        f"within {_TOGETHER:g} s, so the start is unknown without truth; add the file of the truth"
    )


def _left_out(
    recording: mrclam.LandmarkRecording, reading_time: Array, in_time: Array, command_time: Array, gap: float
) -> tuple[str, ...]:
    if in_time.all():
        return ()
    early = int((reading_time < command_time[0]).sum())
    late = int((~in_time).sum()) - early
    counts = [f"{early} before the first command"] * bool(early)
    counts += [f"{late} more than {gap:g} s after the last"] * bool(late)
    return (
        f"{recording.paths['measurement']}: {' and '.join(counts)} of "
        f"{recording.paths['odometry'].name}, left out of {in_time.size} readings; do their clocks agree?",
    )


def _late_start(start: float, gap: float, known: bool) -> tuple[str, ...]:
    if start <= gap:
        return ()
    why = "where the truth is first known" if known else "where two landmarks are first seen together"
    return (f"starts {start:.4g} s after the first command, {why}",)


def _agreement(
    recording: mrclam.LandmarkRecording, truth: _Truth, command_time: Array, reading_time: Array
) -> tuple[str, ...]:
    x, y, heading = truth.at(reading_time)
    dx, dy = recording.landmarks[:, recording.landmark_number] - np.stack([x, y])
    measurement, odometry = (str(recording.paths[kind]) for kind in ("measurement", "odometry"))
    distance, bearing = recording.readings
    v, w = recording.odometry[:, 1:].T
    px, py, course = truth.at(command_time)
    return (
        *agreement.of_readings("ranges", distance, np.hypot(dx, dy), measurement),
        *agreement.of_each(distance, np.hypot(dx, dy), recording.barcodes[recording.landmark_number], measurement),
        *agreement.of_readings("bearings", bearing, np.arctan2(dy, dx) - heading, measurement, agreement.ANGLE),
        *agreement.of_lengths(v[:-1] * np.diff(command_time), px, py, course, odometry),
        *agreement.of_turns(command_time, w, course, odometry),
    )


def _truth_remarks(truth: Array) -> tuple[str, ...]:
    place, heading = np.isfinite(truth[0]).mean(), np.isfinite(truth[2]).mean()
    few = "; do its clock and that of the commands agree?" if place < _FEW_KNOWN else ""
    if heading == 1.0:
        return ()
    return (f"truth known at {place:.1%} of the steps, its heading trusted at {heading:.1%}{few}",)
