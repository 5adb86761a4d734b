"""The update with a reading: one gain for the family, and the iterated update."""

import math
from typing import Any, NamedTuple

from estlab.compiled.algebra import (
    Matrix,
    Row,
    added,
    inner,
    matmul,
    minus,
    plus,
    solve_lower,
    symmetric,
    times,
    total,
    transpose,
)
from estlab.compiled.model_graphs import wrapped
from estlab.compiled.moment_matching import TracedMoments, factored, linearised
from estlab.compiled.predictions import predicted_reading
from estlab.compiled.routines import Routine, Steps, slots, unless
from estlab.compiled.symbols import Symbol


class Reading(NamedTuple):
    """The measured values (m numbers), which are missing, and their landmarks."""

    values: Row
    missing: list[Symbol | None]
    landmarks: list[Row]


class UpdatedBelief(NamedTuple):
    """A belief given a reading; the whitened innovation and the diagonal of its factor."""

    mean: Row
    cov: Matrix
    whitened: Row
    scales: Row
    gated: Symbol | None


def reading_of(steps: Steps, routine: Routine) -> Reading:
    """The reading as it is given; NaN means not measured."""
    sensor, tracer = steps.sensor, routine.tracer
    values = tracer.leaves("value", sensor.space.size)
    landmarks = [
        [tracer.leaf("landmark", k * sensor.coordinates + a) for a in range(sensor.coordinates)]
        for k in range(sensor.count)
    ]
    missing = [value != value if steps.masked else None for value in values]  # NaN
    return Reading(values, missing, landmarks)


def updated(steps: Steps, routine: Routine) -> None:
    """The belief given the reading, its innovation, and whether it was rejected."""
    mean, cov = routine.belief()
    reading = reading_of(steps, routine)
    moments = predicted_reading(steps, routine, mean, cov, reading.landmarks)
    first = found = condition(steps, routine, mean, cov, moments, reading, steps.method.gated)
    for _ in range(steps.method.iterations - 1):
        found = again(steps, routine, mean, cov, found, reading)
        if first.gated is not None:
            # A reading that passed the gate is not tested again.
            kept = [routine.choose(first.gated, first.mean[i], found.mean[i]) for i in range(steps.n)]
            found = found._replace(mean=kept, cov=chosen(routine, first.gated, first.cov, found.cov))
    routine.keep(found.mean, found.cov)
    record_innovation(steps, routine, reading, first.whitened, first.scales, first.gated)


def chosen(routine: Routine, condition: Symbol, yes: Matrix, no: Matrix) -> Matrix:
    """One symmetric matrix or the other."""
    return symmetric(len(yes), lambda i, j: routine.choose(condition, yes[i][j], no[i][j]))


def again(
    steps: Steps, routine: Routine, mean: Row, cov: Matrix, found: UpdatedBelief, reading: Reading
) -> UpdatedBelief:
    """The update once more, with the sensor relinearised at the last estimate."""
    sensor, tracer = steps.sensor, routine.tracer
    offset = wrapped(sensor.state, [minus(mean[i], found.mean[i]) for i in range(steps.n)])
    jacobian = sensor.jacobian(tracer, found.mean, reading.landmarks)
    value = sensor.value(tracer, found.mean, reading.landmarks)
    moved = [plus(value[a], inner(jacobian[a], offset)) for a in range(len(value))]
    moments = linearised(moved, jacobian, cov)
    moments = moments._replace(cov=added(moments.cov, steps.reading_noise(tracer, factor=False)))
    return condition(steps, routine, mean, cov, moments, reading, gate=False)


def condition(
    steps: Steps, routine: Routine, mean: Row, cov: Matrix, moments: TracedMoments, reading: Reading, gate: bool
) -> UpdatedBelief:
    """The one gain: see estlab.filters.gaussian.GaussianFilter.condition. Missing values carry no information."""
    sensor, n, m = steps.sensor, steps.n, steps.sensor.space.size
    missing = reading.missing
    innovation = wrapped(sensor.space, [minus(reading.values[a], moments.mean[a]) for a in range(m)])
    innovation = [unless(missing[a], routine, innovation[a], 0.0) for a in range(m)]
    cross = [[unless(missing[a], routine, moments.cross[c][a], 0.0) for a in range(m)] for c in range(n)]
    factor = factored(without(routine, moments.cov, missing), routine.failed)
    both = solve_lower(factor, [[*row, innovation[a]] for a, row in enumerate(transpose(cross, m))])
    half_gain, whitened = [row[:n] for row in both], [row[n] for row in both]
    gated = refused(steps, routine, whitened, missing) if gate else None
    if gated is not None:
        half_gain = [[unless(gated, routine, entry, 0.0) for entry in row] for row in half_gain]
    moved = [plus(mean[c], total(times(half_gain[a][c], whitened[a]) for a in range(m))) for c in range(n)]
    less = matmul(transpose(half_gain, n), half_gain)
    shrunk = symmetric(n, lambda i, j: minus(cov[i][j], less[i][j]))
    return UpdatedBelief(wrapped(sensor.state, moved), shrunk, whitened, [factor[a][a] for a in range(m)], gated)


def either(a: Symbol | None, b: Symbol | None) -> Symbol | None:
    """Whether one of two conditions is true, of which None never is."""
    if a is None or b is None:
        return b if a is None else a
    found: Symbol = a | b
    return found


def without(routine: Routine, cov: Matrix, missing: list[Symbol | None]) -> Matrix:
    """A covariance in which missing values are independent, with unit variance."""

    def entry(i: int, j: int) -> Any:
        return unless(missing[i] if i == j else either(missing[i], missing[j]), routine, cov[i][j], float(i == j))

    return symmetric(len(cov), entry)


def refused(steps: Steps, routine: Routine, whitened: Row, missing: list[Symbol | None]) -> Symbol:
    """Whether the squared length of the innovation exceeds the gate's quantile for so many values."""
    nis = total(entry * entry for entry in whitened)
    limit: Any = math.inf
    if not steps.masked:
        limit = steps.parameters.leaf(routine.tracer, f"quantile {len(missing)}", steps.quantiles[len(missing)])
        missing = []
    count = total(unless(absent, routine, 1.0, 0.0) for absent in missing)
    for k in range(1, len(missing) + 1):
        quantile = steps.parameters.leaf(routine.tracer, f"quantile {k}", steps.quantiles[k])
        limit = routine.choose(count == float(k), quantile, limit)
    found: Symbol = nis > limit
    return found


def record_innovation(
    steps: Steps, routine: Routine, reading: Reading, whitened: Row, scales: Row, gated: Symbol | None
) -> None:
    """The whitened innovation; NaN where nothing was measured or used."""
    for a, absent in enumerate(reading.missing):
        unused = either(absent, gated)
        routine.outputs.append(("whitened", a, unless(unused, routine, whitened[a], math.nan)))
        routine.outputs.append(("log_scale", a, unless(unused, routine, scales[a].log(), math.nan)))
    if gated is not None:
        at = slots(steps.n) - 1
        count = routine.tracer.leaf("belief", at)
        routine.outputs.append(("belief", at, count + routine.choose(gated, 1.0, 0.0)))
