"""Particle filters: a belief as a weighted cloud, of any shape."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from estlab.filters.contract import Filter, Fit, Prior, Sample, fit_of
from estlab.maths.gaussian import Gaussian, placed
from estlab.maths.linalg import cholesky, gram, matmul, solve_lower, without
from estlab.maths.resampling import Scheme, effective_size, log_normalised, resample
from estlab.maths.space import Array
from estlab.maths.streams import Draws
from estlab.models.contract import Motion, Sensor


class Step(NamedTuple):
    """The last prediction, kept for a filter that chooses ancestors once it has seen the reading."""

    motion: Motion
    before: Array
    control: Array
    noise: Array
    dt: float

    def of(self, runs: Array) -> "Step":
        """The prediction in some of the runs."""
        control = self.control[..., runs] if self.control.shape[-1] > 1 else self.control
        return self._replace(before=self.before[..., runs], control=control, noise=self.noise[..., runs])


class Particles(NamedTuple):
    """Points (n, N, runs) and normalised log-weights (N, runs); where they began, and their streams.

    vanished: (runs,) how often all weights were lost since the last prediction.
    last: the prediction that made the points. fresh: (runs,) whether no reading has come since.
    """

    points: Array
    log_weights: Array
    prior: Prior
    draws: Draws
    vanished: Array
    last: Step | None
    fresh: Array

    def of(self, runs: Array) -> "Particles":
        """The belief in some of the runs."""
        arrays = (self.points, self.log_weights, self.vanished, self.fresh)
        points, log_weights, vanished, fresh = (a[..., runs] for a in arrays)
        last = None if self.last is None else self.last.of(runs)
        return Particles(points, log_weights, self.prior.of(runs), self.draws.of(runs), vanished, last, fresh)

    def put(self, runs: Array, part: "Particles") -> "Particles":
        """The belief with those of some runs replaced."""
        return self._replace(
            points=placed(self.points, runs, part.points),
            log_weights=placed(self.log_weights, runs, part.log_weights),
            vanished=placed(self.vanished, runs, part.vanished),
            fresh=placed(self.fresh, runs, part.fresh),
        )

    @property
    def weights(self) -> Array:
        return np.exp(self.log_weights)


@dataclass(frozen=True)
class ParticleFilter(Filter):
    """Predict by drawing, update by weighing, resample when few weights are left. Gordon, Salmond and Smith 1993.

    particles: how many. resampling: by which scheme. threshold: resample when the effective sample size is below this
    share of them, at the next prediction, so that estimates are of the weighted cloud.
    roughening: >= 0, noise after resampling as a share of the cloud's range times N^(-1/n); Gordon et al., section 4.
    injection: share of the particles drawn anew from the prior at each resampling.
    bandwidth: >= 0, kernel noise after resampling as a multiple of the width that is best for a Gaussian cloud;
    Musso, Oudjane and Le Gland 2001, section 12.2.3, with the shrinkage of Liu and West 2001, section 10.3.2.
    ancestors: ``bootstrap`` keeps each particle's own; ``auxiliary`` chooses those whose noiseless prediction fits the
    reading; Pitt and Shephard 1999.
    recovery: what to do when every log-weight is -inf, as where a reading or a model is not finite: ``flatten`` forgets
    the reading, ``redraw`` begins again from the prior. However small, a likelihood is none of these: the particle
    nearest the reading then has all the weight.
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

    def start(self, prior: Prior, draws: Draws) -> Particles:
        points = prior.sample(draws, self.particles)
        runs = points.shape[-1]
        even = np.full((self.particles, runs), -np.log(self.particles))
        return Particles(points, even, prior, draws, np.zeros(runs, dtype=int), None, np.zeros(runs, dtype=bool))

    def predict(self, motion: Motion, belief: Particles, control: Array, dt: float) -> Particles:
        belief = self._resampled(motion, belief)
        z = belief.draws.normals((motion.noise_size, self.particles))
        noise = matmul(cholesky(motion.noise_cov(control, dt)), z)
        points = motion.step(belief.points, control, noise, dt)
        last = Step(motion, belief.points, control, noise, dt)
        fresh = np.ones_like(belief.fresh)
        return belief._replace(points=points, vanished=np.zeros_like(belief.vanished), last=last, fresh=fresh)

    def update(self, sensor: Sensor, belief: Particles, reading: Array, place: Array) -> tuple[Particles, Fit]:
        fit = _fit(sensor, belief, reading, place)
        fresh = np.flatnonzero(belief.fresh)
        weighed = belief.log_weights + _log_likelihood(sensor, belief.points, reading, place)
        updated = belief._replace(log_weights=weighed)
        if self.ancestors == "auxiliary" and belief.last is not None and fresh.size:
            part = belief.of(fresh)
            place = place[..., fresh] if place.shape[-1] > 1 else place
            part = self._with_chosen_ancestors(sensor, part, part.last, reading[:, fresh], place)
            updated = updated.put(fresh, part)
        belief = updated
        log_weights, vanished = log_normalised(belief.log_weights)
        points = belief.points
        if self.recovery == "redraw" and vanished.any():
            lost = np.flatnonzero(vanished)
            points = placed(points, lost, belief.prior.of(lost).sample(belief.draws.of(lost), self.particles))
        counted = belief.vanished + vanished
        stale = np.zeros_like(belief.fresh)
        return belief._replace(points=points, log_weights=log_weights, vanished=counted, fresh=stale), fit

    def moments(self, belief: Particles, motion: Motion) -> Gaussian:
        weights = belief.weights
        mean = motion.space.mean(belief.points, weights)
        spread = motion.space.minus(belief.points, mean[:, None])
        return Gaussian(mean, gram(weights * spread, spread))

    def sample(self, belief: Particles) -> Sample:
        size = effective_size(belief.log_weights)
        return Sample(size, 1.0 - 1.0 / size)

    def notes(self, belief: Particles) -> dict[str, Array]:
        return {"ess": effective_size(belief.log_weights), "vanished": belief.vanished}

    def _resampled(self, motion: Motion, belief: Particles) -> Particles:
        """The belief with equal weights in the runs whose effective sample size is too small."""
        few = np.flatnonzero(effective_size(belief.log_weights) < self.threshold * self.particles)
        if few.size == 0:
            return belief
        draws = belief.draws.of(few)
        cloud, weights = belief.points[:, :, few], belief.weights[:, few]
        chosen = np.take_along_axis(cloud, resample(self.resampling, weights, draws)[None], axis=1)
        n = cloud.shape[0]
        if self.roughening > 0.0:
            about = motion.space.mean(cloud, weights)[:, None]
            wide = np.ptp(motion.space.minus(cloud, about), axis=1)[:, None]  # round the mean: a heading has no ends
            chosen = chosen + self.roughening * wide * self.particles ** (-1.0 / n) * draws.normals(chosen.shape[:2])
        if self.bandwidth > 0.0:
            moments = self.moments(belief._replace(points=cloud, log_weights=belief.log_weights[:, few]), motion)
            best = (4.0 / ((n + 2.0) * self.particles)) ** (1.0 / (n + 4.0))
            width = min(self.bandwidth * best, 1.0)
            # Drawn toward the mean by as much as the kernel spreads, so that the covariance stays. A cloud in one
            # point has no width to smooth by.
            about = moments.mean[:, None]
            kernel = matmul(np.nan_to_num(cholesky(moments.cov), nan=0.0), draws.normals(chosen.shape[:2]))
            chosen = about + np.sqrt(1.0 - width**2) * motion.space.minus(chosen, about) + width * kernel
        if self.injection > 0.0:
            fresh = belief.prior.of(few).sample(draws, self.particles)
            replaced = draws.uniforms((self.particles,)) < self.injection
            chosen = np.where(replaced, fresh, chosen)
        points, log_weights = belief.points.copy(), belief.log_weights.copy()
        points[:, :, few], log_weights[:, few] = chosen, -np.log(self.particles)
        return belief._replace(points=points, log_weights=log_weights)

    def _with_chosen_ancestors(
        self, sensor: Sensor, belief: Particles, last: Step | None, reading: Array, place: Array
    ) -> Particles:
        """Ancestors drawn by how their noiseless prediction fits, moved with the noise and weighed for the choice."""
        if last is None:
            return belief
        silent = np.zeros_like(last.noise)
        guess = last.motion.step(last.before, last.control, silent, last.dt)
        fits = _log_likelihood(sensor, guess, reading, place)
        first_stage, _ = log_normalised(belief.log_weights + fits)
        chosen = resample(self.resampling, np.exp(first_stage), belief.draws)
        before = np.take_along_axis(last.before, chosen[None], axis=1)
        points = last.motion.step(before, last.control, last.noise, last.dt)
        second = _log_likelihood(sensor, points, reading, place) - np.take_along_axis(fits, chosen, axis=0)
        return belief._replace(points=points, log_weights=second)


def _log_likelihood(sensor: Sensor, points: Array, reading: Array, place: Array) -> Array:
    """log p(reading | point) up to a constant, (N, runs); a missing number says nothing."""
    residual = sensor.space.minus(reading[:, None], sensor.read(points, place))
    missing = np.isnan(reading)
    residual = np.where(missing[:, None], 0.0, residual)
    factor = cholesky(without(sensor.noise_cov, missing))
    whitened = solve_lower(factor[:, :, None], residual[:, None])[:, 0]
    return -0.5 * np.einsum("i...,i...->...", whitened, whitened)


def _fit(sensor: Sensor, belief: Particles, reading: Array, place: Array) -> Fit:
    """NIS by the moments of the predicted reading under the weighted cloud."""
    weights = belief.weights
    expected = sensor.read(belief.points, place)
    mean = sensor.space.mean(expected, weights)
    spread = sensor.space.minus(expected, mean[:, None])
    missing = np.isnan(reading)
    cov = without(gram(weights * spread, spread) + sensor.noise_cov[..., None], missing)
    residual = np.where(missing, 0.0, sensor.space.minus(reading, mean))
    factor = cholesky(cov)
    whitened = solve_lower(factor, residual[:, None])[:, 0]
    return fit_of(whitened, factor, missing, None)
