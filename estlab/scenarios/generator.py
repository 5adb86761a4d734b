"""Gaussian vectors from standard normal ones, x = A z + b with A A' = P. Seed document 000, problem I.

One step without readings: the prior is the standard normal z, and the motion is the generator. In addition to its
truth, each run draws many vectors and follows the errors of their mean and covariance as their number grows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from estlab.maths.gaussian_belief import Gaussian, draw
from estlab.maths.linalg import cholesky, gram
from estlab.maths.space import Array, Space
from estlab.maths.stacking import Components, Rows
from estlab.maths.streams import Generators, Streams
from estlab.models.contract import Motion, Sensor
from estlab.record import Record
from estlab.scenarios import simulation
from estlab.scenarios.scenario import History, Scales, Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_AT_ONCE = 1_000_000  # vectors in memory, over all runs
_STEPS = (1, 2, 5)  # in each decade, numbers at which errors are evaluated


@dataclass(frozen=True)
class Generator(Scenario):
    """Samples of a Gaussian with given mean and covariance, with any number of components."""

    mean: list[float]
    cov: list[list[float]]
    samples: int

    def __post_init__(self) -> None:
        n = len(self.mean)
        if n == 0:
            raise ValueError("mean must have at least one number")
        if [len(row) for row in self.cov] != [n] * n:
            raise ValueError(f"cov must have {n} rows of {n} numbers, because mean has {n}")
        cov = np.array(self.cov)
        if (cov != cov.T).any() or np.isnan(cholesky(cov)).any():
            raise ValueError("cov must be symmetric and positive definite")
        if self.samples < 10:
            raise ValueError(f"samples must be >= 10, got {self.samples}")

    @property
    def space(self) -> Space:
        n = len(self.mean)
        return Space(tuple(f"x{i + 1}" for i in range(n)), ("1",) * n)

    @property
    def sizes(self) -> Array:
        """Sample sizes at which errors are evaluated: 10, 20, 50, 100, ... and the last."""
        decades = range(1, len(str(self.samples)))
        steps = [step * 10**decade for decade in decades for step in _STEPS if step * 10**decade < self.samples]
        return np.array([*steps, self.samples])

    def motion(self, noise: Scales) -> Motion:
        simulation.refuse_scales(noise, "set scenario.cov")
        return Motion(self.space, self._generate, simulation.no_cov, 0, self._jacobians)

    def sensor(self, noise: Scales, landmarks: Array) -> Sensor:
        return simulation.no_sensor(self.space)

    def simulate(self, streams: Streams, runs: Sequence[int], noise: Scales) -> Record:
        n = len(self.mean)
        standard = Gaussian(np.zeros((n, 1)), np.eye(n))
        record = simulation.one_prediction(streams, runs, self.motion(noise), standard)
        of_mean, of_cov = self._errors(streams.generators("samples", runs), len(runs))
        sums = {
            "count": np.array(len(runs)),
            "mean_error2": (of_mean**2).sum(axis=(0, 2)),
            "cov_error2": (of_cov**2).sum(axis=(0, 1, 3)),
        }
        first = {
            "mean": np.array(self.mean)[:, None] + of_mean[:, :, 0],
            "cov": np.array(self.cov)[:, :, None] + of_cov[:, :, :, 0],
        }
        return replace(record, sums=sums, extra=first)

    def table(self, histories: dict[str, History]) -> dict[str, list[Any]]:
        """Mean and covariance of the first run's samples at each decade, beside the exact values; and the root mean
        square distances from b and P over the runs, beside their expectations.
        """
        extra = next(iter(histories.values())).extra
        entries = list(zip(*np.triu_indices(len(self.mean)), strict=True))
        names = [*(f"mean {name}" for name in self.space.names), *(f"P{i + 1}{j + 1}" for i, j in entries)]
        names += ["|m - b|", "|m - b| expected", "|S - P|", "|S - P| expected"]

        def column(mean: Array, cov: Array, off: Array) -> list[float]:
            return [float(f"{number:.4g}") for number in (*mean, *(cov[entry] for entry in entries), *off)]

        off = np.stack([*self._off(extra), *self.expected()])[[0, 2, 1, 3]]
        columns = {
            str(size): column(extra["mean"][:, k], extra["cov"][:, :, k], off[:, k])
            for k, size in enumerate(self.sizes)
            if np.log10(size).is_integer() or k + 1 == self.sizes.size
        }
        return {"samples": names, **columns, "true": column(np.array(self.mean), np.array(self.cov), np.zeros(4))}

    def pictures(self, histories: dict[str, History]) -> "dict[str, Figure]":
        from matplotlib.figure import Figure

        extra = next(iter(histories.values())).extra
        runs = int(extra["count"])
        figure = Figure(figsize=(9.0, 5.4), layout="constrained")
        axes = figure.add_subplot()
        kinds = (("mean", "C0", "o"), ("covariance", "C3", "s"))
        for (what, colour, marker), found, expected in zip(kinds, self._off(extra), self.expected(), strict=True):
            axes.loglog(self.sizes, expected, color=colour, lw=1.2, label=f"{what}, expected")
            axes.loglog(self.sizes, found, marker, color=colour, ms=6, mfc="white", label=f"{what}, RMS of {runs} runs")
        axes.set_xlabel("samples n")
        axes.set_ylabel("distance from b and from P (norm of the difference)")
        axes.grid(alpha=0.3, which="both")
        axes.set_title("Gaussian vectors x = A z + b: errors of mean and covariance fall like n^(-1/2)")
        axes.legend(frameon=False)
        return {"convergence.png": figure}

    def expected(self) -> tuple[Array, Array]:
        """Root mean squares of the two errors for exact Gaussian vectors, at each of the sizes.

        E|m - b|^2 = tr P / n, and for the unbiased sample covariance S, E|S - P|^2 = (tr(P)^2 + tr(P^2)) / (n - 1), the
        sum over i, j of the Wishart variances (P_ij^2 + P_ii P_jj) / (n - 1).
        """
        cov = np.array(self.cov)
        return np.sqrt(np.trace(cov) / self.sizes), np.sqrt((np.trace(cov) ** 2 + (cov**2).sum()) / (self.sizes - 1))

    def _off(self, extra: dict[str, Array]) -> tuple[Array, Array]:
        """Root mean squares over the runs of the distances of mean and covariance, at each of the sizes."""
        return np.sqrt(extra["mean_error2"] / extra["count"]), np.sqrt(extra["cov_error2"] / extra["count"])

    def _errors(self, generators: Generators, runs: int) -> tuple[Array, Array]:
        """Errors of the sample mean (n, sizes, runs) and of the sample covariance (n, n, sizes, runs)."""
        n, sizes = len(self.mean), self.sizes
        centre, target = np.array(self.mean), np.array(self.cov)
        belief = Gaussian(centre[:, None, None], target)
        first, second = np.zeros((n, runs)), np.zeros((n, n, runs))
        of_mean, of_cov = np.empty((n, sizes.size, runs)), np.empty((n, n, sizes.size, runs))
        drawn = 0
        for k, size in enumerate(sizes):
            while drawn < size:
                count = min(size - drawn, max(1, _AT_ONCE // runs))
                # One vector after another, so that the vectors do not depend on how many are drawn at once.
                z = np.swapaxes(generators.normals((count, n)), 0, 1)
                # Sums are taken about b: the sample covariance does not depend on it, and a large mean costs no
                # digits.
                off = draw(self.space, belief, z) - belief.mean
                first, second = first + off.sum(axis=1), second + gram(off)
                drawn += count
            shift = first / size
            of_mean[:, k] = shift
            of_cov[:, :, k] = (second - size * gram(shift[:, None])) / (size - 1) - target[..., None]
        return of_mean, of_cov

    @cached_property
    def _root(self) -> Array:
        return cholesky(np.array(self.cov))

    def _generate(self, state: Array, control: Array, noise: Array, dt: float) -> Components:
        """x = A z + b, component by component."""
        return tuple(
            b + sum(a * z for a, z in zip(row, state, strict=True))
            for b, row in zip(self.mean, self._root, strict=True)
        )

    def _jacobians(self, state: Array, control: Array, dt: float) -> tuple[Rows, Rows]:
        return tuple(tuple(row) for row in self._root), ((),) * len(self.mean)
