"""The particle filter with its work on whole clouds compiled: drawn, moved, weighed, summed and chosen."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from estlab.compiled import numpy_streams
from estlab.compiled.particle_pieces import EIGHT, Entries
from estlab.filters.particle import ParticleFilter, Particles, whitening_of
from estlab.filters.particle_code import ParticleCode
from estlab.filters.step import Step
from estlab.maths import cloud
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.linalg import cholesky
from estlab.maths.resampling import Weights, positions
from estlab.maths.space import Array, Space
from estlab.maths.streams import Draws
from estlab.models.contract import Motion, Sensor


@dataclass(frozen=True)
class CompiledParticleFilter(ParticleFilter):
    """The same filter to the same numbers but for rounding; its draws are CompiledDraws."""

    code: ParticleCode

    @classmethod
    def of(cls, filter: ParticleFilter, code: ParticleCode) -> "CompiledParticleFilter":
        """A filter, compiled."""
        return cls(**{field.name: getattr(filter, field.name) for field in fields(filter)}, code=code)

    def _drawn(self, motion: Motion, points: Array, control: Array, dt: float, draws: Draws) -> tuple[Array, Step]:
        factor = cholesky(motion.noise_cov(control, dt))
        (_, count, runs), q = points.shape, motion.noise_size
        if self.ancestors == "auxiliary":  # which wants the noise once more
            z = np.empty((runs, q, count))
        else:
            z = self.code.room("z", q * count).reshape(1, q, count)
        factor = factor if factor.ndim > 2 else factor[..., None]
        step = Step(motion, points, control, factor, np.moveaxis(z, 0, -1), dt)
        return self._after(step, z, draws, drawn=True), step

    def _moved(self, step: Step, draws: Draws) -> Array:
        return self._after(step, _by_runs(step.z), draws, drawn=False)

    def _after(self, step: Step, z: Array, draws: Any, drawn: bool) -> Array:
        n, count, runs = step.before.shape
        after, before = cloud.empty(n, count, runs), _flat(step.before)
        control, factor = _by_runs(step.control), _by_runs(step.factor)
        self.code.move(
            _entries(step.factor), len(step.control), **self.code.common(count, max(n, z.shape[1]), draws, runs),
            DRAWN=int(drawn), state=draws.state, layers=numpy_streams.layers(), z=z, Z_NEXT=_next(z),
            before=before, after=after, CLOUD_STRIDE=count * runs, lapse=np.array([step.dt]),
            control=control, CONTROL_NEXT=_next(control), factor=factor, FACTOR_NEXT=_next(factor),
        )  # fmt: skip
        return after

    def _weighed(self, sensor: Sensor, belief: Particles, reading: Array, place: Array) -> tuple[Weights, Gaussian]:
        return self._held(sensor, belief, reading, place, normalised=True)

    def _looked(self, sensor: Sensor, belief: Particles, reading: Array, place: Array) -> tuple[Array, Gaussian]:
        weights, expected = self._held(sensor, belief, reading, place, normalised=False)
        return weights.log, expected

    def _held(
        self, sensor: Sensor, belief: Particles, reading: Array, place: Array, normalised: bool
    ) -> tuple[Weights, Gaussian]:
        (n, count, runs), m = belief.points.shape, sensor.space.size
        draws: Any = belief.draws
        mean, cov = np.empty((runs, m)), np.empty((runs, m, m))
        found, padded, point = _Weights(count, runs), -(-count // EIGHT) * EIGHT, _flat(belief.points)
        matrix = whitening_of(sensor, reading)
        reading, whitening, places = _by_runs(reading), _by_runs(matrix), _by_runs(place)
        before, linear = _flat(belief.weights.log), _flat(belief.weights.linear)
        self.code.weigh(
            _entries(matrix), m // self.code.sensor.space.size, **self.code.common(count, max(n, m), draws, runs),
            **found.fields, few=self.code.room("few", 2), NORMALISED=int(normalised), point=point,
            CLOUD_STRIDE=count * runs, log_before=before, weight=linear, reading=reading,
            whitening=whitening, WHITENING_NEXT=_next(whitening), place=places, PLACE_NEXT=_next(places),
            expected=self.code.room("expected", m * padded), EXPECTED_STRIDE=padded, mean=mean, cov=cov,
        )  # fmt: skip
        return found.weights(), Gaussian(np.moveaxis(mean, 0, -1), np.moveaxis(cov, 0, -1))

    def _weights(self, logs: Array) -> Weights:
        found = _Weights(*logs.shape)
        found.fields["log"] = _flat(logs)
        common = self.code.common(*logs.shape[:1], 1, None, logs.shape[1])
        self.code.normalise(**common, **found.fields, few=self.code.room("few", 2))
        return found.weights()

    def _moments(self, space: Space, points: Array, weights: Array, draws: Any) -> Gaussian:
        n, count, runs = points.shape
        mean, cov, vector, weight = np.empty((runs, n)), np.empty((runs, n, n)), _flat(points), _flat(weights)
        self.code.sum(
            **self.code.common(count, n + len(space.angles), draws, runs), vector=vector, CLOUD_STRIDE=count * runs,
            weight=weight, mean=mean, cov=cov,
        )  # fmt: skip
        return Gaussian(np.moveaxis(mean, 0, -1), np.moveaxis(cov, 0, -1))

    def _chosen(self, weights: Array, draws: Draws) -> Array:
        if self.resampling == "residual":
            return super()._chosen(weights, draws)
        count, runs = weights.shape
        position, weight = _flat(positions(self.resampling, count, draws)), _flat(weights)
        chosen = np.empty((runs, count), dtype=np.int64)
        self.code.choose(
            RUNS=runs, COUNT=count, weight=weight, position=position, edge=self.code.room("edge", count), chosen=chosen
        )
        return chosen.T


class _Weights:
    """Room for the weights that a program finds."""

    def __init__(self, count: int, runs: int) -> None:
        self.fields = {
            "log": np.empty((runs, count)), "linear": np.empty((runs, count)), "size": np.empty(runs),
            "vanished": np.empty(runs),
        }  # fmt: skip

    def weights(self) -> Weights:
        f = self.fields
        return Weights(f["log"].T, f["linear"].T, f["size"], f["vanished"] != 0.0)


def _flat(values: Array) -> Array:
    """Values (*shape, N, runs) as they lie in memory, each run's side by side."""
    return np.ascontiguousarray(np.swapaxes(values, -1, -2))


def _by_runs(values: Array) -> Array:
    """Values (*shape, runs or 1) with runs first."""
    return np.ascontiguousarray(np.moveaxis(values, -1, 0), dtype=float)


def _next(values: Array) -> int:
    """How far it is from one run's values to the next one's: nothing where they share them."""
    return 0 if len(values) == 1 else values[0].size


def _entries(matrix: Array) -> Entries:
    """Which entries of a matrix (q, q, runs or 1) are not zero in all runs, NaN being none."""
    return tuple(zip(*(part.tolist() for part in np.nonzero((matrix != 0.0).any(axis=-1))), strict=True))
