"""What a format requires of its numbers: finite, in their units, in order. Each violation gets one line."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from estlab.errors import UserError
from estlab.maths.space import TURN, Array, wrap

_DEGREES = "more than a full turn; angles are in radians: convert degrees"

_TELLING = 60  # differences needed to estimate a jitter


@dataclass(frozen=True)
class Column:
    """One number of each row or frame.

    angle: in radians, within a full turn either way. distance: never negative. missing: NaN stands for values that
    were not measured.
    """

    name: str
    angle: bool = False
    distance: bool = False
    missing: bool = False


def check(columns: Sequence[Column], values: Array, place: Callable[[int], str], timed: bool = False) -> None:
    """Raise UserError for the first number that violates its column.

    values: (columns, N). place: describes where number i is, in a user's terms. timed: rows carry times, so one may
    be removed.
    """
    order = f"the columns are {' '.join(column.name for column in columns)}, in this order"
    faults = []
    for column, numbers in zip(columns, values, strict=True):
        known = np.isfinite(numbers)
        for wrong, why in (
            (np.isinf(numbers) if column.missing else ~known, _unknown(column, timed)),
            (column.angle & known & (np.abs(numbers) > TURN), _DEGREES + f"; {order}" * timed),
            (column.distance & known & (numbers < 0.0), f"negative; {order}"),
        ):
            if wrong.any():
                index = int(wrong.argmax())
                faults.append((index, f"{column.name} is {numbers[index]:g}, {why}"))
    if faults:
        index, fault = min(faults, key=lambda fault: fault[0])
        raise UserError(f"{place(index)}: {fault}")


def check_headings(heading: Array, x: Array, y: Array, place: Callable[[int], str]) -> None:
    """Raise UserError for headings (N,) that are in degrees. Radians may add up over many turns.

    Radians that pass a full turn are unrolled, so they never jump by half a turn, and they agree with the course
    better than degrees would. NaN where not measured.
    """
    beyond = np.flatnonzero(np.abs(heading) > TURN)
    if not beyond.size:
        return
    jumps = (np.abs(np.diff(heading[np.isfinite(heading)])) > np.pi).any()
    if jumps or _agreement(np.radians(heading), x, y) >= _agreement(heading, x, y):
        raise UserError(f"{place(int(beyond[0]))}: heading is {heading[beyond[0]]:g}, {_DEGREES}")


def check_turns(name: str, commanded: Array, turned: Array, place: str) -> None:
    """Raise UserError if turns (N,) [rad], commanded or measured over each step, are in degrees, judged by the truth.

    turned: (N,) turns of the truth, NaN where unknown. Noise on the commands averages out of the regression slope.
    """
    known = np.isfinite(turned) & np.isfinite(commanded)
    actual = wrap(turned[known])
    energy = float((actual**2).sum())
    if energy > 0.0 and (slope := float((actual * commanded[known]).sum()) / energy) > 10.0:
        raise UserError(
            f"{place}: {name} is {slope:.0f} times the robot's true turns; angles are in radians: convert degrees"
        )


def check_ascending(values: Array, place: Callable[[int], str], what: str) -> None:
    """Raise UserError unless rows of values (m, N) ascend apart from noise: in half of the cases, or on average."""
    step = np.diff(values, axis=0)
    whole = np.isfinite(step).all(axis=0)
    ascends = (step[:, whole] >= 0.0).all(axis=0)
    if not whole.any() or ascends.mean() >= 0.5:
        return
    mean, spread = step[:, whole].mean(axis=1), step[:, whole].std(axis=1)
    if (mean <= 3.0 * spread / np.sqrt(whole.sum())).any():
        first = int(np.flatnonzero(whole)[np.flatnonzero(~ascends)[0]])
        numbers = " ".join(f"{v:.4g}" for v in values[:, first])
        raise UserError(
            f"{place(first)} [{numbers}] does not ascend, as {int((~ascends).sum())} of {ascends.size} do not; {what}"
        )


def check_noisy_distances(values: Array, least_sd: float, place: Callable[[int], str]) -> None:
    """Raise UserError for distances (m, N) with added noise that are further below zero than noise explains.

    The noise's standard deviation is at least ``least_sd``, or the jitter of the values from one frame to the next.
    """
    jitter = np.abs(np.diff(values, axis=1))
    jitter = jitter[np.isfinite(jitter)]
    sd = max(least_sd, 1.4826 * float(np.median(jitter)) / np.sqrt(2.0) if jitter.size >= _TELLING else 0.0)
    wrong = (values < -5.0 * sd).any(axis=0)
    if wrong.any():
        first = int(wrong.argmax())
        numbers = " ".join(f"{v:.4g}" for v in values[:, first])
        raise UserError(
            f"{place(first)} [{numbers}] has a negative range that noise cannot explain; ranges are distances"
        )


def _unknown(column: Column, timed: bool) -> str:
    if column.missing:
        return "not finite; write nan where nothing was measured"
    return "not finite; " + ("remove the row; a gap is better than a guess" if timed else "every row needs this value")


def _agreement(heading: Array, x: Array, y: Array) -> float:
    """Mean absolute cosine between heading and course: 1 if one follows the other, forward or backward."""
    dx, dy = np.diff(x), np.diff(y)
    moved = np.hypot(dx, dy)
    off = (np.arctan2(dy, dx) - heading[:-1])[(moved > 0.0) & np.isfinite(moved + heading[:-1])]
    return abs(float(np.cos(off).mean())) if off.size else 0.0
