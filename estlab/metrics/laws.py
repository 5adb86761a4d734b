"""The distribution of the NEES of a consistent filter."""

from typing import NamedTuple

import numpy as np

from estlab.maths.space import Array

SIGMAS = (1, 2, 3)

# A weighted sample's effective size describes its mean well, its covariance less: from here on the law holds to 4 %.
LEAST_EFFECTIVE = 100


class Law(NamedTuple):
    """Mean and variance of the NEES of a consistent filter, and how probable the value found is.

    mean, variance: (T, runs) or broadcasting to it; NaN where there is no such law. inside: (3, T, runs), whether the
    NEES is below the quantile of the probability that a Gaussian number lies within 1, 2, 3 standard deviations.
    """

    mean: Array
    variance: Array
    inside: Array


def nees_law(nees: Array, n: int, sample: Array | None) -> Law:
    """The law for states of n numbers: chi-square, or F if the covariance is a sample's.

    nees: (T, runs). sample: (2, T, runs), the size N of the sample, and the factor between the covariance and the
    unbiased one. Let S be the unbiased covariance of N states drawn from the Gaussian that the truth comes from, and
    their mean the estimate. Then e'S^-1 e is (1 + 1/N) times Hotelling's T squared: (1 + 1/N) n (N - 1) / (N - n)
    F(n, N - n). Anderson 2003, section 5.2.2. Its mean and variance exist for N > n + 4. A weighted sample counts as
    many states as its effective size, which is only correct for large ones. Smaller samples have no law here.
    """
    from scipy.special import chdtri, fdtr

    shares = np.array([within(sigmas) for sigmas in SIGMAS])[:, None, None]
    if sample is None:
        # Three quantiles are cheaper than a probability for every NEES.
        return Law(np.array(float(n)), np.array(2.0 * n), nees <= chdtri(n, 1.0 - shares))
    size, scale = sample
    size = np.where((size > n + 4) & ((scale == 1.0) | (size >= LEAST_EFFECTIVE)), size, np.nan)
    free = size - n
    unit = (1.0 + 1.0 / size) * n * (size - 1.0) / free / scale
    variance = 2.0 * free**2 * (n + free - 2.0) / (n * (free - 2.0) ** 2 * (free - 4.0))
    return Law(unit * free / (free - 2.0), unit**2 * variance, fdtr(n, free, nees / unit) <= shares)


def nis_mean(m: Array, gate: float | None) -> Array:
    """The mean NIS of m numbers measured: m, or less if a gate lets only this share of correct readings through.

    A chi-square below its quantile q of the gate's share has mean m F(q; m + 2) / F(q; m), with F its distribution.
    """
    from scipy.special import gammainc, gammaincinv

    if gate is None:
        return np.asarray(m, dtype=float)
    half = 0.5 * np.maximum(m, 1)
    return np.where(m > 0, m * gammainc(half + 1.0, gammaincinv(half, gate)) / gate, 0.0)


def within(sigmas: int) -> float:
    """The probability that a Gaussian number lies within so many standard deviations."""
    from scipy.special import erf

    return float(erf(sigmas / np.sqrt(2.0)))
