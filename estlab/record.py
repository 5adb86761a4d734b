"""Truth and readings on one time line, and a filter's estimates from them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from estlab.earlier_names import renamed
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Array
from estlab.maths.streams import Streams
from estlab.maths.uniform import Uniform

SMOOTHED = "_smoothed"  # ends the name of a filter's smoothed estimates


@renamed(target="landmark_number")
@dataclass(frozen=True)
class Readings:
    """Readings in the order of time.

    step: (N,) the step at which each is taken, ascending; several may share one. values: (m, N, runs), NaN where a
    run has none. landmark_number: (N, runs), the landmark that each is about, 0 if there are none.
    """

    step: Array
    values: Array
    landmark_number: Array

    def bounds(self, steps: int) -> Array:
        """Readings bounds[k] to bounds[k + 1] are taken at step k; (steps + 1,)."""
        return np.concatenate([[0], np.cumsum(np.bincount(self.step, minlength=steps)[:steps])])


@renamed(places="landmarks", shown="extra")
@dataclass(frozen=True)
class Record:
    """An ensemble of runs on one time line.

    start: the time of the prior [s]. time: (T,) [s], ascending from start. truth: (n, T, runs), NaN where unknown.
    control: (c, T, runs or 1), the command over the step that ends at time k. prior: the belief at start, a Gaussian
    with mean (n, runs) and cov (n, n), or uniform. files: those that were read.
    remarks: for a reader of the results.
    landmarks: (p, number of landmarks), what readings may be about. raw: the source of the first run's readings.
    extra: further arrays for a problem's own pictures, stored in the run directory.
    repeated: whether all runs share one truth and one set of readings, so that they are repeats, not independent.
    sums: arrays summed over the runs, for a problem's own table; added over blocks, and stored with the extra ones.
    origin: the truth (n, runs) at start if errors have a bound (estlab.metrics.bound): truth and readings are drawn
    from the scenario's own motion and sensor with the truth's noises, and the prior is a Gaussian that contains all
    that is known of the start. Otherwise None.
    """

    start: float
    time: Array
    truth: Array
    control: Array
    readings: Readings
    prior: Gaussian | Uniform
    files: tuple[Path, ...] = ()
    remarks: tuple[str, ...] = ()
    landmarks: Array = field(default_factory=lambda: np.empty((0, 1)))
    raw: dict[str, Array] = field(default_factory=dict)
    extra: dict[str, Array] = field(default_factory=dict)
    repeated: bool = False
    sums: dict[str, Array] = field(default_factory=dict)
    origin: Array | None = None

    @property
    def runs(self) -> int:
        return int(self.readings.values.shape[2])

    def thinned(self, share: float, streams: Streams, runs: Sequence[int]) -> "Record":
        """The record with this share of each run's readings lost at random; repeats of one recording lose the same.

        runs: the numbers of its runs, whose streams decide.
        """
        values = self.readings.values.copy()
        for i, generator in enumerate(streams.generators("lost", [0] * len(runs) if self.repeated else runs)):
            # A share of the run's own readings, so that other runs of its block do not matter.
            had = np.flatnonzero(np.isfinite(values[:, :, i]).any(axis=0))
            values[:, had[generator.random(had.size) < share], i] = np.nan
        return replace(self, readings=replace(self.readings, values=values))

    @property
    def each_its_own(self) -> bool:
        """Whether each run has its own belief; otherwise all share one, with the same prior and no readings."""
        return isinstance(self.prior, Uniform) or self.prior.mean.shape[1] == self.runs

    def first(self, steps: int | None) -> "Record":
        """The record up to this many steps."""
        if steps is None or steps >= self.time.size:
            return self
        kept = int(np.searchsorted(self.readings.step, steps))
        readings = Readings(
            self.readings.step[:kept], self.readings.values[:, :kept], self.readings.landmark_number[:kept]
        )
        return replace(
            self,
            time=self.time[:steps],
            truth=self.truth[:, :steps],
            control=self.control[:, :steps],
            readings=readings,
        )


@dataclass(frozen=True)
class Estimates:
    """A filter's belief after each step, and the innovations of the readings.

    mean: (n, T, runs). cov: (n, n, T, runs). whitened: (m, N, runs), the innovation of each of the record's readings,
    whitened, and log_scale the logarithms of the scales it was divided by, as in estlab.filters.filter.Innovation;
    NaN where nothing was measured or used. sample: (2, T, runs), the number of states behind each sample covariance
    and its factor to the unbiased one; None if it is not sampled.
    notes: further numbers (T, runs) by name: readings gated, effective sample size, ...
    gate: the share of correct readings that pass, None for all.
    cloud: for a belief that is a cloud of points, a sample of it in the first runs at some steps: step (K,), points
    (n, K, S, runs) and weights (K, S, runs). Otherwise empty.
    """

    mean: Array
    cov: Array
    whitened: Array
    log_scale: Array
    sample: Array | None
    notes: dict[str, Array]
    gate: float | None = None
    cloud: dict[str, Array] = field(default_factory=dict)
