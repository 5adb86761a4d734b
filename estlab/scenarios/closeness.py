"""How close a filter's estimates of a robot seen by a camera stay to the measurements; needs no truth."""

import numpy as np

from estlab.maths.space import Array, wrap
from estlab.models.camera import SPACE
from estlab.scenarios.scenario import History

HEADING = SPACE.names.index("heading")

CLOSENESS = (
    "RMS to the fixes [cm]", "largest distance [cm]", "RMS to alpha [rad]", "behind alpha [s]", "RMS turn a step [rad]",
)  # fmt: skip


def closeness(history: History, alpha: Array) -> tuple[float, ...]:
    """The numbers called :data:`CLOSENESS`, over the steps before the filter diverged. alpha: (T + 1,), as measured."""
    heading = history.mean[HEADING]
    off = np.hypot(*(history.mean[:2, history.step] - history.values))
    largest = off[np.isfinite(off)].max() if np.isfinite(off).any() else np.nan
    from_alpha, late = _rms(wrap(heading - alpha[1:])), _delay(heading, alpha[1:], history.time)
    return tuple(
        float(f"{value:.4g}") for value in (_rms(off), largest, from_alpha, late, _rms(wrap(np.diff(heading))))
    )


def _delay(heading: Array, alpha: Array, time: Array) -> float:
    """The delay of a heading (T,) behind alpha (T,) [s]: the shift, up to 2 s, that brings them closest."""
    known = np.isfinite(heading) & np.isfinite(alpha)
    if known.sum() < 5:
        return np.nan
    time, heading, alpha = time[known], np.unwrap(heading[known]), np.unwrap(alpha[known])

    def apart(shift: float) -> float:
        now = time <= time[-1] - shift
        return _rms(wrap(np.interp(time[now] + shift, time, heading) - alpha[now]))

    return float(min(np.arange(0.0, min(2.0, time[-4] - time[0]), 0.02), key=apart))


def _rms(values: Array) -> float:
    """The root mean square of the finite values; NaN if there are none."""
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else np.nan
