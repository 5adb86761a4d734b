"""How credible a covariance is, in decibels: the noncredibility and inclination indices."""

import numpy as np

from estlab.maths.linalg import cholesky, solve_lower
from estlab.maths.space import Array
from estlab.metrics.intervals import CONFIDENCE, Estimate

_GROUPS = 20  # for the jackknife


def credibility(error: Array, nees: Array) -> tuple[Estimate, Estimate]:
    """Noncredibility index and inclination, 10 times the mean of |log10 rho| and of log10 rho. Li and Zhao 2006.

    rho is e'P^-1 e over e'S^-1 e, with P the filter's covariance and S the mean square error matrix of all runs at
    that time. 0 dB is credible. An inclination above 0 is overconfident; +3 dB means a covariance of half the correct
    size. error: (n, T, runs). nees: (T, runs). S comes from the same runs: for a Gaussian error e'S^-1 e over their
    number is a beta variable, and the known mean of its logarithm corrects for that. Intervals come from a jackknife
    over groups of runs. NaN for fewer than 5 runs for each component of the state.
    """
    n, _, runs = error.shape
    nothing = Estimate(np.nan, np.nan, np.nan, runs)
    if runs < max(5 * n, _GROUPS):
        return nothing, nothing
    whole, left_out = _indices(error, nees)
    if not np.isfinite(whole).all():
        return nothing, nothing
    spread = np.sqrt((_GROUPS - 1) / _GROUPS * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0))
    from scipy.special import stdtrit

    half = float(stdtrit(_GROUPS - 1, 0.5 + CONFIDENCE / 2.0)) * spread
    index, inclination = (
        Estimate(float(whole[i]), float(whole[i] - half[i]), float(whole[i] + half[i]), runs) for i in range(2)
    )
    return index._replace(low=max(index.low, 0.0)), inclination


def _indices(error: Array, nees: Array) -> tuple[Array, Array]:
    """Both indices, and both without each of the groups of runs, over runs and times that have both quadratic forms."""
    known = np.isfinite(nees) & np.isfinite(error).all(axis=0) & (nees > 0.0)
    off = np.where(known, error, 0.0)
    groups = [slice(group, None, _GROUPS) for group in range(_GROUPS)]
    counts = np.stack([known[:, group].sum(axis=1) for group in groups])
    squares = np.stack([np.einsum("itr,jtr->ijt", off[..., group], off[..., group]) for group in groups])
    level = np.log(np.where(known, nees, 1.0))
    whole = _index(off, known, level, counts.sum(axis=0), squares.sum(axis=0))
    left_out = []
    for g, group in enumerate(groups):
        # Added again from scratch: subtracting one group from the total would lose the others beside a group with a
        # diverged run.
        count, square = (np.delete(sums, g, axis=0).sum(axis=0) for sums in (counts, squares))
        others = known.copy()
        others[:, group] = False
        left_out.append(_index(off, others, level, count, square))
    return whole, np.stack(left_out)


def _index(off: Array, known: Array, level: Array, count: Array, square: Array) -> Array:
    """Both indices of the known errors (n, T, runs) and their log NEES (T, runs), from sums of squares."""
    from scipy.special import digamma

    n = off.shape[0]
    factor = cholesky(square / np.maximum(count, 1))
    scaled = solve_lower(factor[..., None], off[:, None])[:, 0]
    actual = np.einsum("i...,i...->...", scaled, scaled)
    usable = known & (actual > 0.0) & (count > n + 1)[:, None]
    if not usable.any():
        return np.full(2, np.nan)
    # E log of a chi-square minus that of the beta variable: for a matrix known exactly, log 2 + psi(n/2) remains.
    allowance = np.log(2.0) + digamma(0.5 * count) - np.log(np.maximum(count, 1))
    ratio = level - np.log(np.where(usable, actual, 1.0)) - allowance[:, None]
    ratio = 10.0 / np.log(10.0) * np.where(usable, ratio, 0.0)
    return np.array([np.abs(ratio).sum(), ratio.sum()]) / usable.sum()
