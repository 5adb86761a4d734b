"""The Rauch-Tung-Striebel smoother for the Gaussian family: estimates of earlier states from later readings."""

from typing import NamedTuple

import numpy as np

from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.linalg import (
    ROUNDING,
    cholesky,
    matmul,
    matvec,
    sandwich,
    solve_lower,
    solve_lower_transposed,
    symmetric,
    transpose,
)
from estlab.maths.space import Array, Space
from estlab.maths.transforms import Moments


class Link(NamedTuple):
    """A prediction: the belief before it, and the moments of the one after it with their cross-covariance."""

    before: Gaussian
    after: Moments


def smooth(space: Space, links: list[Link | None], mean: Array, cov: Array) -> tuple[Array, Array]:
    """Smoothed mean (n, T, runs) and cov (n, n, T, runs) from the filtered ones.

    links[k]: the prediction that led to step k, None if no time passed. Saerkkae 2013, section 9.1: the gain is C
    P^-1 with C the cross-covariance of the state before and after, from any transform.
    """
    smoothed_mean, smoothed_cov = mean.copy(), cov.copy()
    later = Gaussian(mean[:, -1], cov[:, :, -1])
    for k in range(mean.shape[1] - 1, 0, -1):
        link = links[k]
        if link is not None:
            smoother_gain = _smoother_gain(link.after)
            step = space.minus(later.mean, link.after.mean)
            before = space.plus(link.before.mean, matvec(smoother_gain, step))
            shrunk = link.before.cov + sandwich(smoother_gain, later.cov - link.after.cov)
            later = Gaussian(before, symmetric(shrunk))
        smoothed_mean[:, k - 1], smoothed_cov[:, :, k - 1] = later
    return smoothed_mean, smoothed_cov


def _smoother_gain(after: Moments) -> Array:
    """C P^-1 (n, n, runs). Where P is singular so is C, and any generalised inverse gives the same result."""
    factor = cholesky(after.cov)
    # C P^-1 = (L^-T L^-1 C')' with P = L L'
    smoother_gain = transpose(solve_lower_transposed(factor, solve_lower(factor, transpose(after.cross))))
    every, slack = range(len(factor)), len(factor) * ROUNDING
    singular = np.asarray(factor[every, every] ** 2 <= slack * after.cov[every, every]).any(axis=0)
    if singular.any():
        smoother_gain[..., singular] = matmul(after.cross[..., singular], _inverse(after.cov[..., singular], slack))
    return smoother_gain


def _inverse(cov: Array, slack: float) -> Array:
    """A generalised inverse (n, n, N) of semidefinite matrices, by the eigenvalues of their correlations."""
    scale = np.sqrt(cov[range(len(cov)), range(len(cov))])
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(np.moveaxis(cov / scale / scale[:, None], -1, 0))
    spread = vectors * np.where(values > slack, 1.0 / values, 0.0)[:, None]
    return np.asarray(np.moveaxis(spread @ vectors.swapaxes(1, 2), 0, -1) / scale / scale[:, None])
