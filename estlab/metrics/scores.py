"""Scores one block of runs: errors, normalised errors and innovations, and which runs were lost."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estlab.maths.linalg import ROUNDING, cholesky, solve_lower
from estlab.maths.space import Array, Space
from estlab.metrics.laws import SIGMAS, nees_law, nis_mean
from estlab.metrics.masked import count
from estlab.record import Estimates, Record

LAGS = 5  # for the innovations' correlation
_MANY = 9
_END = 0.1  # a run is lost if its error is beyond the limit over this last part of its steps

# A diverging run has errors too large to square and negative variances before it becomes NaN: not worth a warning.
quietly = np.errstate(invalid="ignore", over="ignore", divide="ignore")


@dataclass(frozen=True)
class Limits:
    """A problem's limits on the position error for found and lost runs; None if it has no such notion."""

    found_within: float | None = None
    lost_beyond: float | None = None


@dataclass(frozen=True)
class Scores:
    """The scores of a filter over a block; only finite values are scored.

    error, sigma: (n, T, runs). scaled: (n, T, runs), L^-1 error with L the factor of the covariance, NaN where that
    is singular. nees, with the mean and variance of its law: (T, runs), and inside: (3, T, runs). nis, nis_mean,
    measured: (T, runs), summed over the step's readings, the mean of its law, and the number of values measured.
    distance: (T, runs) of the position, None if there is none.
    whitened: (m, N, runs). log_likelihood: (runs,) of all innovations used. not_finite, not_definite, lost: (runs,),
    no run in more than one.
    """

    error: Array
    sigma: Array
    scaled: Array
    nees: Array
    nees_mean: Array
    nees_variance: Array
    nees_inside: Array
    nis: Array
    nis_mean: Array
    measured: Array
    distance: Array | None
    whitened: Array
    log_likelihood: Array
    not_finite: Array
    not_definite: Array
    lost: Array

    @cached_property
    def scored(self) -> Array:
        """(n, T, runs) which errors are scored."""
        return np.isfinite(self.error) & np.isfinite(self.sigma)

    @property
    def diverged(self) -> Array:
        """(runs,) for any reason."""
        return self.not_finite | self.not_definite | self.lost

    def inside(self, sigmas: int) -> Array:
        """(n, T, runs) whether each error is within so many standard deviations."""
        return self.scored & (np.abs(self.error) <= sigmas * self.sigma)


def has_whole(space: Space) -> bool:
    """Whether a state has several components, all in the same unit, so that an error over all of them makes sense."""
    return space.size >= _MANY and len(set(space.units)) == 1


@quietly
def score(space: Space, limits: Limits, record: Record, estimates: Estimates) -> Scores:
    """Score a block of runs."""
    error = space.minus(estimates.mean, record.truth)
    sigma = np.sqrt(estimates.cov[range(space.size), range(space.size)])
    factor = cholesky(estimates.cov)
    definite, regular = _rank(factor, estimates)
    scaled = np.where(regular, solve_lower(factor, error[:, None])[:, 0], np.nan)
    nees = np.einsum("i...,i...->...", scaled, scaled)
    law = nees_law(nees, space.size, estimates.sample)
    nis, expected, measured = _per_step(record, estimates)
    distance = None
    if space.position:
        at = list(space.position)
        known = np.isfinite(error[at]).all(axis=0) & np.isfinite(sigma[at]).all(axis=0)
        distance = np.where(known, np.sqrt((error[at] ** 2).sum(axis=0)), np.nan)
    finite = np.isfinite(estimates.mean).all(axis=0) & np.isfinite(estimates.cov).all(axis=(0, 1))
    not_finite, not_definite = _broken(np.asarray(finite), definite)
    runs = nees.shape[1]
    return Scores(
        error=error,
        sigma=sigma,
        scaled=scaled,
        nees=nees,
        nees_mean=np.broadcast_to(law.mean, nees.shape),
        nees_variance=np.broadcast_to(law.variance, nees.shape),
        nees_inside=law.inside,
        nis=nis,
        nis_mean=expected,
        measured=measured,
        distance=distance,
        whitened=estimates.whitened,
        log_likelihood=log_likelihood(estimates.whitened, estimates.log_scale),
        not_finite=np.broadcast_to(not_finite, runs),
        not_definite=np.broadcast_to(not_definite, runs),
        lost=_lost(distance, limits.lost_beyond, runs) & ~(not_finite | not_definite),
    )


def found_time(time: Array, distance: Array, within: float) -> Array:
    """(runs,) the time from which the position error stays within bounds; NaN for a run that ends outside."""
    outside = ~(distance <= within)
    last = np.where(outside.any(axis=0), outside.shape[0] - 1 - outside[::-1].argmax(axis=0), -1)
    after = np.minimum(last + 1, time.size - 1)
    return np.where(last == time.size - 1, np.nan, time[after])


def log_likelihood(whitened: Array, log_scale: Array) -> Array:
    """(runs,) the sum of log N(nu; 0, S) over innovations, from L^-1 nu and the log of L's diagonal.

    With S = L L', log N(nu; 0, S) = -sum((L^-1 nu)^2 / 2 + log L_ii + log(2 pi) / 2). The innovations' densities are
    those of each reading given the earlier ones, so the sum is the log-likelihood of all. Schweppe 1965.
    """
    each = -0.5 * whitened**2 - log_scale - 0.5 * np.log(2.0 * np.pi)
    return np.asarray(np.where(np.isfinite(whitened), each, 0.0).sum(axis=(0, 1)))


def correlations(whitened: Array, lags: int) -> Array:
    """Each run's whitened innovations (m, N, runs) correlated with those 1, 2, ... readings earlier; (lags, runs).

    Sums of products of the same component over the sum of squares. Each has mean zero if innovations are white,
    whatever their scale. Readings that a run lacks are skipped. NaN for a run with fewer readings than four times the
    lags. Mehra 1970; Bar-Shalom, Li and Kirubarajan 2001, section 5.4.2.
    """
    has = np.isfinite(whitened).any(axis=0)
    if not has.all():
        order = np.argsort(~has, axis=0, kind="stable")
        whitened = np.take_along_axis(whitened, order[None], axis=1)
    known = np.nan_to_num(whitened)
    readings, total = count(np.asarray(has), 0), (known**2).sum(axis=(0, 1))
    found = np.full((lags, known.shape[2]), np.nan)
    for i in range(min(lags, known.shape[1] - 1)):
        found[i] = (known[:, i + 1 :] * known[:, : -i - 1]).sum(axis=(0, 1)) / np.where(total > 0.0, total, np.nan)
    return np.where(readings >= 4 * lags, found, np.nan)


def shares_inside(scores: Scores) -> tuple[Array, Array]:
    """Which errors are within 1, 2, 3 sigma, and which count at all; (3, n + 1, T, runs), the last for all jointly."""
    inside = np.stack([np.concatenate([scores.inside(k), scores.nees_inside[i][None]]) for i, k in enumerate(SIGMAS)])
    lawful = ~np.isnan(scores.nees) & np.isfinite(scores.nees_mean)
    counted = np.concatenate([scores.scored, lawful[None]])
    return inside, np.broadcast_to(counted, inside.shape)


def _per_step(record: Record, estimates: Estimates) -> tuple[Array, Array, Array]:
    """NIS, the mean of its law and the number of values measured, (T, runs), from innovations in order of steps."""
    whitened = estimates.whitened
    steps, runs = record.time.size, whitened.shape[2]
    nis, expected, measured = np.zeros((steps, runs)), np.zeros((steps, runs)), np.zeros((steps, runs), dtype=int)
    if whitened.size:
        taken, first = np.unique(record.readings.step, return_index=True)
        known = np.isfinite(whitened)
        nis[taken] = np.add.reduceat((np.where(known, whitened, 0.0) ** 2).sum(axis=0), first, axis=0)
        numbers = count(known, 0)
        expected[taken] = np.add.reduceat(nis_mean(numbers, estimates.gate), first, axis=0)
        measured[taken] = np.add.reduceat(numbers, first, axis=0)
    return nis, expected, measured


def _rank(factor: Array, estimates: Estimates) -> tuple[Array, Array]:
    """(T, runs) whether a covariance is valid, given its factor, and whether it has an inverse, which NEES needs.

    A covariance without an inverse is valid where part of the state is known exactly, such as a start, and no noise
    has reached it. A singular sample covariance, of no more states than components, shows that the cloud has
    collapsed.
    """
    n = factor.shape[0]
    pivots = np.einsum("ii...->i...", factor)
    sound = np.asarray(np.isfinite(pivots)).all(axis=0)
    if estimates.sample is None:
        variances = np.einsum("ii...->i...", estimates.cov)
        return np.asarray(sound), np.asarray(np.all(pivots**2 > n * ROUNDING * variances, axis=0))
    regular = np.asarray(np.all(pivots > 0.0, axis=0))
    return regular | (sound & (estimates.sample[0] > n)), regular


def _broken(finite: Array, definite: Array) -> tuple[Array, Array]:
    """(runs,) whose beliefs (T, runs) first stopped being finite, and whose covariances first stopped being valid."""
    sound = finite & definite
    first = (~sound).argmax(axis=0)
    broken = ~sound.all(axis=0)
    still_finite = np.take_along_axis(finite, first[None], axis=0)[0]
    return np.asarray(broken & ~still_finite), np.asarray(broken & still_finite)


def _lost(distance: Array | None, beyond: float | None, runs: int) -> Array:
    """(runs,) whose position error stays beyond a limit over the last part of the steps."""
    if distance is None or beyond is None:
        return np.zeros(runs, dtype=bool)
    end = distance[-max(1, round(_END * distance.shape[0])) :]
    known = np.isfinite(end)
    return np.asarray(known.any(axis=0) & (~known | (end > beyond)).all(axis=0))
