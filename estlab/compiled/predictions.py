"""Moments of the state after a step, and of the next reading: see estlab.filters.gaussian."""

from collections.abc import Sequence
from typing import Any

from estlab.compiled.algebra import Matrix, Row, added, block_diagonal, plus, sandwich
from estlab.compiled.model_graphs import wrapped
from estlab.compiled.moment_matching import TracedMoments, by_points, factored, linearised, second_order
from estlab.compiled.routines import Routine, Steps


def predicted_state(
    steps: Steps, routine: Routine, mean: Row, cov: Matrix, control: Row, dt: Any, crossed: int
) -> TracedMoments:
    """The motion's moments, noise included, with the cross-covariance to so many components of the previous state."""
    motion, method, tracer = steps.motion, steps.method, routine.tracer
    n, noise = steps.n, steps.process_noise(tracer)
    if method.transform == "points":
        points = steps.points(tracer, "motion", method.motion)
        factor = factored(cov, routine.failed)
        if method.augmented:
            joint = block_diagonal(factor, noise)

            def move(at: Row) -> Row:
                return motion.value(tracer, at[:n], control, at[n:], dt)

            return by_points(points, move, list, [*mean, *[0.0] * motion.noises], joint, crossed)
        moments = by_points(points, lambda at: motion.value(tracer, at, control, None, dt), list, mean, factor, crossed)
    else:
        value = motion.value(tracer, mean, control, None, dt)
        moments = linearised(value, motion.jacobians(tracer, mean, control, dt)[0], cov)
        if method.transform != "linearised":
            if method.augmented:
                hessians, joint = motion.joint_hessians(tracer, mean, control, dt), block_diagonal(cov, noise)
            else:
                hessians, joint = motion.hessians(tracer, mean, control, dt), cov
            moments = second_order(moments, hessians, joint, method.transform == "gaussian")
    if not motion.noises:
        return moments
    _, in_noise = motion.jacobians(tracer, mean, control, dt)
    return moments._replace(cov=added(moments.cov, sandwich(in_noise, noise)[1]))


def predicted_reading(
    steps: Steps, routine: Routine, mean: Row, cov: Matrix, landmarks: Sequence[Row]
) -> TracedMoments:
    """The reading's moments, noise included, and its cross-covariance with the state."""
    sensor, method, tracer = steps.sensor, steps.method, routine.tracer
    n, m = steps.n, sensor.space.size

    def back(values: Row) -> Row:
        return wrapped(sensor.space, values)

    if method.transform == "points":
        points = steps.points(tracer, "sensor", method.sensor)
        factor = factored(cov, routine.failed)
        if method.augmented:

            def noisy(at: Row) -> Row:
                return [plus(value, at[n + i]) for i, value in enumerate(sensor.value(tracer, at[:n], landmarks))]

            joint = block_diagonal(factor, steps.reading_noise(tracer, factor=True))
            return by_points(points, noisy, back, [*mean, *[0.0] * m], joint, n)
        moments = by_points(points, lambda at: sensor.value(tracer, at, landmarks), back, mean, factor, n)
    else:
        value = sensor.value(tracer, mean, landmarks)
        moments = linearised(value, sensor.jacobian(tracer, mean, landmarks), cov)
        if method.transform in ("gaussian", "modified"):
            hessians = sensor.hessians(tracer, mean, landmarks)
            moments = second_order(moments, hessians, cov, method.transform == "gaussian")
    return moments._replace(cov=added(moments.cov, steps.reading_noise(tracer, factor=False)))
