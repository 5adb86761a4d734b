"""A belief through the models by points, in numbers: estlab.maths.sigma_points. See loop."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from estlab.filters.compiled.kernel.small import cholesky, fail, sandwich
from estlab.filters.compiled.scalars import jit
from estlab.maths.space import Array

Model = Callable[[Array, Any, Array], None]

N: int
M: int
Q: int  # components of the process noise
AUGMENTED: bool  # whether the noises go through the models too; they are then given by factors of their covariances
motion: Model  # of state and noise (n + q,)
sensor: Model  # of the state, and if augmented of state and noise (n + m,)
motion_tangent: Callable[[Array, Any, Array, Array, Array], None]  # value and slopes
wrap_reading: Callable[[Array], None]


class Room(NamedTuple):
    """For what is computed of the points."""

    before: Array
    offset: Array
    centre: Array
    value: Array
    shift: Array
    in_state: Array
    in_noise: Array
    noisy: Array
    of_motion: Array
    of_sensor: Array
    no_cross: Array


@jit
def room() -> Room:
    most, values = N + max(Q, M), max(N, M)
    motion_axes, sensor_axes = (N + Q, N + M) if AUGMENTED else (N, N)
    return Room(
        np.zeros(most),
        np.zeros(most),
        np.empty(values),
        np.empty(values),
        np.empty(values),
        np.empty((N, N)),
        np.empty((N, Q)),
        np.empty((N, Q)),
        np.zeros((motion_axes, motion_axes)),
        np.zeros((sensor_axes, sensor_axes)),
        np.empty((0, N)),
    )


@jit
def predicted_state(x: Array, p: Array, given: Any, noise: Array, points: Any, space: Room) -> None:
    """The moments of the motion in the place of x and P."""
    unit, weights, bonus = points[0], points[1], points[4]
    joint_factor(p, noise, space.of_motion)
    begin(x, space, p, space.no_cross)
    if AUGMENTED:
        motion(space.before, given, space.centre)
    else:
        motion_tangent(space.before, given, space.centre, space.in_state, space.in_noise)
    for i in range(weights.size):
        go_to(i, x, space.of_motion, unit, space)
        motion(space.before, given, space.value)
        for a in range(N):
            space.value[a] -= space.centre[a]
        add(weights[i], space, p, space.no_cross)
    conclude(bonus, space, x, p)
    if not AUGMENTED:
        sandwich(space.in_noise, noise, space.noisy, p)


@jit
def predicted_reading(x: Array, p: Array, given: Any, noise: Array, points: Any, space: Room, found: Any) -> None:
    """The moments of the reading to come into the residual, cov and cross of ``found``."""
    unit, weights, bonus = points[2], points[3], points[4]
    joint_factor(p, noise, space.of_sensor)
    begin(x, space, found.cov, found.cross)
    sensor(space.before, given, space.centre)
    for i in range(weights.size):
        go_to(i, x, space.of_sensor, unit, space)
        sensor(space.before, given, space.value)
        for a in range(M):
            space.value[a] -= space.centre[a]
        wrap_reading(space.value)
        add(weights[i], space, found.cov, found.cross)
    conclude(bonus, space, found.residual, found.cov)
    wrap_reading(found.residual)
    if not AUGMENTED:
        for a in range(M):
            for b in range(M):
                found.cov[a, b] += noise[a, b]


@jit
def joint_factor(p: Array, noise: Array, factor: Array) -> None:
    """The factor of P, or of P and the noise together, all NaN if one of them has none."""
    cholesky(p, factor)
    if AUGMENTED:
        size = noise.shape[0]
        for a in range(size):
            for b in range(N):
                factor[N + a, b] = 0.0
            for b in range(a + 1):
                factor[N + a, N + b] = noise[a, b]
        if size > 0 and not np.isfinite(noise[size - 1, size - 1]):
            fail(factor)


@jit
def begin(x: Array, space: Room, cov: Array, cross: Array) -> None:
    """At the mean, with nothing added up."""
    size = cov.shape[0]
    for a in range(space.before.shape[0]):
        space.before[a] = x[a] if a < N else 0.0
    for a in range(size):
        space.shift[a] = 0.0
        for b in range(size):
            cov[a, b] = 0.0
        for c in range(cross.shape[0]):
            cross[c, a] = 0.0


@jit
def go_to(i: int, x: Array, factor: Array, unit: Array, space: Room) -> None:
    """To point i. unit: where the points lie (axes, p) for a unit covariance."""
    for a in range(factor.shape[0]):
        space.offset[a] = 0.0
        for c in range(a + 1):
            space.offset[a] += factor[a, c] * unit[c, i]
        space.before[a] = space.offset[a] + (x[a] if a < N else 0.0)


@jit
def add(weight: float, space: Room, cov: Array, cross: Array) -> None:
    """What lies at a point, less what lies at the mean, into the sums; cross-covariances for the rows there are."""
    for a in range(cov.shape[0]):
        weighted = weight * space.value[a]
        space.shift[a] += weighted
        for b in range(a + 1):
            cov[a, b] += weighted * space.value[b]
        for c in range(cross.shape[0]):
            cross[c, a] += space.offset[c] * weighted


@jit
def conclude(bonus: float, space: Room, mean: Array, cov: Array) -> None:
    """Mean and covariance from the sums."""
    for a in range(cov.shape[0]):
        for b in range(a + 1):
            cov[a, b] += (bonus - 1.0) * (space.shift[a] * space.shift[b])
            cov[b, a] = cov[a, b]
        mean[a] = space.centre[a] + space.shift[a]
