"""A belief along the tangents of the models, in numbers: estlab.maths.transforms.Linearised. See loop."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from estlab.filters.compiled.kernel.small import sandwich
from estlab.filters.compiled.scalars import jit
from estlab.maths.space import Array

N: int
M: int
Q: int  # components of the process noise
motion_tangent: Callable[[Array, Any, Array, Array, Array], None]  # value and slopes at state and noise (n + q,)
sensor_tangent: Callable[[Array, Any, Array, Array], None]
wrap_reading: Callable[[Array], None]


class Room(NamedTuple):
    """For what is computed along the tangents."""

    point: Array
    in_state: Array
    in_noise: Array
    slope: Array
    cov: Array
    moved: Array
    noisy: Array


@jit
def room() -> Room:
    return Room(
        np.zeros(N + Q),
        np.empty((N, N)),
        np.empty((N, Q)),
        np.empty((M, N)),
        np.empty((N, N)),
        np.empty((N, N)),
        np.empty((N, Q)),
    )


@jit
def predicted_state(x: Array, p: Array, given: Any, noise_cov: Array, points: Any, space: Room) -> None:
    """f(x) and F P F' + G Q G' in the place of x and P."""
    for a in range(N):
        space.point[a] = x[a]
        for b in range(N):
            space.cov[a, b] = p[a, b]
            p[a, b] = 0.0
    motion_tangent(space.point, given, x, space.in_state, space.in_noise)
    sandwich(space.in_state, space.cov, space.moved, p)
    sandwich(space.in_noise, noise_cov, space.noisy, p)


@jit
def predicted_reading(x: Array, p: Array, given: Any, noise_cov: Array, points: Any, space: Room, found: Any) -> None:
    """h(x), H P H' + R and P H' into the residual, cov and cross of ``found``."""
    slope, cross = space.slope, found.cross
    sensor_tangent(x, given, found.residual, slope)
    wrap_reading(found.residual)
    for c in range(N):
        for a in range(M):
            cross[c, a] = 0.0
            for b in range(N):
                cross[c, a] += p[c, b] * slope[a, b]
    for a in range(M):
        for b in range(a + 1):
            one, other = 0.0, 0.0
            for c in range(N):
                one += slope[a, c] * cross[c, b]
                other += slope[b, c] * cross[c, a]
            found.cov[a, b] = 0.5 * (one + other) + noise_cov[a, b]
            found.cov[b, a] = found.cov[a, b]
