"""The work of a particle filter on one particle, in components: move it, compare it with a reading, add it to sums.

This module writes for components what estlab.filters.particle and estlab.maths.cloud write for arrays; tests compare
both. A sum over a run's particles has one order on every processor: particle p goes to sum p mod 8, and the eight
sums are added two by two.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from estlab.compiled.algebra import Row, minus, solve_lower, symmetric, times, total
from estlab.compiled.model_graphs import MotionModel, SensorModel, wrapped
from estlab.compiled.moment_matching import factored
from estlab.compiled.routines import Routine
from estlab.compiled.symbols import Symbol
from estlab.compiled.updates import without
from estlab.maths.space import Space

EIGHT = 8  # partial sums of each sum

Entries = Sequence[tuple[int, int]]  # entries of a matrix that are not zero


def move(motion: MotionModel, factor: Entries) -> Routine:
    """A particle after a step; its noise is a factor times standard normal numbers z."""
    routine, q = Routine(motion.space.size), motion.noises
    before, control = routine.tracer.leaves("before", routine.n), routine.tracer.leaves("control", motion.controls)
    dt, z = routine.tracer.leaf("lapse", 0, settled=True), routine.tracer.leaves("z", q)
    noise = _times(routine, "factor", factor, q, z)
    _put(routine, "after", motion.value(routine.tracer, before, control, noise, dt))
    return routine


def look(sensor: SensorModel, whitening: Entries) -> Routine:
    """The reading that a particle would give, and the logarithm of its weight. Missing values carry no information."""
    routine, m = Routine(sensor.state.size), sensor.space.size
    tracer = routine.tracer
    landmarks = [
        [tracer.leaf("landmark", k * sensor.coordinates + a) for a in range(sensor.coordinates)]
        for k in range(sensor.count)
    ]
    expected = sensor.value(tracer, tracer.leaves("point", routine.n), landmarks)
    reading = tracer.leaves("reading", m)
    residual = wrapped(sensor.space, [minus(reading[a], expected[a]) for a in range(m)])
    residual = [routine.choose(reading[a] != reading[a], 0.0, residual[a]) for a in range(m)]
    whitened = _times(routine, "whitening", whitening, m, residual)
    square = total(times(entry, entry) for entry in whitened)
    _put(routine, "expected", expected)
    routine.outputs.append(("log", 0, minus(tracer.leaf("log_before"), square)))
    _sum(routine, _mean_terms(routine, sensor.space, expected))
    return routine


def mean_sums(space: Space) -> Routine:
    """A vector with its weight in the sums of a mean: see estlab.maths.space.Space.sums."""
    routine = Routine(space.size)
    _sum(routine, _mean_terms(routine, space, routine.tracer.leaves("vector", space.size)))
    return routine


def mean(space: Space) -> Routine:
    """The weighted mean from its sums."""
    routine, sums = Routine(space.size), _totals(space.size + len(space.angles))
    for i in range(space.size):
        found = sums(routine, i)
        if i in space.angles:
            found = np.arctan2(sums(routine, space.size + space.angles.index(i)), found)
        routine.outputs.append(("mean", i, found))
    return routine


def spread(space: Space) -> Routine:
    """A vector with its weight in the sums of a covariance, about the mean."""
    routine, n = Routine(space.size), space.size
    vector, middle = routine.tracer.leaves("vector", n), routine.tracer.leaves("mean", n)
    away = wrapped(space, [minus(vector[i], middle[i]) for i in range(n)])
    weight = routine.tracer.leaf("weight")
    weighted = [times(weight, entry) for entry in away]
    _sum(routine, [times(weighted[i], away[j]) for i in range(n) for j in range(i + 1)])
    return routine


def covariance(space: Space) -> Routine:
    """The covariance from its sums."""
    routine, n = Routine(space.size), space.size
    sums = _totals(n * (n + 1) // 2)
    for i in range(n):
        for j in range(i + 1):
            found = sums(routine, i * (i + 1) // 2 + j)
            routine.outputs += [("cov", a * n + b, found) for a, b in {(i, j), (j, i)}]
    return routine


def innovation(space: Space) -> Routine:
    """How far the reading lies from its expectation, whitened: see estlab.filters.filter.Innovation."""
    routine, m = Routine(space.size), space.size
    tracer = routine.tracer
    reading, middle = tracer.leaves("reading", m), tracer.leaves("mean", m)
    missing = [value != value for value in reading]  # NaN
    away = wrapped(space, [minus(reading[a], middle[a]) for a in range(m)])
    away = [routine.choose(missing[a], 0.0, away[a]) for a in range(m)]
    cov = symmetric(m, lambda i, j: tracer.leaf("cov", i * m + j) + tracer.leaf("noise", i * m + j))
    factor = factored(without(routine, cov, list(missing)), routine.failed)
    for a, (whitened,) in enumerate(solve_lower(factor, [[entry] for entry in away])):
        routine.outputs.append(("whitened", a, routine.choose(missing[a], math.nan, whitened)))
        routine.outputs.append(("log_scale", a, routine.choose(missing[a], math.nan, factor[a][a].log())))
    return routine


def peak() -> Routine:
    """The largest logarithm of a weight so far; NaN counts as none."""
    routine = Routine(0)
    largest, log = routine.tracer.leaf("sums"), routine.tracer.leaf("log")
    routine.outputs.append(("sums", 0, routine.choose(log > largest, log, largest)))
    return routine


def top() -> Routine:
    """The largest of all; and whether there is none, in which case it is 0."""
    routine = Routine(0)
    parts = [routine.tracer.leaf("sums", k) for k in range(EIGHT)]
    largest = parts[0]
    for part in parts[1:]:
        largest = routine.choose(part > largest, part, largest)
    some = abs(largest) < math.inf
    routine.outputs += [("top", 0, routine.choose(some, largest, 0.0)), ("vanished", 0, routine.choose(some, 0.0, 1.0))]
    return routine


def exponential() -> Routine:
    """A weight up to its factor, added to sums with its square; 1 in a run that has none. NaN counts as none."""
    routine = Routine(0)
    log, vanished = routine.tracer.leaf("log"), routine.tracer.leaf("vanished")
    log = routine.choose(log != log, -math.inf, log)
    log = routine.choose(vanished != 0.0, 0.0, log) - routine.tracer.leaf("top")
    weight = log.exp() * routine.tracer.leaf("present")
    routine.outputs += [("log", 0, log), ("linear", 0, weight)]
    _sum(routine, [weight, weight * weight])
    return routine


def normaliser() -> Routine:
    """The divisor of the weights, its logarithm, and the effective size of their sample."""
    routine, sums = Routine(0), _totals(2)
    whole, squares = sums(routine, 0), sums(routine, 1)
    routine.outputs += [("total", 0, whole), ("total", 1, whole.log()), ("size", 0, whole * whole / squares)]
    return routine


def share() -> Routine:
    """A weight of those that sum to one."""
    routine = Routine(0)
    routine.outputs.append(("log", 0, routine.tracer.leaf("log") - routine.tracer.leaf("total", 1)))
    routine.outputs.append(("linear", 0, routine.tracer.leaf("linear") / routine.tracer.leaf("total")))
    return routine


def _times(routine: Routine, name: str, entries: Entries, size: int, vector: Row) -> Row:
    """A matrix of a run times a vector."""
    return [
        total(times(routine.tracer.leaf(name, i * size + j), vector[j]) for a, j in entries if a == i)
        for i in range(size)
    ]


def _put(routine: Routine, name: str, values: Row) -> None:
    routine.outputs += [(name, i, value) for i, value in enumerate(values)]


def _sum(routine: Routine, terms: Sequence[Any]) -> None:
    """Terms added to the existing sums."""
    routine.outputs += [("sums", k, routine.tracer.leaf("sums", k) + term) for k, term in enumerate(terms)]


def _mean_terms(routine: Routine, space: Space, vector: Row) -> Row:
    weight, sines = routine.tracer.leaf("weight"), []
    terms: Row = []
    for i, value in enumerate(vector):
        if i in space.angles:
            cosine, sine = (value if isinstance(value, Symbol) else routine.tracer.constant(value)).cos_sin()
            terms.append(times(weight, cosine))
            sines.append(times(weight, sine))
        else:
            terms.append(times(weight, value))
    return terms + sines


def _totals(count: int) -> Any:
    def found(routine: Routine, k: int) -> Symbol:
        parts = [routine.tracer.leaf("sums", EIGHT * k + part) for part in range(EIGHT)]
        while len(parts) > 1:
            half = len(parts) // 2
            parts = [parts[a] + parts[a + half] for a in range(half)]
        return parts[0]

    return found
