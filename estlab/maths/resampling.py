"""Random choice with replacement by weight. Douc, Cappe and Moulines 2005; Li, Bolic and Djuric 2015."""

from typing import Literal, NamedTuple, get_args

import numpy as np

from estlab.maths import cloud
from estlab.maths.space import Array
from estlab.maths.streams import Generators

Scheme = Literal["multinomial", "residual", "stratified", "systematic"]
SCHEMES: tuple[Scheme, ...] = get_args(Scheme)


class Weights(NamedTuple):
    """Weights that sum to one and their logarithms (N, runs), the effective size of each run's sample (runs,), and
    the runs (runs,) that had no weight left and got equal ones.
    """

    log: Array
    linear: Array
    size: Array
    vanished: Array

    @classmethod
    def even(cls, count: int, runs: int) -> "Weights":
        """Equal weights."""
        log, linear = (cloud.even(count, runs, value) for value in (-np.log(count), 1.0 / count))
        return cls(log, linear, np.full(runs, float(count)), np.zeros(runs, dtype=bool))

    def take(self, runs: Array) -> "Weights":
        """The weights of some of the runs."""
        return Weights(cloud.take(self.log, runs), cloud.take(self.linear, runs), self.size[runs], self.vanished[runs])

    def replaced(self, runs: Array, part: "Weights") -> "Weights":
        """The weights with those of some runs replaced."""
        return Weights(*(cloud.replaced(old, runs, new) for old, new in zip(self, part, strict=True)))

    @classmethod
    def of_logs(cls, logs: Array) -> "Weights":
        """Weights with these logarithms (N, runs), up to a factor; NaN means zero weight. Reuses the array."""
        count, runs = logs.shape
        top = logs.max(axis=0)
        vanished = ~np.isfinite(top)
        if vanished.any():
            logs[np.isnan(logs)] = -np.inf
            top = logs.max(axis=0)
            vanished = ~np.isfinite(top)
            logs[:, vanished], top[vanished] = 0.0, 0.0
        linear, sizes = cloud.empty(1, count, runs)[0], np.empty(runs)
        for own in cloud.groups(count, runs):
            sizes[own] = _normalise(logs[:, own], top[own], linear[:, own])
        return cls(logs, linear, sizes, vanished)


def _normalise(logs: Array, top: Array, linear: Array) -> Array:
    """Normalised log-weights (N, runs), with their exponentials stored in ``linear``; the effective sizes (runs,)."""

    def exponentials(part: slice) -> Array:
        logs[part] -= top
        weight = np.exp(logs[part], out=linear[part])
        return np.stack([weight.sum(axis=0), cloud.dot(weight, weight)])

    def shares(part: slice) -> None:
        logs[part] -= np.log(total)
        linear[part] /= total

    sums = cloud.each(exponentials, len(logs))
    total, squares = sum(sums[1:], sums[0])
    cloud.each(shares, len(logs))
    return total * total / squares


def resample(scheme: Scheme, weights: Array, generators: Generators) -> Array:
    """Indices (N, runs), each drawn N times its weight on average, with replacement; weights (N, runs)."""
    count, runs = weights.shape
    u = generators.uniforms((1 if scheme == "systematic" else count,))
    if scheme in ("systematic", "stratified"):
        return _one_a_stratum(weights, u)
    chosen = np.empty((runs, count), dtype=int).T
    for run in range(runs):
        chosen[:, run] = _choose(scheme, weights[:, run], u[:, run])
    return chosen


def _one_a_stratum(weights: Array, u: Array) -> Array:
    """For each of N equal shares of the weight, the point that contains (share + u) / N of it; u (1 or N, runs).

    A point's edge, the weight up to its end, shows to within one how many of the positions lie below it. Checking
    those gives the exact number, as a search for each position would, without the search.
    """
    count, runs = weights.shape
    edges = np.cumsum(weights.T, axis=1)
    end, share = edges[:, -1:], np.arange(count)
    positions = np.empty((runs, count + 3))
    positions[:, 0], positions[:, -2:] = -np.inf, np.inf
    positions[:, 1:-2] = (share + u.T) / count * end
    guess = np.minimum(edges * (count / end), count - 1).astype(int)
    at, below = guess + (count + 3) * np.arange(runs)[:, None], guess - 1
    for near in range(3):
        below += positions.take(at + near) < edges
    below[:, -1] = count  # positions beyond the last edge, by rounding, belong to the last point
    copies = np.diff(below, axis=1, prepend=0)
    return np.repeat(np.broadcast_to(share, copies.shape).reshape(-1), copies.reshape(-1)).reshape(runs, count).T


def _choose(scheme: Scheme, weights: Array, u: Array) -> Array:
    count = weights.size
    if scheme == "multinomial":
        return _pick(weights, np.sort(u))
    # Residual: the integer part of N w copies for certain, the rest at random by the remainders.
    copies = np.floor(count * weights).astype(int)
    certain = np.repeat(np.arange(count), copies)
    left = count * weights - copies
    missing = count - certain.size
    if missing == 0:
        return certain
    return np.concatenate([certain, _pick(left / left.sum(), np.sort(u[:missing]))])


def _pick(weights: Array, positions: Array) -> Array:
    edges = np.cumsum(weights)
    return np.minimum(np.searchsorted(edges, positions * edges[-1], side="right"), weights.size - 1)
