"""The particle filter with its work on whole clouds compiled: drawn, moved, weighed, summed and chosen."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from estlab.compiled.particle_routines import EIGHT, Entries
from estlab.filters.particle import ParticleFilter, Particles, whitening_of
from estlab.filters.particle_code import ParticleCode
from estlab.filters.step import Step
from estlab.maths import cloud
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.linalg import cholesky
from estlab.maths.resampling import Weights
from estlab.maths.space import Array, Space
from estlab.maths.streams import Generators
from estlab.models.contract import Motion, Sensor


@dataclass(frozen=True)
class CompiledParticleFilter(ParticleFilter):
    """The same filter to the same numbers but for rounding; its generators are CompiledGenerators."""

    code: ParticleCode

    @classmethod
    def of(cls, filter: ParticleFilter, code: ParticleCode) -> "CompiledParticleFilter":
        """A filter, compiled."""
        return cls(**{field.name: getattr(filter, field.name) for field in fields(filter)}, code=code)

    def predict(self, motion: Motion, belief: Particles, control: Array, dt: float) -> Particles:
        few = np.flatnonzero(belief.weights.size < self.threshold * self.particles)
        if few.size == 0 or not self._plain:
            return super().predict(motion, belief, control, dt)
        # Chosen in the pass that moves them. The weights are this belief's own, and are made even in their place.
        nth = np.full(belief.fresh.size, -1)
        nth[few] = np.arange(few.size)
        old = belief.weights
        log, weight, size, vanished = _flat(old.log), _flat(old.linear), old.size.copy(), old.vanished.copy()
        size[few], vanished[few] = self.particles, False
        choice = self._choice(belief.generators.take(few), drawn=self.resampling == "multinomial")
        points, step = self._drawn(
            motion, belief.points, control, dt, belief.generators, **choice, nth_few=nth, log=log, weight=weight
        )
        return self._after(belief._replace(points=points, weights=Weights(log.T, weight.T, size, vanished)), step)

    @property
    def _plain(self) -> bool:
        """Whether particles that are chosen stay as they are, and which they were is not asked."""
        changed = self.roughening > 0.0 or self.bandwidth > 0.0 or self.injection > 0.0
        return not changed and self.resampling != "residual" and self.ancestors == "bootstrap"

    def _drawn(
        self, motion: Motion, points: Array, control: Array, dt: float, generators: Generators, **choice: Any
    ) -> tuple[Array, Step]:
        factor = cholesky(motion.noise_cov(control, dt))
        (_, count, runs), q = points.shape, motion.noise_size
        if self.ancestors == "auxiliary":  # which wants the noise once more
            z = np.empty((runs, q, count))
        else:
            z = self.code.room("z", q * count).reshape(1, q, count)
        factor = factor if factor.ndim > 2 else factor[..., None]
        step = Step(motion, points, control, factor, z.transpose(1, 2, 0), dt)
        return self._stepped(step, z, generators, DRAWN=1, **choice), step

    def _moved(self, step: Step, generators: Generators) -> Array:
        return self._stepped(step, _by_runs(step.z), generators, DRAWN=0)

    def _stepped(self, step: Step, z: Array, generators: Any, **given: Any) -> Array:
        (n, count, runs), code = step.before.shape, self.code
        common = code.common(count, max(n, z.shape[1]), runs, generators)
        after, before = cloud.empty(n, count, runs), _flat(step.before)
        control, factor = _by_runs(step.control), _by_runs(step.factor)
        given.setdefault("nth_few", np.full(runs, -1))
        code.move(
            _entries(step.factor), len(step.control), **common, **given, z=z, Z_NEXT=_next(z), before=before,
            after=after, CLOUD_STRIDE=count * runs, LAPSE=float(step.dt), control=control, CONTROL_NEXT=_next(control),
            factor=factor, FACTOR_NEXT=_next(factor), chosen=code.address("chosen", count),
            gathered=code.address("gathered", n * count),
        )  # fmt: skip
        return after

    def _weighed(self, sensor: Sensor, belief: Particles, reading: Array, landmark: Array) -> tuple[Weights, Gaussian]:
        return self._held(sensor, belief, reading, landmark, normalised=True)

    def _looked(self, sensor: Sensor, belief: Particles, reading: Array, landmark: Array) -> tuple[Array, Gaussian]:
        weights, expected = self._held(sensor, belief, reading, landmark, normalised=False)
        return weights.log, expected

    def _held(
        self, sensor: Sensor, belief: Particles, reading: Array, landmark: Array, normalised: bool
    ) -> tuple[Weights, Gaussian]:
        (n, count, runs), m = belief.points.shape, sensor.space.size
        generators: Any = belief.generators
        mean, cov = np.empty((runs, m)), np.empty((runs, m, m))
        found, padded, point = _Weights(count, runs), -(-count // EIGHT) * EIGHT, _flat(belief.points)
        matrix = whitening_of(sensor, reading)
        reading, whitening, landmarks = (
            _by_runs(reading),
            _by_runs(matrix),
            np.ascontiguousarray(landmark.T, dtype=float),
        )
        before, linear = _flat(belief.weights.log), _flat(belief.weights.linear)
        self.code.weigh(
            _entries(matrix), m // self.code.sensor.space.size, **self.code.common(count, max(n, m), runs, generators),
            **found.fields, NORMALISED=int(normalised), point=point,
            CLOUD_STRIDE=count * runs, log_before=before, weight=linear, reading=reading,
            whitening=whitening, WHITENING_NEXT=_next(whitening), landmark=landmarks, LANDMARK_NEXT=_next(landmarks),
            expected=self.code.address("expected", m * padded), EXPECTED_STRIDE=padded, mean=mean, cov=cov,
        )  # fmt: skip
        return found.weights(), Gaussian(mean.T, cov.transpose(1, 2, 0))

    def _weights(self, logs: Array) -> Weights:
        found = _Weights(*logs.shape)
        found.fields["log"] = _flat(logs)
        count, runs = logs.shape
        self.code.normalise(**self.code.common(count, 1, runs, None), **found.fields)
        return found.weights()

    def _moments(self, space: Space, points: Array, weights: Array, generators: Any) -> Gaussian:
        n, count, runs = points.shape
        mean, cov, vector, weight = np.empty((runs, n)), np.empty((runs, n, n)), _flat(points), _flat(weights)
        self.code.sum(
            **self.code.common(count, n + len(space.angles), runs, generators), vector=vector,
            CLOUD_STRIDE=count * runs, weight=weight, mean=mean, cov=cov,
        )  # fmt: skip
        return Gaussian(mean.T, cov.transpose(1, 2, 0))

    def _chosen(self, weights: Array, generators: Generators) -> Array:
        if self.resampling == "residual":
            return super()._chosen(weights, generators)
        (count, runs), weight, code = weights.shape, _flat(weights), self.code
        chosen, choice = np.empty((runs, count), dtype=np.int64), self._choice(generators, drawn=True)
        code.choose(**code.common(count, 0, runs, None), **choice, weight=weight, chosen=chosen)
        return chosen.T

    def _choice(self, generators: Generators, drawn: bool) -> dict[str, Any]:
        """The uniform numbers of resampling, drawn here or to be drawn, and how positions come of them."""
        count = self.particles
        numbers = 1 if self.resampling == "systematic" else count
        strata = np.array([0.0, 1.0] if self.resampling == "multinomial" else [1.0, count])
        u: Array | int = self.code.address("u", numbers)
        if drawn:
            u = _flat(generators.uniforms((numbers,)))
            u = np.sort(u) if self.resampling == "multinomial" else u
        return {
            "u": u, "U_NEXT": numbers if drawn else 0, "U_STRIDE": int(numbers > 1), "U_DRAWN": 0 if drawn else numbers,
            "strata": strata,
        }  # fmt: skip


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
    axes = range(values.ndim - 1)
    return np.ascontiguousarray(values.transpose(values.ndim - 1, *axes), dtype=float)


def _next(values: Array) -> int:
    """How far it is from one run's values to the next one's: nothing where they share them."""
    return 0 if len(values) == 1 else values[0].size


def _entries(matrix: Array) -> Entries:
    """Which entries of a matrix (q, q, runs or 1) are not zero in all runs, NaN being none."""
    return tuple(zip(*(part.tolist() for part in np.nonzero((matrix != 0.0).any(axis=-1))), strict=True))
