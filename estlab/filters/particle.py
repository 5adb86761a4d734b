"""Particle filters: a belief as a weighted cloud, of any shape."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from estlab.filters.filter import Cloud, Filter, Innovation, Prior, Sample, Traits, innovation_of
from estlab.filters.step import Step, own
from estlab.maths import cloud
from estlab.maths.gaussian_belief import Gaussian, replaced
from estlab.maths.linalg import cholesky, solve_lower, without
from estlab.maths.resampling import Scheme, Weights, resample
from estlab.maths.space import Array, Space
from estlab.maths.streams import Generators
from estlab.models.contract import Motion, Sensor

_SAMPLED = 200  # particles of a run that are stored of a cloud


class Particles(NamedTuple):
    """A cloud (n, N, runs) with its weights; its origin, and its generators.

    lost: (runs,) how often all weights vanished since the last prediction.
    last: the prediction that made the points. fresh: (runs,) whether there was no reading since.
    """

    points: Array
    weights: Weights
    prior: Prior
    generators: Generators
    lost: Array
    last: Step | None
    fresh: Array

    def take(self, runs: Array) -> "Particles":
        """The belief in some of the runs."""
        last = None if self.last is None else self.last.take(runs)
        own = self.prior.take(runs), self.generators.take(runs), self.lost[runs]
        return Particles(cloud.take(self.points, runs), self.weights.take(runs), *own, last, self.fresh[runs])

    def replaced(self, runs: Array, part: "Particles") -> "Particles":
        """The belief with those of some runs replaced."""
        return self._replace(
            points=cloud.replaced(self.points, runs, part.points),
            weights=self.weights.replaced(runs, part.weights),
            lost=replaced(self.lost, runs, part.lost),
            fresh=replaced(self.fresh, runs, part.fresh),
        )


@dataclass(frozen=True)
class ParticleFilter(Filter[Particles]):
    """Predict by sampling, update by weighting, resample when few weights are left. Gordon, Salmond and Smith 1993.

    particles: their number. resampling: the scheme. threshold: resample when the effective sample size is below this
    share of them, at the next prediction, so that estimates come from the weighted cloud.
    roughening: >= 0, noise after resampling as a share of the cloud's range times N^(-1/n); Gordon et al., section 4.
    injection: share of the particles drawn from the prior at each resampling.
    bandwidth: >= 0, kernel noise after resampling as a multiple of the optimal width for a Gaussian cloud; Musso,
    Oudjane and Le Gland 2001, section 12.2.3, with the shrinkage of Liu and West 2001, section 10.3.2.
    ancestors: ``bootstrap`` keeps each particle's own; ``auxiliary`` chooses those whose noiseless prediction matches
    the reading; Pitt and Shephard 1999.
    recovery: what to do when every log-weight is -inf, for example because a reading or a model is not finite:
    ``flatten`` ignores the reading, ``redraw`` starts again from the prior. A small likelihood is not such a case:
    the particle closest to the reading then has all the weight.
    """

    particles: int
    resampling: Scheme
    threshold: float
    roughening: float
    injection: float
    bandwidth: float
    ancestors: Literal["bootstrap", "auxiliary"]
    recovery: Literal["flatten", "redraw"]

    def __post_init__(self) -> None:
        if not 2 <= self.particles <= 20_000_000:
            raise ValueError(f"particles must be from 2 to 2e7, got {self.particles}")
        for name in ("threshold", "injection"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} must be a share from 0 to 1, got {getattr(self, name):g}")
        for name in ("roughening", "bandwidth"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} must be >= 0, got {getattr(self, name):g}")

    @property
    def traits(self) -> Traits:
        return Traits(points=self.particles, sampled_by="particles")

    def start(self, prior: Prior, generators: Generators) -> Particles:
        points = cloud.laid_out(prior.sample(generators, self.particles))
        runs = points.shape[2]
        even = Weights.even(self.particles, runs)
        return Particles(points, even, prior, generators, np.zeros(runs, dtype=int), None, np.zeros(runs, dtype=bool))

    def predict(self, motion: Motion, belief: Particles, control: Array, dt: float) -> Particles:
        before = self._resampled(motion, belief)
        points, step = self._drawn(motion, before.points, control, dt, belief.generators)
        return self._after(before._replace(points=points), step)

    def update(
        self, sensor: Sensor, belief: Particles, reading: Array, landmark: Array
    ) -> tuple[Particles, Innovation]:
        weights, innovation = self._weighed(sensor, belief, reading, landmark)
        weighed = belief._replace(weights=weights)
        fresh = np.flatnonzero(belief.fresh)
        if self.ancestors == "auxiliary" and belief.last is not None and fresh.size:
            everyone = fresh.size == belief.fresh.size  # as a rule, and then nothing is copied
            some = belief if everyone else belief.take(fresh)
            part = self._with_chosen_ancestors(sensor, some, reading[:, fresh], own(landmark, fresh))
            weighed = part if everyone else weighed.replaced(fresh, part)
        vanished = weighed.weights.vanished
        points = weighed.points
        if self.recovery == "redraw" and vanished.any():
            lost = np.flatnonzero(vanished)
            points = cloud.replaced(
                points, lost, belief.prior.take(lost).sample(belief.generators.take(lost), self.particles)
            )
        return weighed._replace(
            points=points, lost=belief.lost + vanished, fresh=np.zeros_like(belief.fresh)
        ), innovation

    def moments(self, belief: Particles, motion: Motion) -> Gaussian:
        return self._moments(motion.space, belief.points, belief.weights.linear, belief.generators)

    def sample(self, belief: Particles) -> Sample:
        return Sample(belief.weights.size, 1.0 - 1.0 / belief.weights.size)

    def cloud(self, belief: Particles, runs: int) -> Cloud:
        return Cloud(*cloud.sampled(belief.points[..., :runs], belief.weights.linear[:, :runs], _SAMPLED))

    def notes(self, belief: Particles) -> dict[str, Array]:
        return {"ess": belief.weights.size, "vanished": belief.lost}

    def _resampled(self, motion: Motion, belief: Particles) -> Particles:
        """The belief with equal weights in the runs whose effective sample size is too small."""
        few = np.flatnonzero(belief.weights.size < self.threshold * self.particles)
        if few.size == 0:
            return belief
        generators, weights = belief.generators.take(few), cloud.take(belief.weights.linear, few)
        chosen = cloud.chosen(belief.points, few, self._chosen(weights, generators))
        n = chosen.shape[0]
        if self.roughening > 0.0:
            before = cloud.take(belief.points, few)
            about = cloud.mean(motion.space, before, weights)[:, None]
            wide = np.ptp(motion.space.minus(before, about), axis=1)[:, None]  # about the mean: a heading has no ends
            chosen = chosen + self.roughening * wide * self.particles ** (-1.0 / n) * generators.normals(
                chosen.shape[:2]
            )
        if self.bandwidth > 0.0:
            moments = self._moments(motion.space, cloud.take(belief.points, few), weights, generators)
            best = (4.0 / ((n + 2.0) * self.particles)) ** (1.0 / (n + 4.0))
            width = min(self.bandwidth * best, 1.0)
            # Shrunk toward the mean by as much as the kernel spreads, so that the covariance stays the same. A cloud
            # in one point has no width to smooth by.
            about = moments.mean[:, None]
            kernel = cloud.combined(np.nan_to_num(cholesky(moments.cov), nan=0.0), generators.normals(chosen.shape[:2]))
            chosen = about + np.sqrt(1.0 - width**2) * motion.space.minus(chosen, about) + width * kernel
        if self.injection > 0.0:
            fresh = belief.prior.take(few).sample(generators, self.particles)
            injected = generators.uniforms((self.particles,)) < self.injection
            chosen = np.where(injected, fresh, chosen)
        even = Weights.even(self.particles, few.size)
        return belief._replace(
            points=cloud.replaced(belief.points, few, chosen), weights=belief.weights.replaced(few, even)
        )

    def _with_chosen_ancestors(self, sensor: Sensor, belief: Particles, reading: Array, landmark: Array) -> Particles:
        """Ancestors drawn by the fit of their noiseless prediction and moved with noise; weights correct for this."""
        last = belief.last
        if last is None:
            return belief
        even = Weights.even(*belief.weights.log.shape)
        guess = belief._replace(points=self._moved(last.silent(), belief.generators), weights=even)
        likelihood = self._likelihood(sensor, guess, reading, landmark)
        first_stage = self._weights(belief.weights.log + likelihood).linear
        chosen = self._chosen(first_stage, belief.generators)
        every = np.arange(chosen.shape[1])
        before = cloud.chosen(last.before, every, chosen)
        moved = belief._replace(points=self._moved(last._replace(before=before), belief.generators), weights=even)
        second = self._likelihood(sensor, moved, reading, landmark)
        return moved._replace(weights=self._weights(second - cloud.chosen(likelihood[None], every, chosen)[0]))

    def _after(self, belief: Particles, step: Step) -> Particles:
        """The belief after a step that made its points."""
        nothing, fresh = np.zeros_like(belief.lost), np.ones_like(belief.fresh)
        return belief._replace(lost=nothing, last=step if self.ancestors == "auxiliary" else None, fresh=fresh)

    # The work on whole clouds, which compiled code does too: see estlab.filters.compiled_particles.

    def _drawn(
        self, motion: Motion, points: Array, control: Array, dt: float, generators: Generators
    ) -> tuple[Array, Step]:
        """The points (n, N, runs) after a step with random noise; and the step."""
        step = Step.drawn(motion, points, control, dt, generators)
        return self._moved(step, generators), step

    def _moved(self, step: Step, generators: Generators) -> Array:
        """The points (n, N, runs) after a step."""
        return step.points()

    def _weighed(
        self, sensor: Sensor, belief: Particles, reading: Array, landmark: Array
    ) -> tuple[Weights, Innovation]:
        """The weights given a reading, and the reading that the belief expects."""
        logs, expected = self._looked(sensor, belief, reading, landmark)
        return self._weights(logs), _innovation(sensor, expected, reading)

    def _likelihood(self, sensor: Sensor, belief: Particles, reading: Array, landmark: Array) -> Array:
        """Log-weights (N, runs) with log p(reading | point), up to a constant."""
        return self._looked(sensor, belief, reading, landmark)[0]

    def _looked(self, sensor: Sensor, belief: Particles, reading: Array, landmark: Array) -> tuple[Array, Gaussian]:
        """Log-weights (N, runs) with log p(reading | point), up to a constant; and the expected reading."""
        count, runs = belief.weights.log.shape
        m, whitening = sensor.space.size, whitening_of(sensor, reading)
        logs, mean, cov = cloud.empty(1, count, runs)[0], np.empty((m, runs)), np.empty((m, m, runs))
        for some in cloud.groups(count, runs):
            look = _Look(sensor, reading[:, some], own(landmark, some), own(whitening, some))
            expected, squares = look.at(belief.points[..., some])
            np.subtract(belief.weights.log[:, some], squares, out=logs[:, some])
            mean[:, some], cov[..., some] = cloud.moments(sensor.space, expected, belief.weights.linear[:, some])
        return logs, Gaussian(mean, cov)

    def _weights(self, logs: Array) -> Weights:
        """Weights with these logarithms (N, runs), up to a factor. Reuses the array."""
        return Weights.of_logs(logs)

    def _moments(self, space: Space, points: Array, weights: Array, generators: Generators) -> Gaussian:
        """Weighted mean (n, runs) and covariance (n, n, runs) of points."""
        return cloud.moments(space, points, weights)

    def _chosen(self, weights: Array, generators: Generators) -> Array:
        """Indices (N, runs) of the points that resampling by these weights (N, runs) keeps."""
        return resample(self.resampling, weights, generators)


def whitening_of(sensor: Sensor, reading: Array) -> Array:
    """What turns differences from a reading (m, runs) into numbers whose squares sum to -log p; (m, m, runs or 1).

    A missing number carries no information.
    """
    missing = np.isnan(reading)
    factor = cholesky(without(sensor.noise_cov, missing) if missing.any() else sensor.noise_cov[..., None])
    identity = np.eye(sensor.space.size)[..., None]
    return solve_lower(factor, np.sqrt(0.5) * np.broadcast_to(identity, factor.shape))


class _Look(NamedTuple):
    """A reading (m, runs), its landmark, and the factor that whitens a difference from it."""

    sensor: Sensor
    reading: Array
    landmark: Array
    whitening: Array

    def at(self, points: Array) -> tuple[Array, Array]:
        """The readings (m, N, runs) that points would give, and their distance from this one, -log p (N, runs)."""
        _, count, runs = points.shape
        expected, squares = cloud.empty(len(self.reading), count, runs), cloud.empty(1, count, runs)[0]
        missing = np.isnan(self.reading)[:, None]

        def weigh(part: slice) -> None:
            values = expected[:, part]
            cloud.fill(values, self.sensor.measure(points[:, part], self.landmark))
            residual = self.sensor.space.minus(self.reading[:, None], values)
            if missing.any():
                residual = np.where(missing, 0.0, residual)
            whitened = cloud.combined(self.whitening, residual)
            np.einsum("ipr,ipr->pr", whitened, whitened, out=squares[part])

        cloud.each(weigh, count)
        return expected, squares


def _innovation(sensor: Sensor, expected: Gaussian, reading: Array) -> Innovation:
    """How far a reading lies from the expectation of the weighted cloud."""
    missing = np.isnan(reading)
    innovation = np.where(missing, 0.0, sensor.space.minus(reading, expected.mean))
    factor = cholesky(without(expected.cov + sensor.noise_cov[..., None], missing))
    whitened = solve_lower(factor, innovation[:, None])[:, 0]
    return innovation_of(whitened, factor, missing, None)
