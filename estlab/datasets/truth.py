"""Recorded truth, used only where it can be trusted."""

import numpy as np

from estlab.maths.space import Array, wrap

# No wheeled robot turns faster than this [rad/s]: a faster change of heading is a tracker's mistake.
_FASTEST_TURN = 10.0
# A robot that moves this far [m] within a stretch reveals its heading by its course.
_TELLING_TRAVEL = 0.2
_WRONG_BY = 0.5  # [rad]


def on_timeline(time: Array, truth_time: Array, truth: Array, angles: tuple[int, ...], gap: float) -> Array:
    """Truth (n, T) at times (T,), linear between samples (n, N); NaN outside and within gaps over ``gap`` [s]."""
    after = np.searchsorted(truth_time, time)
    inside = (after > 0) & (after < truth_time.size)
    right = np.clip(after, 1, truth_time.size - 1)
    left = right - 1
    span = truth_time[right] - truth_time[left]
    share = (time - truth_time[left]) / span
    step = truth[:, right] - truth[:, left]
    for i in angles:
        step[i] = wrap(step[i])
    values = truth[:, left] + share * step
    for i in angles:
        values[i] = wrap(values[i])
    exact = (after < truth_time.size) & (truth_time[np.minimum(after, truth_time.size - 1)] == time)
    values[:, exact] = truth[:, after[exact]]
    values[:, ~(exact | (inside & (span <= gap)))] = np.nan
    return np.asarray(values)


def trusted_heading(time: Array, x: Array, y: Array, heading: Array, gap: float) -> Array:
    """(N,) true where the recorded heading of a robot that drives forward agrees with its course.

    The record is cut where the heading jumps faster than any robot turns, or at a gap. A stretch is rejected if the
    median difference from its course exceeds half a radian. A stretch too short to judge is rejected if a jump bounds
    it.
    """
    lapse = np.diff(time)
    jump = np.abs(wrap(np.diff(heading))) > _FASTEST_TURN * np.maximum(lapse, 0.02)
    edges = np.flatnonzero(jump | (lapse > gap)) + 1
    begin, end = np.append(0, edges), np.append(edges, time.size)
    jumped = np.concatenate([[False], jump[edges - 1], [False]])
    good = np.ones(time.size, dtype=bool)
    for k, (a, b) in enumerate(zip(begin, end, strict=True)):
        off = _course_error(x[a:b], y[a:b], heading[a:b])
        good[a:b] = not (jumped[k] or jumped[k + 1]) if off is None else off < _WRONG_BY
    return good


def first_of_each(way: Array, length: float) -> Array:
    """Where a distance (N,) that ascends from 0 first passes each multiple of a length, however far it goes."""
    return np.flatnonzero(np.diff(np.floor(way / length), prepend=-1.0) > 0.0)


def _course_error(x: Array, y: Array, heading: Array) -> float | None:
    """Median angle [rad] between heading and the chord to the position 5 cm later; None if the robot hardly moves."""
    travel = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    if travel[-1] < _TELLING_TRAVEL:
        return None
    marks = first_of_each(travel, 0.05)
    course = np.arctan2(np.diff(y[marks]), np.diff(x[marks]))
    return float(np.median(np.abs(wrap(course - heading[marks[:-1]]))))
