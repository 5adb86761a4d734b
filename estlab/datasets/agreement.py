"""Checks that the files of one recording share clock and units, by comparing each with the truth."""

import numpy as np

from estlab.datasets.promises import check_turns
from estlab.datasets.truth import first_of_each
from estlab.maths.space import Array, Space, wrap

_WINDOW = 1.0  # [s] over which turns are compared
_LEAST = 20  # readings or windows that are enough to judge
_FEW = 5  # readings of one landmark that are enough to judge
_WORSE = 5.0  # times the error of all readings: more than landmarks differ
_LIKE_CHANCE = 0.5  # ranges this bad, as a share of their error against the truth of another time
_UNRELATED = 0.3  # correlation of turns
_APART = 2.0  # times the truth's distances, or one part in so many

DISTANCE, ANGLE = Space(("distance",), ("m",)), Space(("angle",), ("rad",), angles=(0,))


def of_readings(kind: str, readings: Array, expected: Array, what: str, space: Space = DISTANCE) -> tuple[str, ...]:
    """A remark if readings (N,) fit the truth no better than at other times.

    Expected readings are NaN where the truth is unknown. kind: what the readings are, in the plural.
    """
    known = np.flatnonzero(np.isfinite(expected) & np.isfinite(readings))
    if known.size < _LEAST:
        return ()
    readings, expected = readings[known], expected[known]
    off, chance = (
        float(np.median(np.abs(space.minus(readings[None], e[None]))))
        for e in (expected, np.roll(expected, known.size // 2))
    )
    if off <= _LIKE_CHANCE * chance:
        return ()
    return (
        f"{what}: half of the {kind} differ from the truth by more than {off:.3g} {space.units[0]}, hardly better than "
        "those of another time; do clocks, barcodes and units agree?",
    )


def of_each(ranges: Array, expected: Array, codes: Array, what: str) -> tuple[str, ...]:
    """A remark about barcodes (N,), each with a few readings, whose ranges (N,) fit far worse than the rest."""
    known = np.flatnonzero(np.isfinite(expected))
    if known.size < _LEAST:
        return ()
    ranges, expected, codes = ranges[known], expected[known], codes[known]
    off = np.abs(ranges - expected)
    chance = float(np.median(np.abs(ranges - np.roll(expected, known.size // 2))))
    limit = max(_WORSE * float(np.median(off)), 0.2 * _LIKE_CHANCE * chance)
    wrong = [c for c in np.unique(codes) if (codes == c).sum() >= _FEW and np.median(off[codes == c]) > limit]
    if not wrong:
        return ()
    plural = "s" * (len(wrong) > 1)
    return (
        f"{what}: half of the ranges to barcode{plural} {', '.join(f'{c:g}' for c in wrong)} differ from "
        f"the truth by more than {limit:.3g} m; are barcodes or landmarks exchanged?",
    )


def of_lengths(commanded: Array, x: Array, y: Array, heading: Array, what: str) -> tuple[str, ...]:
    """A remark if commanded distances (N - 1,) differ much from the distances that the truth (N,) moved forward.

    heading: of each interval; NaN where unknown.
    """
    forward = np.diff(x) * np.cos(heading[:-1]) + np.diff(y) * np.sin(heading[:-1])
    known = np.isfinite(forward) & np.isfinite(commanded)
    went, ordered = forward[known], commanded[known]
    scale = float(np.abs(went).max(initial=0.0))
    if known.sum() < _LEAST or not 0.0 < scale < np.inf:
        return ()
    slope = float((went / scale * ordered).sum() / ((went / scale) ** 2).sum() / scale)
    if 1.0 / _APART <= slope <= _APART:
        return ()
    return (f"{what}: commanded distances are {slope:.2g} times those of the truth; do units and clocks agree?",)


def of_turns(time: Array, rate: Array, heading: Array, what: str) -> tuple[str, ...]:
    """A remark if commanded turns are unrelated to those of the truth.

    time: (N,); rate: (N,) [rad/s], each held until the next time; heading: (N,) of the truth, NaN where unknown.
    Raises UserError if the rates are in degrees.
    """
    commanded = np.append(0.0, np.cumsum(rate[:-1] * np.diff(time)))
    marks = first_of_each(time - time[0], _WINDOW)
    near = np.diff(time[marks]) < 2.0 * _WINDOW
    ordered, turned = np.diff(commanded[marks])[near], wrap(np.diff(heading[marks]))[near]
    known = np.isfinite(turned)
    ordered, turned = ordered[known], turned[known]
    if known.sum() < _LEAST or not (ordered.std() > 0.0 and turned.std() > 0.0):
        return ()
    check_turns("the turn rate", ordered, turned, what)
    if float(np.corrcoef(ordered, turned)[0, 1]) >= _UNRELATED:
        return ()
    return (f"{what}: commanded turns are nearly unrelated to those of the truth; do the clocks agree?",)
