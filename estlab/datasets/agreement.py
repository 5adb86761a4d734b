"""Whether files of one recording are about the same time, in the same units: each is held to the truth."""

import numpy as np

from estlab.datasets.promises import check_turns
from estlab.maths.space import Array, wrap

_WINDOW = 1.0  # [s] over which turns are compared
_LEAST = 20  # readings or windows that can tell
_LIKE_CHANCE = 0.5  # ranges this bad, as a share of what they are against the truth of another time
_UNRELATED = 0.3  # correlation of turns


def of_ranges(ranges: Array, expected: Array, what: str) -> tuple[str, ...]:
    """A remark if ranges (N,) fit those expected of the truth as badly as at other times; NaN where it is not known."""
    known = np.flatnonzero(np.isfinite(expected))
    if known.size < _LEAST:
        return ()
    ranges, expected = ranges[known], expected[known]
    off, chance = (float(np.median(np.abs(ranges - e))) for e in (expected, np.roll(expected, known.size // 2)))
    if off <= _LIKE_CHANCE * chance:
        return ()
    return (
        f"{what}: half of the ranges are off the truth's by more than {off:.3g} m, hardly better than those of another "
        "time; do clocks, barcodes and units agree?",
    )


def of_turns(time: Array, rate: Array, heading: Array, what: str) -> tuple[str, ...]:
    """A remark if commanded turns have nothing to do with the truth's.

    time: (N,); rate: (N,) [rad/s], each held until the next time; heading: (N,) of the truth, NaN where not known.
    Raises UserError if the rates are in degrees.
    """
    commanded = np.append(0.0, np.cumsum(rate[:-1] * np.diff(time)))
    marks = np.unique(np.searchsorted(time, np.arange(time[0], time[-1], _WINDOW)))
    near = np.diff(time[marks]) < 2.0 * _WINDOW
    said, turned = np.diff(commanded[marks])[near], wrap(np.diff(heading[marks]))[near]
    known = np.isfinite(turned)
    said, turned = said[known], turned[known]
    if known.sum() < _LEAST or not (said.std() > 0.0 and turned.std() > 0.0):
        return ()
    check_turns("the turn rate", said, turned, what)
    if float(np.corrcoef(said, turned)[0, 1]) >= _UNRELATED:
        return ()
    return (f"{what}: the turns commanded have little to do with those of the truth; do their clocks agree?",)
