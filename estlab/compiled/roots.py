"""The steps of square-root filters: see estlab.filters.square_root."""

import math
from typing import Any, NamedTuple

from estlab.compiled.algebra import (
    Matrix,
    Row,
    inner,
    is_zero,
    matmul,
    minus,
    plus,
    solve_lower,
    solve_lower_transposed,
    times,
    total,
    transpose,
    triangle,
)
from estlab.compiled.model_graphs import root, wrapped
from estlab.compiled.moment_matching import TracedMoments, deviations, factored
from estlab.compiled.routines import PointSet, Routine, Steps, unless
from estlab.compiled.updates import either, reading_of, record_innovation, refused, without


class Deviations(NamedTuple):
    """Mean of the value, and columns X (n, p), Z (m, p) with cov = Z Z' and cross = X Z'."""

    mean: Row
    of_state: Matrix
    of_value: Matrix


def lower(matrix: Matrix) -> Matrix:
    """The factor, of which the lower triangle is stored."""
    return [[entry if j <= i else 0.0 for j, entry in enumerate(row)] for i, row in enumerate(matrix)]


def spread(steps: Steps, routine: Routine, name: str, given: PointSet | None, function: Any, wrap: Any, mean: Row,
           factor: Matrix) -> Deviations:  # fmt: skip
    """A belief through a function by points, as columns; the centre's is the last."""
    assert given is not None
    points = steps.points(routine.tracer, name, given)
    offsets = points.offsets(factor)
    middle, rises = deviations(points, function, wrap, mean, offsets)
    axes, m = len(factor), len(middle)
    weight = 0.5 / given.spread2
    half = steps.parameters.leaf(routine.tracer, f"{name} root of the weight", math.sqrt(weight))
    beyond = max(1.0 - 2.0 * axes * weight + given.bonus, 0.0)
    centre = steps.parameters.leaf(routine.tracer, f"{name} root of the centre's weight", math.sqrt(beyond))
    shift = [times(points.weight, total(rise[i] for rise in rises)) for i in range(m)]
    of_value = [
        [*(times(half, minus(rise[i], shift[i])) for rise in rises), minus(0.0, times(centre, shift[i]))]
        for i in range(m)
    ]
    of_state = [[*(times(half, offset[i]) for offset in offsets), 0.0] for i in range(len(mean))]
    return Deviations([plus(middle[i], shift[i]) for i in range(m)], of_state, of_value)


def predicted_root(
    steps: Steps, routine: Routine, mean: Row, matrix: Matrix, control: Row, dt: Any, crossed: int
) -> TracedMoments:
    """The mean, and the factor in place of the covariance, after a prediction."""
    motion, tracer = steps.motion, routine.tracer

    def move(at: Row) -> Row:
        return motion.value(tracer, at, control, None, dt)

    found = spread(steps, routine, "motion", steps.method.motion, move, list, mean, lower(matrix))
    columns = found.of_value
    if motion.noises:
        _, in_noise = motion.jacobians(tracer, mean, control, dt)
        columns = beside(columns, matmul(in_noise, steps.process_noise(tracer)))
    return TracedMoments(found.mean, triangle(columns, routine.failed, root), [])


def beside(a: Matrix, b: Matrix) -> Matrix:
    """[A B]."""
    return [[*row, *other] for row, other in zip(a, b, strict=True)]


def updated_root(steps: Steps, routine: Routine) -> None:
    """The belief given the reading, its innovation, and whether it was rejected."""
    sensor, n, m = steps.sensor, steps.n, steps.sensor.space.size
    mean, matrix = routine.belief()
    reading = reading_of(steps, routine)
    missing = reading.missing

    def look(at: Row) -> Row:
        return sensor.value(routine.tracer, at, reading.landmarks)

    def back(values: Row) -> Row:
        return wrapped(sensor.space, values)

    found = spread(steps, routine, "sensor", steps.method.sensor, look, back, mean, lower(matrix))
    of_value = [[unless(missing[a], routine, entry, 0.0) for entry in found.of_value[a]] for a in range(m)]
    cov = without(routine, steps.reading_noise(routine.tracer, factor=False), missing)
    noise = lower(factored(cov, routine.failed))
    innovation = back([minus(reading.values[a], found.mean[a]) for a in range(m)])
    innovation = [unless(missing[a], routine, innovation[a], 0.0) for a in range(m)]
    factor = triangle(beside(of_value, noise), routine.failed, root)
    whitened = [row[0] for row in solve_lower(factor, [[entry] for entry in innovation])]
    cross = [[inner(of_value[a], found.of_state[c]) for c in range(n)] for a in range(m)]
    kalman_gain = transpose(solve_lower_transposed(factor, solve_lower(factor, cross)), n)
    gated = refused(steps, routine, whitened, missing) if steps.method.gated else None
    if gated is not None:
        kalman_gain = [[unless(gated, routine, entry, 0.0) for entry in row] for row in kalman_gain]
    moved = [plus(mean[c], total(times(kalman_gain[c][a], innovation[a]) for a in range(m))) for c in range(n)]
    # (X - K Z)(X - K Z)' + K R K' is the covariance of the update, a sum of squares.
    less = matmul(kalman_gain, of_value)
    left = [[minus(x, z) for x, z in zip(xs, zs, strict=True)] for xs, zs in zip(found.of_state, less, strict=True)]
    rest = triangle(beside(left, matmul(kalman_gain, noise)), routine.failed, root)
    has = steps.has(reading.values)
    kept = either(None if has is None else ~has, gated)
    after = lower(matrix)
    for i in range(n):
        for j in range(i + 1):
            after[i][j] = rest[i][j] if kept is None else routine.choose(kept, matrix[i][j], rest[i][j])
    routine.keep(wrapped(sensor.state, moved), after)
    record_innovation(steps, routine, reading, whitened, [factor[a][a] for a in range(m)], gated)


__all__ = ["is_zero", "predicted_root", "updated_root"]
