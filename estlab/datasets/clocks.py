"""Recorded times: out of order, offset from each other, or with gaps."""

from bisect import bisect_right
from collections.abc import Callable

import numpy as np

from estlab.errors import UserError
from estlab.maths.space import Array

_MUCH_LONGER = 10.0  # times the median step
_SLOWEST = 1000.0  # [s] longest step of any robot here


def in_order(
    time: Array, place: Callable[[int], str], share: float, repeats: bool = False
) -> tuple[Array, tuple[str, ...]]:
    """The rows (N,) to keep so that times ascend, and a remark about the others.

    Of rows with the same time the last is kept, unless ``repeats`` allows them. The smallest set of rows whose
    removal makes times ascend is left out. place: describes where a row is.
    Raises UserError if too large a share would be left out, or if times cannot be in seconds.
    """
    kept = np.arange(time.size) if (np.diff(time) >= 0.0).all() else _longest_ascent(time)
    back = time.size - kept.size
    if not repeats:
        kept = kept[np.append(np.diff(time[kept]) > 0.0, True)]
    repeated = time.size - kept.size - back
    if kept.size > 1 and (usual := float(np.median(np.diff(time[kept])))) > _SLOWEST:
        raise UserError(f"{place(0)}: half of the steps take {usual:.3g} s or more; times must be in seconds")
    if not back + repeated:
        return kept, ()
    steps = np.diff(time)
    first = int(np.flatnonzero(steps < 0.0 if repeats else steps <= 0.0)[0]) + 1
    fault = "goes back" if steps[first - 1] < 0.0 else "repeats the one before"
    if back + repeated > share * time.size:
        raise UserError(
            f"{place(first)}: time {time[first]:.3f} {fault}; {back + repeated} of {time.size} rows have "
            "such times and would be left out; sort by time, or raise data.clock_faults"
        )
    counts = [f"{repeated} left out because a later one has the same time"] * bool(repeated)
    counts += [f"{back} left out because they step back"] * bool(back)
    return kept, (f"{place(first)}: time {fault}; of {time.size} rows {' and '.join(counts)}",)


def one_remark(notes: tuple[str, ...]) -> tuple[str, ...]:
    """The remarks about several files as one remark, or None."""
    return ("; ".join(notes),) if notes else ()


def covered(reading: Array, command: Array, gap: float) -> Array:
    """(N,) true for readings from the first command until a gap [s] after the last. Times ascend."""
    return np.asarray((reading >= command[0]) & (reading <= command[-1] + gap))


def long_steps(time: Array, gap: float = 0.0) -> tuple[str, ...]:
    """A remark if steps between times (N,) are far longer than most, and longer than a gap [s]."""
    lapse = np.diff(time)
    if not lapse.size:
        return ()
    long = np.flatnonzero(lapse > max(gap, _MUCH_LONGER * float(np.median(lapse))))
    if not long.size:
        return ()
    worst = long[lapse[long].argmax()]
    return (
        f"{long.size} of {lapse.size} predictions are far longer than the rest, up to {lapse[worst]:.4g} s from "
        f"{time[worst]:.4g} s on; check the times there",
    )


def _longest_ascent(time: Array) -> Array:
    """The indices of a longest subsequence that never descends. Schensted 1961."""
    ends: list[float] = []  # the last time of the best subsequence of each length
    where: list[int] = []
    before = np.full(time.size, -1)
    for i, t in enumerate(time.tolist()):
        length = bisect_right(ends, t)
        before[i] = where[length - 1] if length else -1
        ends[length : length + 1] = [t]
        where[length : length + 1] = [i]
    found = []
    i = where[-1]
    while i >= 0:
        found.append(i)
        i = int(before[i])
    return np.array(found[::-1])
