"""What a particle filter does with one particle, in components: it is moved, held against a reading, summed.

What is written here for components is what estlab.filters.particle and estlab.maths.cloud write for arrays; tests hold
both to each other. A sum over a run's particles has one order on every processor: particle p goes to sum p mod 8, and
the eight sums are added two by two.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from estlab.compiled.algebra import Row, minus, times, total
from estlab.compiled.model_graphs import MotionModel, SensorModel, wrapped
from estlab.compiled.pieces import Piece
from estlab.compiled.symbols import Symbol
from estlab.maths.space import Space

EIGHT = 8  # partial sums of each sum

Entries = Sequence[tuple[int, int]]  # of a matrix, those that are not zero


def move(motion: MotionModel, factor: Entries) -> Piece:
    """A particle after a step, its noise being a factor times standard normal numbers z."""
    piece, q = Piece(motion.space.size), motion.noises
    before, control = piece.tracer.leaves("before", piece.n), piece.tracer.leaves("control", motion.controls)
    dt, z = piece.tracer.leaf("lapse", 0, settled=True), piece.tracer.leaves("z", q)
    noise = _times(piece, "factor", factor, q, z)
    _put(piece, "after", motion.value(piece.tracer, before, control, noise, dt))
    return piece


def look(sensor: SensorModel, whitening: Entries) -> Piece:
    """The reading that a particle would give, and the logarithm of its weight; what is missing tells nothing."""
    piece, m = Piece(sensor.state.size), sensor.space.size
    tracer = piece.tracer
    places = [
        [tracer.leaf("place", k * sensor.coordinates + a) for a in range(sensor.coordinates)]
        for k in range(sensor.count)
    ]
    expected = sensor.value(tracer, tracer.leaves("point", piece.n), places)
    reading = tracer.leaves("reading", m)
    residual = wrapped(sensor.space, [minus(reading[a], expected[a]) for a in range(m)])
    residual = [piece.choose(reading[a] != reading[a], 0.0, residual[a]) for a in range(m)]
    whitened = _times(piece, "whitening", whitening, m, residual)
    square = total(times(entry, entry) for entry in whitened)
    _put(piece, "expected", expected)
    piece.outputs.append(("log", 0, minus(tracer.leaf("log_before"), square)))
    _sum(piece, _mean_terms(piece, sensor.space, expected))
    return piece


def mean_sums(space: Space) -> Piece:
    """A vector with its weight in the sums of a mean: see estlab.maths.space.Space.sums."""
    piece = Piece(space.size)
    _sum(piece, _mean_terms(piece, space, piece.tracer.leaves("vector", space.size)))
    return piece


def mean(space: Space) -> Piece:
    """The weighted mean from its sums."""
    piece, sums = Piece(space.size), _totals(space.size + len(space.angles))
    for i in range(space.size):
        found = sums(piece, i)
        if i in space.angles:
            found = np.arctan2(sums(piece, space.size + space.angles.index(i)), found)
        piece.outputs.append(("mean", i, found))
    return piece


def spread(space: Space) -> Piece:
    """A vector with its weight in the sums of a covariance, about the mean."""
    piece, n = Piece(space.size), space.size
    vector, middle = piece.tracer.leaves("vector", n), piece.tracer.leaves("mean", n)
    away = wrapped(space, [minus(vector[i], middle[i]) for i in range(n)])
    weight = piece.tracer.leaf("weight")
    weighted = [times(weight, entry) for entry in away]
    _sum(piece, [times(weighted[i], away[j]) for i in range(n) for j in range(i + 1)])
    return piece


def covariance(space: Space) -> Piece:
    """The covariance from its sums."""
    piece, n = Piece(space.size), space.size
    sums = _totals(n * (n + 1) // 2)
    for i in range(n):
        for j in range(i + 1):
            found = sums(piece, i * (i + 1) // 2 + j)
            piece.outputs += [("cov", a * n + b, found) for a, b in {(i, j), (j, i)}]
    return piece


def peak() -> Piece:
    """The largest logarithm of a weight so far, NaN being none."""
    piece = Piece(0)
    largest, log = piece.tracer.leaf("sums"), piece.tracer.leaf("log")
    piece.outputs.append(("sums", 0, piece.choose(log > largest, log, largest)))
    return piece


def top() -> Piece:
    """The largest of all; whether there is none, and then 0."""
    piece = Piece(0)
    parts = [piece.tracer.leaf("sums", k) for k in range(EIGHT)]
    largest = parts[0]
    for part in parts[1:]:
        largest = piece.choose(part > largest, part, largest)
    some = abs(largest) < math.inf
    piece.outputs += [("top", 0, piece.choose(some, largest, 0.0)), ("vanished", 0, piece.choose(some, 0.0, 1.0))]
    return piece


def exponential() -> Piece:
    """A weight but for its factor, and in sums, with its square; in a run that has none, 1. NaN is none."""
    piece = Piece(0)
    log, vanished = piece.tracer.leaf("log"), piece.tracer.leaf("vanished")
    log = piece.choose(log != log, -math.inf, log)
    log = piece.choose(vanished != 0.0, 0.0, log) - piece.tracer.leaf("top")
    weight = log.exp() * piece.tracer.leaf("present")
    piece.outputs += [("log", 0, log), ("linear", 0, weight)]
    _sum(piece, [weight, weight * weight])
    return piece


def normaliser() -> Piece:
    """What weights are to be divided by, its logarithm, and the effective size of their sample."""
    piece, sums = Piece(0), _totals(2)
    whole, squares = sums(piece, 0), sums(piece, 1)
    piece.outputs += [("total", 0, whole), ("total", 1, whole.log()), ("size", 0, whole * whole / squares)]
    return piece


def share() -> Piece:
    """A weight of those that sum to one."""
    piece = Piece(0)
    piece.outputs.append(("log", 0, piece.tracer.leaf("log") - piece.tracer.leaf("total", 1)))
    piece.outputs.append(("linear", 0, piece.tracer.leaf("linear") / piece.tracer.leaf("total")))
    return piece


def _times(piece: Piece, name: str, entries: Entries, size: int, vector: Row) -> Row:
    """A matrix of a run times a vector."""
    return [
        total(times(piece.tracer.leaf(name, i * size + j), vector[j]) for a, j in entries if a == i)
        for i in range(size)
    ]


def _put(piece: Piece, name: str, values: Row) -> None:
    piece.outputs += [(name, i, value) for i, value in enumerate(values)]


def _sum(piece: Piece, terms: Sequence[Any]) -> None:
    """Terms added to what is there."""
    piece.outputs += [("sums", k, piece.tracer.leaf("sums", k) + term) for k, term in enumerate(terms)]


def _mean_terms(piece: Piece, space: Space, vector: Row) -> Row:
    weight, sines = piece.tracer.leaf("weight"), []
    terms: Row = []
    for i, value in enumerate(vector):
        if i in space.angles:
            cosine, sine = (value if isinstance(value, Symbol) else piece.tracer.constant(value)).cos_sin()
            terms.append(times(weight, cosine))
            sines.append(times(weight, sine))
        else:
            terms.append(times(weight, value))
    return terms + sines


def _totals(count: int) -> Any:
    def found(piece: Piece, k: int) -> Symbol:
        parts = [piece.tracer.leaf("sums", EIGHT * k + part) for part in range(EIGHT)]
        while len(parts) > 1:
            half = len(parts) // 2
            parts = [parts[a] + parts[a + half] for a in range(half)]
        return parts[0]

    return found
