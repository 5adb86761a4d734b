"""Sums over runs at each time, and moments of each run's results. Their size does not grow with the number of runs."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estlab.maths.space import Array, Space
from estlab.metrics.masked import count, mean, or_nan, total
from estlab.metrics.moments import Histogram, SampleMoments
from estlab.metrics.scores import (
    LAGS,
    Limits,
    Scores,
    correlations,
    found_time,
    has_whole,
    quietly,
    score,
    shares_inside,
)
from estlab.record import Estimates, Record

_NAMED = 100  # diverged runs that are listed, for each kind
_SAMPLE_RUNS, _SAMPLE_BYTES = 500, 2**24  # single errors that are kept, for statistics that cannot be added

CAUSES = ("not_finite", "not_definite", "lost")


@dataclass
class Tally:
    """Errors and consistency of one filter over runs: of a block, and of blocks added together.

    Only finite values are scored: a gap in the truth or a run that broke does not count in a mean, and every figure
    comes with the number of values behind it. repeated: whether all runs share one truth and one set of readings.
    begin: the number of the ensemble's first run.

    sampled: whether covariances are a sample's. gated: whether outliers are rejected. sums: over runs, at each time.
    moments: over runs, of each run's results; ``converged`` in the name: only of those that neither broke nor were
    lost. histograms: of the same squares. diverged, diverged_first: how many runs diverged, and the first of them, by
    cause. first_whitened: innovations (m, N) of the first run. first: errors (n, T, K) and NEES (T, K) of the first
    runs, for statistics that cannot be added.
    """

    space: Space
    time: Array
    limits: Limits = field(default_factory=Limits)
    repeated: bool = False
    begin: int = 0
    runs: int = 0
    sampled: bool = False
    gated: bool = False
    sums: dict[str, Array] = field(default_factory=dict)
    moments: dict[str, SampleMoments] = field(default_factory=dict)
    histograms: dict[str, Histogram] = field(default_factory=dict)
    diverged: dict[str, int] = field(default_factory=lambda: dict.fromkeys(CAUSES, 0))
    diverged_first: dict[str, list[int]] = field(default_factory=lambda: {cause: [] for cause in CAUSES})
    first_whitened: Array = field(default_factory=lambda: np.empty((0, 0)))
    first: tuple[Array, Array] = field(default_factory=lambda: (np.empty((0, 0, 0)), np.empty((0, 0))))

    @quietly
    def add(self, record: Record, estimates: Estimates, numbers: Sequence[int]) -> dict[str, Array]:
        """Add a block of runs with these numbers, once. Returns each run's squared errors, for comparisons.

        Those of a run that broke are infinite: over the steps before, it would look better than one that continued.
        """
        scores = score(self.space, self.limits, record, estimates)
        self.runs, self.first_whitened = len(numbers), scores.whitened[:, :, 0]
        self.sampled, self.gated = estimates.sample is not None, estimates.gate is not None
        self._sum(scores, estimates)
        self._count_diverged(scores, numbers)
        self._keep_first(scores, numbers)
        lapse = np.diff(record.time, prepend=record.start)
        lapse = lapse / lapse.sum() if lapse.sum() > 0.0 else np.full(lapse.size, 1.0 / lapse.size)
        squares = self._squares(scores)
        self._take_moments(
            **squares,
            **{f"{name}_converged": np.where(scores.diverged, np.nan, values) for name, values in squares.items()},
            **self._errors(scores, lapse),
            **self._consistency(scores, estimates),
        )
        for name, values in squares.items():
            self.histograms[name] = Histogram(values.shape[:-1])
            self.histograms[name].add(values if name == "anees" else np.sqrt(values))
        self.moments["bias"] = SampleMoments.of(mean(scores.error / scores.sigma, scores.scored, 1))
        self.moments["scaled"] = SampleMoments.of(mean(scores.scaled, np.isfinite(scores.scaled), 1))
        self.moments["correlation"] = SampleMoments.of(correlations(scores.whitened, LAGS))
        broken = scores.not_finite | scores.not_definite
        return {name: np.where(broken, np.inf, values) for name, values in squares.items()}

    def plus(self, other: "Tally") -> "Tally":
        """The runs of both; those of the other come after."""
        room = self._most
        errors, nees = (np.concatenate(pair, axis=-1)[..., :room] for pair in zip(self.first, other.first, strict=True))
        return replace(
            self,
            runs=self.runs + other.runs,
            sums={name: array + other.sums[name] for name, array in self.sums.items()},
            moments={name: moments.plus(other.moments[name]) for name, moments in self.moments.items()},
            histograms={name: counts.plus(other.histograms[name]) for name, counts in self.histograms.items()},
            diverged={cause: self.diverged[cause] + other.diverged[cause] for cause in CAUSES},
            diverged_first={c: (self.diverged_first[c] + other.diverged_first[c])[:_NAMED] for c in CAUSES},
            first=(errors, nees),
        )

    def _squares(self, scores: Scores) -> dict[str, Array]:
        """Each run's mean square errors and ANEES, (..., runs)."""
        found = {"mean_square": mean(scores.error**2, scores.scored, 1)}
        if scores.distance is not None:
            found["position_square"] = mean(scores.distance**2, np.isfinite(scores.distance), 0)
        if has_whole(self.space):
            found["state_square"] = mean(scores.error**2, scores.scored, (0, 1))
        found["anees"] = mean(scores.nees, np.isfinite(scores.nees), 0) / self.space.size
        return found

    def _errors(self, scores: Scores, lapse: Array) -> dict[str, Array]:
        """Each run's error statistics beyond the squares. lapse: (T,), each step's share of the time."""
        scored, sized = scores.scored, np.isfinite(scores.nees)
        inside, counted = shares_inside(scores)
        found = {
            "mean_error": mean(scores.error, scored, 1),
            "median_abs_error": _median(np.where(scored, np.abs(scores.error), np.nan)),
            "mean_sigma": mean(scores.sigma, scored, 1),
            "inside": mean(inside, counted, 2),
            "inside_last": np.where(counted[:, :, -1], inside[:, :, -1], np.nan),
            "scored": np.einsum("t,itr->ir", lapse, scored),
            "nees_scored": np.einsum("t,tr->r", lapse, sized),
        }
        if scores.distance is not None:
            known = np.isfinite(scores.distance)
            found["position_median"] = _median(np.where(known, scores.distance, np.nan))
            found["position_scored"] = np.einsum("t,tr->r", lapse, known)
            if self.limits.found_within is not None:
                when = found_time(self.time, scores.distance, self.limits.found_within)
                found |= {"found_time": when, "found": np.isfinite(when).astype(float)}
        return found

    def _consistency(self, scores: Scores, estimates: Estimates) -> dict[str, Array]:
        """Each run's NEES and NIS over their expectations, NIS over the values measured, and effective sample size."""
        lawful = np.isfinite(scores.nees) & np.isfinite(scores.nees_mean)
        nees = total(scores.nees, lawful, 0) / or_nan(total(scores.nees_mean, lawful, 0))
        found = {
            "nees": nees,
            "nees_converged": np.where(scores.diverged, np.nan, nees),
            "lawful": mean(lawful.astype(float), np.isfinite(scores.nees), 0),
            "anis": scores.nis.sum(axis=0) / or_nan(scores.measured.sum(axis=0)),
            "nis": scores.nis.sum(axis=0) / or_nan(scores.nis_mean.sum(axis=0)),
            "loglik": scores.log_likelihood / or_nan(scores.measured.sum(axis=0)),
        }
        if estimates.sample is not None:
            # If the law is unknown at any step, the cloud came from few states.
            found["starved"] = (~np.isfinite(scores.nees_mean)).any(axis=0).astype(float)
            found["fewest"] = np.broadcast_to(estimates.sample[0], lawful.shape).min(axis=0)
        if "ess" in estimates.notes:
            # Steps with readings, because weights differ only after those; all steps if there are none.
            read = scores.measured > 0 if scores.measured.any() else np.ones(scores.nees.shape, dtype=bool)
            found["ess"] = mean(np.broadcast_to(estimates.notes["ess"], read.shape), read, 0)
        return found

    def _sum(self, scores: Scores, estimates: Estimates) -> None:
        scored = scores.scored
        lawful = np.isfinite(scores.nees) & np.isfinite(scores.nees_mean)
        squares = scores.error**2
        self.sums = {
            "scored": count(scored, -1),
            "error": total(scores.error, scored, -1),
            "square": total(squares, scored, -1),
            "quartic": total(squares**2, scored, -1),
            "sigma": total(scores.sigma, scored, -1),
            "inside": count(scores.inside(3), -1),
            "nees": total(scores.nees, np.isfinite(scores.nees), -1),
            "nees_runs": count(np.isfinite(scores.nees), -1),
            "law_runs": count(lawful, -1),
            "law_mean": total(scores.nees_mean, lawful, -1),
            "law_variance": total(scores.nees_variance, lawful, -1),
            "nis": scores.nis.sum(axis=-1),
            "nis_mean": scores.nis_mean.sum(axis=-1),
            "measured": scores.measured.sum(axis=-1),
            "nis_runs": count(scores.measured > 0, -1),
        }
        shape = scores.nees.shape
        self.sums |= {
            f"note_{name}": np.broadcast_to(values, shape).sum(axis=-1) for name, values in estimates.notes.items()
        }

    def _take_moments(self, **values: Array) -> None:
        """Add single numbers (*shape), each entry of the shape separately."""
        self.moments |= {name: SampleMoments.of(array[None]) for name, array in values.items()}

    def _count_diverged(self, scores: Scores, numbers: Sequence[int]) -> None:
        for cause in CAUSES:
            which = np.flatnonzero(getattr(scores, cause))
            self.diverged[cause] = which.size
            self.diverged_first[cause] = [numbers[i] for i in which[:_NAMED]]

    def _keep_first(self, scores: Scores, numbers: Sequence[int]) -> None:
        """Keep errors and NEES of those among these runs that belong to the ensemble's first."""
        room = max(0, self.begin + self._most - numbers[0])
        self.first = scores.error[..., :room].copy(), scores.nees[:, :room].copy()

    @property
    def _most(self) -> int:
        """How many runs' errors to keep."""
        return max(1, min(_SAMPLE_RUNS, _SAMPLE_BYTES // (8 * self.space.size * self.time.size)))


def _median(values: Array) -> Array:
    """Median over time, axis -2, without NaN; NaN if nothing is left."""
    ordered = np.sort(values, axis=-2)
    count = np.isfinite(values).sum(axis=-2, keepdims=True)
    low, high = np.maximum((count - 1) // 2, 0), np.minimum(count // 2, values.shape[-2] - 1)
    middle = [np.take_along_axis(ordered, at, axis=-2)[..., 0, :] for at in (low, high)]
    return np.where(count[..., 0, :] > 0, 0.5 * (middle[0] + middle[1]), np.nan)
