"""The pieces of a filter's program: prediction, update, what is kept of each step, and the smoother's step back.

What is written here, in predictions, updates and roots for components is what estlab.filters writes for arrays; tests
hold both to each other.
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
from estlab.compiled.pieces import Piece, Steps, slots
from estlab.compiled.predictions import predicted_state
from estlab.compiled.roots import predicted_root, updated_root
from estlab.compiled.updates import updated
from estlab.maths.linalg import ROUNDING


def predict(steps: Steps, paused: bool = False) -> Piece:
    """A prediction; paused, of those runs alone that have the next reading."""
    piece = Piece(steps.n)
    mean, matrix = piece.belief()
    control, dt = steps.given(piece)
    predicted = predicted_root if steps.method.transform == "factors" else predicted_state
    after = predicted(steps, piece, mean, matrix, control, dt, 0)
    new, cov = wrapped(steps.motion.space, after.mean), after.cov
    if paused:
        has = steps.has(piece.tracer.leaves("value", steps.sensor.space.size))
        if has is not None:
            new = [piece.choose(has, new[i], mean[i]) for i in range(steps.n)]
            cov = symmetric(steps.n, lambda i, j: piece.choose(has, after.cov[i][j], matrix[i][j]))
    piece.keep(new, cov)
    return piece


def update(steps: Steps) -> Piece:
    """An update with a reading, of the runs that have it."""
    piece = Piece(steps.n)
    if steps.method.updating and steps.sensor.space.size:
        (updated_root if steps.method.transform == "factors" else updated)(steps, piece)
    return piece


def record(steps: Steps, gated: bool) -> Piece:
    """What is kept of a step: mean and covariance and, if gated, how many readings were refused; is all finite?"""
    piece, n = Piece(steps.n), steps.n
    mean, matrix = piece.belief()
    every = total([*mean, *(matrix[i][j] for i in range(n) for j in range(i + 1))])
    piece.failed.append(~(abs(every) < math.inf))
    if gated:
        piece.outputs.append(("gated", 0, piece.tracer.leaf("belief", slots(n) - 1)))
        piece.outputs.append(("belief", slots(n) - 1, 0.0))
    cov = matrix
    if steps.method.transform == "factors":
        cov = symmetric(n, lambda i, j: total(times(matrix[i][k], matrix[j][k]) for k in range(j + 1)))
    piece.outputs += [("mean", i, mean[i]) for i in range(n)]
    piece.outputs += [("cov", i * n + j, cov[i][j]) for i in range(n) for j in range(n)]
    return piece


def smooth(steps: Steps) -> Piece:
    """A step back of the Rauch-Tung-Striebel smoother: see estlab.filters.smoother. A singular prediction fails."""
    piece, n = Piece(steps.n), steps.n
    later_mean, later_cov = piece.belief()
    mean = piece.tracer.leaves("before_mean", n)
    cov = symmetric(n, lambda i, j: piece.tracer.leaf("before_cov", i * n + j))
    control, dt = steps.given(piece)
    after = predicted_state(steps, piece, mean, cov, control, dt, n)
    factor = factored(after.cov, piece.failed)
    for i in range(n):
        piece.failed.append(~(factor[i][i] * factor[i][i] > n * ROUNDING * after.cov[i][i]))
    half = solve_lower(factor, transpose(after.cross, n))
    gain = transpose(solve_lower_transposed(factor, half), n)
    unrolled = wrapped(steps.motion.space, after.mean)
    step = wrapped(steps.motion.space, [minus(later_mean[i], unrolled[i]) for i in range(n)])
    moved = [plus(mean[i], total(times(gain[i][k], step[k]) for k in range(n))) for i in range(n)]
    change = symmetric(n, lambda i, j: minus(later_cov[i][j], after.cov[i][j]))
    piece.keep(wrapped(steps.motion.space, moved), added(cov, sandwich(gain, change)[1]))
    return piece
