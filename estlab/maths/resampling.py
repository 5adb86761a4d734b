"""Choosing with replacement by weight. Douc, Cappe and Moulines 2005; Li, Bolic and Djuric 2015."""

from typing import Literal, get_args

import numpy as np

from estlab.maths.space import Array
from estlab.maths.streams import Draws

Scheme = Literal["multinomial", "residual", "stratified", "systematic"]
SCHEMES: tuple[Scheme, ...] = get_args(Scheme)


def effective_size(log_weights: Array) -> Array:
    """1 / sum w^2 (runs,) for normalised log-weights (N, runs)."""
    return 1.0 / np.exp(2.0 * log_weights).sum(axis=0)


def log_normalised(log_weights: Array) -> tuple[Array, Array]:
    """Log-weights (N, runs) that sum to one, and which runs (runs,) have none left and got equal ones."""
    with np.errstate(invalid="ignore"):
        clean = np.where(np.isnan(log_weights), -np.inf, log_weights)
        top = clean.max(axis=0)
        vanished = ~np.isfinite(top)
        shifted = np.where(vanished, 0.0, clean - np.where(vanished, 0.0, top))
    return shifted - np.log(np.exp(shifted).sum(axis=0)), vanished


def resample(scheme: Scheme, weights: Array, draws: Draws) -> Array:
    """Indices (N, runs), each drawn N times its weight in the mean, with replacement; weights (N, runs)."""
    count = weights.shape[0]
    u = draws.uniforms((1 if scheme == "systematic" else count,))
    chosen = np.empty(weights.shape, dtype=int)
    for run in range(weights.shape[1]):
        chosen[:, run] = _choose(scheme, weights[:, run], u[:, run])
    return chosen


def _choose(scheme: Scheme, weights: Array, u: Array) -> Array:
    count = weights.size
    if scheme == "residual":
        # Each its whole part of N w for certain, the rest at random by what is left over.
        copies = np.floor(count * weights).astype(int)
        certain = np.repeat(np.arange(count), copies)
        left = count * weights - copies
        missing = count - certain.size
        if missing == 0:
            return certain
        return np.concatenate([certain, _pick(left / left.sum(), np.sort(u[:missing]))])
    if scheme == "multinomial":
        return _pick(weights, np.sort(u))
    return _pick(weights, (np.arange(count) + u) / count)


def _pick(weights: Array, positions: Array) -> Array:
    edges = np.cumsum(weights)
    return np.minimum(np.searchsorted(edges, positions * edges[-1], side="right"), weights.size - 1)
