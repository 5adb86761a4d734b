"""The routines of a filter's program: prediction, update, recording of each step, and the smoother's backward step.

This module, predictions, updates and roots write for components what estlab.filters writes for arrays; tests compare
both.
"""

import math

from estlab.compiled.algebra import (
    added,
    minus,
    plus,
    sandwich,
    solve_lower,
    solve_lower_transposed,
    symmetric,
    times,
    total,
    transpose,
)
from estlab.compiled.model_graphs import wrapped
from estlab.compiled.moment_matching import factored
from estlab.compiled.predictions import predicted_state
from estlab.compiled.roots import predicted_root, updated_root
from estlab.compiled.routines import Routine, Steps, slots
from estlab.compiled.updates import updated
from estlab.maths.linalg import ROUNDING


def predict(steps: Steps, paused: bool = False) -> Routine:
    """A prediction; if paused, only for the runs that have the next reading."""
    routine = Routine(steps.n)
    mean, matrix = routine.belief()
    control, dt = steps.given(routine)
    predicted = predicted_root if steps.method.transform == "factors" else predicted_state
    after = predicted(steps, routine, mean, matrix, control, dt, 0)
    new, cov = wrapped(steps.motion.space, after.mean), after.cov
    if paused:
        has = steps.has(routine.tracer.leaves("value", steps.sensor.space.size))
        if has is not None:
            new = [routine.choose(has, new[i], mean[i]) for i in range(steps.n)]
            cov = symmetric(steps.n, lambda i, j: routine.choose(has, after.cov[i][j], matrix[i][j]))
    routine.keep(new, cov)
    return routine


def update(steps: Steps) -> Routine:
    """An update with a reading, for the runs that have it."""
    routine = Routine(steps.n)
    if steps.method.updating and steps.sensor.space.size:
        (updated_root if steps.method.transform == "factors" else updated)(steps, routine)
    return routine


def record(steps: Steps, gated: bool) -> Routine:
    """Records a step: mean and covariance and, with a gate, the number of rejected readings; are all finite?"""
    routine, n = Routine(steps.n), steps.n
    mean, matrix = routine.belief()
    every = total([*mean, *(matrix[i][j] for i in range(n) for j in range(i + 1))])
    routine.failed.append(~(abs(every) < math.inf))
    if gated:
        routine.outputs.append(("gated", 0, routine.tracer.leaf("belief", slots(n) - 1)))
        routine.outputs.append(("belief", slots(n) - 1, 0.0))
    cov = matrix
    if steps.method.transform == "factors":
        cov = symmetric(n, lambda i, j: total(times(matrix[i][k], matrix[j][k]) for k in range(j + 1)))
    routine.outputs += [("mean", i, mean[i]) for i in range(n)]
    routine.outputs += [("cov", i * n + j, cov[i][j]) for i in range(n) for j in range(n)]
    return routine


def smooth(steps: Steps) -> Routine:
    """A backward step of the Rauch-Tung-Striebel smoother: see estlab.filters.smoother. A singular prediction fails."""
    routine, n = Routine(steps.n), steps.n
    later_mean, later_cov = routine.belief()
    mean = routine.tracer.leaves("before_mean", n)
    cov = symmetric(n, lambda i, j: routine.tracer.leaf("before_cov", i * n + j))
    control, dt = steps.given(routine)
    after = predicted_state(steps, routine, mean, cov, control, dt, n)
    factor = factored(after.cov, routine.failed)
    for i in range(n):
        routine.failed.append(~(factor[i][i] * factor[i][i] > n * ROUNDING * after.cov[i][i]))
    half = solve_lower(factor, transpose(after.cross, n))
    smoother_gain = transpose(solve_lower_transposed(factor, half), n)
    unrolled = wrapped(steps.motion.space, after.mean)
    step = wrapped(steps.motion.space, [minus(later_mean[i], unrolled[i]) for i in range(n)])
    moved = [plus(mean[i], total(times(smoother_gain[i][k], step[k]) for k in range(n))) for i in range(n)]
    change = symmetric(n, lambda i, j: minus(later_cov[i][j], after.cov[i][j]))
    routine.keep(wrapped(steps.motion.space, moved), added(cov, sandwich(smoother_gain, change)[1]))
    return routine
