"""Sums over runs and over time, block by block, from which every table is made.

What is kept does not grow with the runs but for a few numbers a run.
"""

from dataclasses import dataclass, field

import numpy as np

from estlab.maths.linalg import cholesky, solve_lower
from estlab.maths.space import Array, Space
from estlab.metrics.intervals import Estimate, chi_square_band, mean_interval, positive_interval, share_interval
from estlab.record import Estimates, Record

Columns = dict[str, Array]

# On its way to NaN a run that diverges has errors too large to square and variances below zero: no warning's worth.
_quietly = np.errstate(invalid="ignore", over="ignore", divide="ignore")


@dataclass
class Tally:
    """Errors and consistency of one filter over an ensemble.

    Only what is finite is scored: a gap in the truth or a diverged run takes no part in a mean, and every figure
    has beside it how much it is made of.
    """

    space: Space
    time: Array
    found_within: float | None = None
    repeated: bool = False
    sums: dict[str, Array] = field(default_factory=dict)
    per_run: dict[str, list[Array]] = field(default_factory=dict)

    @_quietly
    def add(self, record: Record, estimates: Estimates) -> None:
        """Take in a block of runs."""
        error = self.space.minus(estimates.mean, record.truth)
        sigma = np.sqrt(estimates.cov[range(self.space.size), range(self.space.size)])
        factor = cholesky(estimates.cov)
        whitened = solve_lower(factor, error[:, None])[:, 0]
        nees = np.einsum("i...,i...->...", whitened, whitened)
        # Not finite, or not positive definite: such a belief is none.
        definite = (np.einsum("ii...->i...", factor) > 0.0).all(0)
        broken = ~(definite & np.isfinite(estimates.mean).all(0))
        scored = np.isfinite(error) & np.isfinite(sigma)
        inside = scored & (np.abs(error) <= 3.0 * sigma)
        whole = np.isfinite(nees)
        lapse = np.diff(record.time, prepend=record.start)
        lapse = (lapse / lapse.sum() if lapse.sum() > 0.0 else np.full(lapse.size, 1.0 / lapse.size))[:, None]
        fitted = np.isfinite(estimates.nis)
        size = np.where(fitted, estimates.nis_size, 0)
        self._add_sums(
            scored=scored.sum(-1),
            error=_total(error, scored, -1),
            square=_total(error**2, scored, -1),
            sigma=_total(sigma, scored, -1),
            inside=inside.sum(-1),
            nees=_total(nees, whole, -1),
            nees_runs=whole.sum(-1),
            nis=_total(estimates.nis, fitted, -1),
            nis_size=size.sum(-1),
            nis_runs=(size > 0).sum(-1),
        )
        self._add_sums(**{f"note_{name}": values.sum(-1) for name, values in estimates.notes.items()})
        if "ess" in estimates.notes:
            # Of the steps with readings, after which alone weights differ; of all where there are none.
            read = size > 0 if size.any() else np.ones(size.shape, dtype=bool)
            self._add_runs(ess=_ratio(_total(estimates.notes["ess"], read, 0), read.sum(0)))
        count = scored.sum(1)
        self._add_runs(
            mean_square=_ratio(_total(error**2, scored, 1), count),
            mean_error=_ratio(_total(error, scored, 1), count),
            median_abs_error=_median(np.where(scored, np.abs(error), np.nan)),
            mean_sigma=_ratio(_total(sigma, scored, 1), count),
            inside_3sigma=_ratio(inside.sum(1), count),
            scored=(lapse * scored).sum(1),
            anees=_ratio(_total(nees, whole, 0), whole.sum(0) * self.space.size),
            nees_scored=(lapse * whole).sum(0),
            anis=_ratio(_total(estimates.nis, fitted, 0), size.sum(0)),
            diverged=np.broadcast_to(broken.any(0), whole.shape[1:]),
        )
        if self.space.position:
            at = list(self.space.position)
            distance2 = np.where(scored[at].all(0), (error[at] ** 2).sum(0), np.nan)
            known = np.isfinite(distance2)
            self._add_runs(
                position_square=_ratio(_total(distance2, known, 0), known.sum(0)),
                position_median=_median(np.sqrt(distance2)),
                position_scored=(lapse * known).sum(0),
            )
            if self.found_within is not None:
                self._add_runs(found_time=self._found_time(np.sqrt(distance2)))

    def _found_time(self, distance: Array) -> Array:
        """(runs,) the time from which the position error stays within bounds; NaN for a run that ends outside."""
        outside = ~(distance <= self.found_within)
        last = np.where(outside.any(0), outside.shape[0] - 1 - outside[::-1].argmax(0), -1)
        after = np.minimum(last + 1, self.time.size - 1)
        return np.where(last == self.time.size - 1, np.nan, self.time[after])

    @property
    def diverged(self) -> Array:
        """(runs,) which runs diverged."""
        return self._runs("diverged")

    @_quietly
    def errors(self, first: tuple[Array, Array, Array]) -> Columns:
        """One row per time and component: a run's truth (n, T), mean (n, T) and cov (n, n, T), and the ensemble."""
        truth, mean, cov = first
        n, steps = self.space.size, self.time.size
        error = self.space.minus(mean, truth)
        sigma = np.sqrt(cov[range(n), range(n)])
        count = self.sums["scored"]
        grids = {
            "truth": truth,
            "estimate": mean,
            "error": error,
            "sigma": sigma,
            "lower3": -3.0 * sigma,
            "upper3": 3.0 * sigma,
            "mean_error": _ratio(self.sums["error"], count),
            "rmse": np.sqrt(_ratio(self.sums["square"], count)),
            "mean_sigma": _ratio(self.sums["sigma"], count),
            "inside_3sigma": _ratio(self.sums["inside"], count),
            "runs_scored": count,
        }
        return {
            "time": np.repeat(self.time, n),
            "component": np.tile(self.space.names, steps),
            "unit": np.tile(self.space.units, steps),
            **{name: grid.T.ravel() for name, grid in grids.items()},
        }

    def nees(self) -> Columns:
        """NEES over n and over the runs at each time: 1 for a consistent filter; with its 95 % band."""
        runs = self.sums["nees_runs"]
        lower, upper = chi_square_band(self._independent(runs) * self.space.size)
        return {
            "time": self.time,
            "anees": _ratio(self.sums["nees"], runs * self.space.size),
            "lower": lower,
            "upper": upper,
            "runs_scored": runs,
        }

    def nis(self) -> Columns:
        """NIS over the numbers measured, at each time with a reading; 1 for a consistent filter; with its 95 % band."""
        measured = self.sums["nis_size"] > 0
        size, runs = self.sums["nis_size"][measured], self.sums["nis_runs"][measured]
        lower, upper = chi_square_band(size * self._independent(runs) / np.maximum(runs, 1))
        return {
            "time": self.time[measured],
            "anis": self.sums["nis"][measured] / size,
            "lower": lower,
            "upper": upper,
            "degrees_of_freedom": size,
            "runs_scored": runs,
        }

    def notes(self) -> Columns:
        """What a filter noted of each step, averaged over runs; only what it noted at least once."""
        runs = self.diverged.size
        found = {name[5:]: values / runs for name, values in self.sums.items() if name[:5] == "note_" and values.any()}
        count = self.time.size
        return {
            "time": np.tile(self.time, len(found)),
            "note": np.repeat(list(found), count) if found else np.empty(0),
            "mean": np.concatenate(list(found.values())) if found else np.empty(0),
        }

    def _independent(self, runs: Array) -> Array:
        """How many of the runs count for a band: repeats of one recording are worth one."""
        return np.minimum(runs, 1) if self.repeated else runs

    @_quietly
    def metrics(self) -> list[dict[str, object]]:
        """Tidy rows of metric, component, unit, value, ci_low, ci_high, n: means over runs with a 95 % interval."""
        rows: list[dict[str, object]] = []

        def row(metric: str, component: str, unit: str, estimate: Estimate) -> None:
            low, high = (np.nan, np.nan) if self.repeated else (estimate.low, estimate.high)
            rows.append(
                {
                    "metric": metric,
                    "component": component,
                    "unit": unit,
                    "value": estimate.value,
                    "ci_low": low,
                    "ci_high": high,
                    "n": estimate.n,
                }
            )

        for metric in ("rmse", "median_abs_error", "mean_error", "mean_sigma", "inside_3sigma", "scored"):
            share = metric in ("inside_3sigma", "scored")
            for name, unit, values in zip(
                self.space.names,
                self.space.units,
                self._runs("mean_square" if metric == "rmse" else metric),
                strict=True,
            ):
                found = positive_interval(values) if metric == "rmse" else mean_interval(values)
                finish = _root if metric == "rmse" else _share if share else _same
                row(metric, name, "" if share else unit, finish(found))
        if self.space.position:
            unit = self.space.units[self.space.position[0]]
            row("rmse", "position", unit, _root(positive_interval(self._runs("position_square"))))
            row("median_abs_error", "position", unit, mean_interval(self._runs("position_median")))
            row("scored", "position", "", _share(mean_interval(self._runs("position_scored"))))
        row("scored", "all", "", _share(mean_interval(self._runs("nees_scored"))))
        row("anees", "all", "", positive_interval(self._runs("anees")))
        if self.sums["nis_size"].any():
            row("anis", "all", "", positive_interval(self._runs("anis")))
        for name in ("gated", "vanished"):
            if f"note_{name}" in self.sums and self.sums[f"note_{name}"].any():
                total = int(self.sums[f"note_{name}"].sum())
                row(name, "all", "readings", Estimate(total, np.nan, np.nan, self.diverged.size))
        if "note_ess" in self.sums:
            row("ess", "all", "particles", mean_interval(self._runs("ess")))
        if self.found_within is not None:
            when = self._runs("found_time")
            row("found", "position", "", share_interval(np.isfinite(when)))
            row("found_time", "position", "s", mean_interval(when))
        row("diverged", "all", "runs", Estimate(int(self.diverged.sum()), np.nan, np.nan, self.diverged.size))
        return rows

    def _add_sums(self, **blocks: Array) -> None:
        for name, block in blocks.items():
            self.sums[name] = self.sums[name] + block if name in self.sums else block

    def _add_runs(self, **blocks: Array) -> None:
        for name, block in blocks.items():
            self.per_run.setdefault(name, []).append(block)

    def _runs(self, name: str) -> Array:
        return np.concatenate(self.per_run[name], axis=-1)


def _total(values: Array, where: Array, axis: int) -> Array:
    return np.asarray(np.sum(values, axis=axis, where=where))


def _ratio(total: Array, count: Array) -> Array:
    return total / np.where(count > 0, count, np.nan)


def _median(values: Array) -> Array:
    """Median over time, axis -2, of what is not NaN; NaN where nothing is."""
    ordered = np.sort(values, axis=-2)
    count = np.isfinite(values).sum(axis=-2, keepdims=True)
    low, high = np.maximum((count - 1) // 2, 0), np.minimum(count // 2, values.shape[-2] - 1)
    middle = [np.take_along_axis(ordered, at, axis=-2)[..., 0, :] for at in (low, high)]
    return np.where(count[..., 0, :] > 0, 0.5 * (middle[0] + middle[1]), np.nan)


def _same(estimate: Estimate) -> Estimate:
    return estimate


def _root(estimate: Estimate) -> Estimate:
    """The root of a mean square; its interval is the root of the mean square's."""
    value, low, high, n = estimate
    return Estimate(np.sqrt(value), np.sqrt(low), np.sqrt(high), n)


def _share(estimate: Estimate) -> Estimate:
    value, low, high, n = estimate
    value = min(value, 1.0)  # a sum of shares of time may be one and a last bit
    return Estimate(value, max(low, 0.0) if np.isfinite(low) else low, min(high, 1.0) if np.isfinite(high) else high, n)
