"""The particle filter with compiled work on whole clouds: draw, move, weigh, sum and select."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from estlab.compiled.particle_programs import NORMALISED, RESAMPLING
from estlab.compiled.particle_routines import EIGHT
from estlab.filters.filter import Innovation
from estlab.filters.particle import ParticleFilter, Particles
from estlab.filters.particle_code import ParticleCode, apart, by_runs, entries_of, flat
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
    """The same filter with the same results, except for rounding; its generators are CompiledGenerators."""

    code: ParticleCode

    @classmethod
    def of(cls, filter: ParticleFilter, code: ParticleCode) -> "CompiledParticleFilter":
        """A filter in compiled form."""
        return cls(**{field.name: getattr(filter, field.name) for field in fields(filter)}, code=code)

    def predict(self, motion: Motion, belief: Particles, control: Array, dt: float) -> Particles:
        few = np.flatnonzero(belief.weights.size < self.threshold * self.particles)
        if few.size == 0 or not self._plain:
            return super().predict(motion, belief, control, dt)
        # Selected in the pass that moves them. The weights belong to this belief, and are reset in place.
        nth = np.full(belief.fresh.size, -1)
        nth[few] = np.arange(few.size)
        old = belief.weights
        log, weight, size, vanished = flat(old.log), flat(old.linear), old.size.copy(), old.vanished.copy()
        size[few], vanished[few] = self.particles, False
        choice = self._choice(belief.generators.take(few) if self.resampling == "multinomial" else None)
        points, step = self._drawn(
            motion, belief.points, control, dt, belief.generators, **choice, nth_few=nth, log=log, weight=weight
        )
        return self._after(belief._replace(points=points, weights=Weights(log.T, weight.T, size, vanished)), step)

    @property
    def _plain(self) -> bool:
        """Whether selected particles stay unchanged, and their indices are not needed."""
        changed = self.roughening > 0.0 or self.bandwidth > 0.0 or self.injection > 0.0
        return not changed and self.resampling != "residual" and self.ancestors == "bootstrap"

    def _drawn(
        self, motion: Motion, points: Array, control: Array, dt: float, generators: Generators, **choice: Any
    ) -> tuple[Array, Step]:
        factor = cholesky(motion.noise_cov(control, dt))
        (_, count, runs), q = points.shape, motion.noise_size
        if self.ancestors == "auxiliary":  # which needs the noise once more
            z = np.empty((runs, q, count))
        else:
            z = self.code.room("z", q * count).reshape(1, q, count)
        factor = factor if factor.ndim > 2 else factor[..., None]
        step = Step(motion, points, control, factor, z.transpose(1, 2, 0), dt)
        return self._stepped(step, z, generators, DRAWN=1, **choice), step

    def _moved(self, step: Step, generators: Generators) -> Array:
        return self._stepped(step, by_runs(step.z), generators, DRAWN=0)

    def _stepped(self, step: Step, z: Array, generators: Any, **given: Any) -> Array:
        (n, count, runs), code = step.before.shape, self.code
        common = code.common(count, max(n, z.shape[1]), runs, generators)
        after, before = cloud.empty(n, count, runs), flat(step.before)
        control, factor = by_runs(step.control), by_runs(step.factor)
        given = dict.fromkeys(RESAMPLING, 0) | {"nth_few": np.full(runs, -1)} | given
        code.move(
            entries_of(step.factor), len(step.control), **common, **given, z=z, Z_NEXT=apart(z), before=before,
            after=after, CLOUD_STRIDE=count * runs, LAPSE=float(step.dt), control=control, CONTROL_NEXT=apart(control),
            factor=factor, FACTOR_NEXT=apart(factor), chosen=code.address("chosen", count),
            gathered=code.address("gathered", n * count),
        )  # fmt: skip
        return after

    def _weighed(
        self, sensor: Sensor, belief: Particles, reading: Array, landmark: Array
    ) -> tuple[Weights, Innovation]:
        m, (count, runs) = sensor.space.size, belief.weights.log.shape
        found, whitened, log_scale = _Weights(count, runs), np.empty((runs, m)), np.empty((runs, m))
        noise = np.ascontiguousarray(sensor.noise_cov, dtype=float)
        mean, cov = np.empty((runs, m)), np.empty((runs, m, m))
        self._look(
            sensor, belief, reading, landmark, **found.fields, NORMALISED=1, mean=mean, cov=cov, noise=noise,
            whitened=whitened, log_scale=log_scale,
        )  # fmt: skip
        return found.weights(), Innovation(whitened.T, log_scale.T, np.zeros(runs, dtype=bool))

    def _likelihood(self, sensor: Sensor, belief: Particles, reading: Array, landmark: Array) -> Array:
        logs = np.empty(belief.weights.log.shape[::-1])
        self._look(sensor, belief, reading, landmark, log=logs, NORMALISED=0, **dict.fromkeys(NORMALISED, 0))
        return logs.T

    def _look(self, sensor: Sensor, belief: Particles, reading: Array, landmark: Array, **found: Any) -> None:
        (n, count, runs), m, code = belief.points.shape, sensor.space.size, self.code
        generators: Any = belief.generators
        padded, point = -(-count // EIGHT) * EIGHT, flat(belief.points)
        entries, whitening = code.whitening(sensor, reading)
        landmarks = np.ascontiguousarray(landmark.T, dtype=float)
        reading, log_before, weight = by_runs(reading), flat(belief.weights.log), flat(belief.weights.linear)
        code.weigh(
            entries, m // code.sensor.space.size, **code.common(count, max(n, m), runs, generators), **found,
            point=point, CLOUD_STRIDE=count * runs, log_before=log_before, weight=weight, reading=reading,
            whitening=whitening, WHITENING_NEXT=apart(whitening), landmark=landmarks, LANDMARK_NEXT=apart(landmarks),
            expected=code.address("expected", m * padded), EXPECTED_STRIDE=padded,
        )  # fmt: skip

    def _weights(self, logs: Array) -> Weights:
        found = _Weights(*logs.shape)
        found.fields["log"] = flat(logs)
        count, runs = logs.shape
        self.code.normalise(**self.code.common(count, 1, runs, None), **found.fields)
        return found.weights()

    def _moments(self, space: Space, points: Array, weights: Array, generators: Any) -> Gaussian:
        n, count, runs = points.shape
        mean, cov, vector, weight = np.empty((runs, n)), np.empty((runs, n, n)), flat(points), flat(weights)
        self.code.sum(
            **self.code.common(count, n + len(space.angles), runs, generators), vector=vector,
            CLOUD_STRIDE=count * runs, weight=weight, mean=mean, cov=cov,
        )  # fmt: skip
        return Gaussian(mean.T, cov.transpose(1, 2, 0))

    def _chosen(self, weights: Array, generators: Generators) -> Array:
        if self.resampling == "residual":
            return super()._chosen(weights, generators)
        (count, runs), weight, code = weights.shape, flat(weights), self.code
        chosen, choice = np.empty((runs, count), dtype=np.int64), self._choice(generators)
        code.choose(**code.common(count, 0, runs, None), **choice, weight=weight, chosen=chosen)
        return chosen.T

    def _choice(self, generators: Generators | None) -> dict[str, Any]:
        """The uniform numbers of resampling, drawn here or later, and how positions follow from them."""
        count = self.particles
        numbers = 1 if self.resampling == "systematic" else count
        strata = np.array([0.0, 1.0] if self.resampling == "multinomial" else [1.0, count])
        how = {"U_STRIDE": int(numbers > 1), "strata": strata}
        if generators is None:
            return how | {"u": self.code.address("u", numbers), "U_NEXT": 0, "U_DRAWN": numbers}
        u = flat(generators.uniforms((numbers,)))
        return how | {"u": np.sort(u) if self.resampling == "multinomial" else u, "U_NEXT": numbers, "U_DRAWN": 0}


class _Weights:
    """Room for a program's weights."""

    def __init__(self, count: int, runs: int) -> None:
        self.fields = {
            "log": np.empty((runs, count)), "linear": np.empty((runs, count)), "size": np.empty(runs),
            "vanished": np.empty(runs),
        }  # fmt: skip

    def weights(self) -> Weights:
        f = self.fields
        return Weights(f["log"].T, f["linear"].T, f["size"], f["vanished"] != 0.0)
