"""Slopes of models that state none, by central differences, in numbers: estlab.maths.derivatives. See loop."""

from collections.abc import Callable
from typing import Any

import numpy as np

from estlab.filters.compiled.scalars import jit
from estlab.maths.space import Array

N: int
M: int
Q: int
RELATIVE_STEP: float
motion: Callable[[Array, Any, Array], None]  # of state and noise (n + q,)
sensor: Callable[[Array, Any, Array], None]
wrap_reading: Callable[[Array], None]


@jit
def motion_by_differences(p: Array, given: Any, out: Array, in_state: Array, in_noise: Array) -> None:
    """The motion at a point (n + q,), and its slopes in the state and in the noise."""
    motion(p, given, out)
    above, below = np.empty(N), np.empty(N)
    for c in range(N + Q):
        at = p[c]
        step = RELATIVE_STEP * np.maximum(1.0, np.abs(at))
        p[c] = at + step
        motion(p, given, above)
        p[c] = at - step
        motion(p, given, below)
        p[c] = at
        for a in range(N):
            rise = (above[a] - below[a]) / (2.0 * step)
            if c < N:
                in_state[a, c] = rise
            else:
                in_noise[a, c - N] = rise


@jit
def sensor_by_differences(p: Array, given: Any, out: Array, slopes: Array) -> None:
    """The sensor at a state, and its slopes."""
    sensor(p, given, out)
    above, below = np.empty(M), np.empty(M)
    for c in range(N):
        at = p[c]
        step = RELATIVE_STEP * np.maximum(1.0, np.abs(at))
        p[c] = at + step
        sensor(p, given, above)
        p[c] = at - step
        sensor(p, given, below)
        p[c] = at
        for a in range(M):
            above[a] -= below[a]
        wrap_reading(above)
        for a in range(M):
            slopes[a, c] = above[a] / (2.0 * step)
