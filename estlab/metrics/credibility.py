"""How credible a covariance is, in decibels: the noncredibility and inclination indices."""

import numpy as np

from estlab.maths.linalg import cholesky, solve_lower
from estlab.maths.space import Array
from estlab.metrics.intervals import LEVEL, Estimate

_GROUPS = 20  # of the jackknife


def credibility(error: Array, nees: Array) -> tuple[Estimate, Estimate]:
    """Noncredibility index and inclination, 10 times the mean of |log10 rho| and of log10 rho. Li and Zhao 2006.

    rho is e'P^-1 e over e'S^-1 e, with P the filter's covariance and S the mean square error matrix of all runs at that
    time. 0 dB is credible; an inclination above 0 is overconfident, +3 dB a covariance of half the size it should have.
    error: (n, T, runs). nees: (T, runs). S comes from the same runs: under a Gaussian error e'S^-1 e over their number
    is a beta variable, and the known mean of its logarithm is allowed for. Intervals by a jackknife over groups of
    runs. NaN for fewer than 5 runs for each component of the state.
    """
    n, _, runs = error.shape
    nothing = Estimate(np.nan, np.nan, np.nan, runs)
    if runs < max(5 * n, _GROUPS):
        return nothing, nothing
    groups = np.arange(runs) % _GROUPS
    whole = _indices(error, nees)
    if not np.isfinite(whole).all():
        return nothing, nothing
    left_out = np.stack([_indices(error[..., groups != g], nees[:, groups != g]) for g in range(_GROUPS)])
    spread = np.sqrt((_GROUPS - 1) / _GROUPS * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0))
    from scipy.special import stdtrit

    half = float(stdtrit(_GROUPS - 1, 0.5 + LEVEL / 2.0)) * spread
    index, inclination = (
        Estimate(float(whole[i]), float(whole[i] - half[i]), float(whole[i] + half[i]), runs) for i in range(2)
    )
    return index._replace(low=max(index.low, 0.0)), inclination


def _indices(error: Array, nees: Array) -> Array:
    """Both indices, over the runs and times that have both quadratic forms."""
    from scipy.special import digamma

    n = error.shape[0]
    known = np.isfinite(nees) & np.isfinite(error).all(axis=0) & (nees > 0.0)
    count = known.sum(axis=1)
    off = np.where(known, error, 0.0)
    square = np.einsum("itr,jtr->ijt", off, off) / np.maximum(count, 1)
    factor = cholesky(square)
    scaled = solve_lower(factor[..., None], off[:, None])[:, 0]
    actual = np.einsum("i...,i...->...", scaled, scaled)
    usable = known & (actual > 0.0) & (count > n + 1)[:, None]
    if not usable.any():
        return np.full(2, np.nan)
    # E log of a chi-square less that of the beta variable: what is left for a matrix known exactly is log 2 + psi(n/2).
    allowance = np.log(2.0) + digamma(0.5 * count) - np.log(np.maximum(count, 1))
    ratio = np.log(np.where(usable, nees, 1.0) / np.where(usable, actual, 1.0)) - allowance[:, None]
    ratio = 10.0 / np.log(10.0) * ratio[usable]
    return np.array([np.abs(ratio).mean(), ratio.mean()])
