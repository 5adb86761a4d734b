"""The Gaussian filter family: one prediction, one gain, any transform."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from estlab.maths.gaussian import Gaussian
from estlab.maths.linalg import cholesky, gram, sandwich, solve_lower, symmetric, transpose
from estlab.maths.space import Array
from estlab.maths.transforms import Linearised, Transform, Unscented
from estlab.models.contract import Motion, Sensor


class Innovation(NamedTuple):
    """How a reading fitted: its normalised innovation squared (runs,) and the numbers in it (runs,)."""

    nis: Array
    size: Array


@dataclass(frozen=True)
class GaussianFilter:
    """Predict and update a Gaussian belief. Saerkkae 2013, chapter 6: the moment-matching filter.

    transform: how a belief goes through a model; this alone makes it an EKF, UKF or CKF.
    noise: ``augmented`` sends the noises through the models with the state; ``additive`` sends the state
    alone and adds their covariances, linearised in the process noise.
    """

    transform: Transform
    noise: Literal["additive", "augmented"]

    def check(self, motion: Motion) -> None:
        """Raise ValueError, naming the key, if the transform is not defined for this state and its noise."""
        n = motion.space.size
        self.transform.check(n)
        if self.noise == "augmented":
            self.transform.check(n + motion.noise_size)

    def start(self, prior: Gaussian) -> Gaussian:
        """The belief before the first step, with a covariance for each run."""
        runs = prior.mean.shape[1]
        n = prior.mean.shape[0]
        return Gaussian(prior.mean, np.broadcast_to(prior.cov.reshape(n, n, -1), (n, n, runs)))

    def predict(self, motion: Motion, belief: Gaussian, control: Array, dt: float) -> Gaussian:
        """The belief dt [s] later."""
        noise_cov = motion.noise_cov(control, dt)
        if self.noise == "augmented":
            moments = self.transform(motion.joint_function(control, dt), belief.joined(noise_cov))
            return Gaussian(moments.mean, moments.cov)
        moments = self.transform(motion.function(control, dt), belief)
        slope = motion.noise_jacobian(belief.mean, control, dt)
        return Gaussian(moments.mean, moments.cov + sandwich(slope, noise_cov))

    def update(self, sensor: Sensor, belief: Gaussian, reading: Array, place: Array) -> tuple[Gaussian, Innovation]:
        """The belief given a reading (m, runs) about places (p, runs). A NaN in the reading was not measured."""
        n = belief.mean.shape[0]
        if self.noise == "augmented":
            predicted = self.transform(sensor.joint_function(place, n), belief.joined(sensor.noise_cov))
            cross, innovation_cov = predicted.cross[:n], predicted.cov
        else:
            predicted = self.transform(sensor.function(place), belief)
            cross = predicted.cross
            innovation_cov = predicted.cov + sensor.noise_cov.reshape(*sensor.noise_cov.shape, 1)
        residual = sensor.space.minus(reading, predicted.mean)
        missing = np.isnan(reading)
        if missing.any():
            cross, innovation_cov, residual = _without(missing, cross, innovation_cov, residual)

        # With S = L L', the gain times the innovation is (L^-1 C')' (L^-1 r), and K S K' is a gram matrix.
        factor = cholesky(innovation_cov)
        gain = solve_lower(factor, transpose(cross))
        whitened = solve_lower(factor, residual[:, None])[:, 0]
        mean = sensor.state.plus(belief.mean, np.einsum("ik...,i...->k...", gain, whitened))
        cov = symmetric(belief.cov - gram(transpose(gain)))
        nis = np.einsum("i...,i...->...", whitened, whitened)
        return Gaussian(mean, cov), Innovation(nis, (~missing).sum(axis=0))


@dataclass(frozen=True)
class DeadReckoning(GaussianFilter):
    """Prediction alone: what the commands say, with no reading used. The baseline of every other filter."""

    def update(self, sensor: Sensor, belief: Gaussian, reading: Array, place: Array) -> tuple[Gaussian, Innovation]:
        """The belief as it was."""
        nothing = np.zeros(belief.mean.shape[1:])
        return belief, Innovation(nothing, nothing.astype(int))


def extended(noise: Literal["additive", "augmented"]) -> GaussianFilter:
    """The extended Kalman filter. Jazwinski 1970, theorem 8.1."""
    return GaussianFilter(Linearised(), noise)


def unscented(alpha: float, beta: float, kappa: float, noise: Literal["additive", "augmented"]) -> GaussianFilter:
    """The unscented Kalman filter with the scaled sigma points. Van der Merwe 2004, algorithms 3.1 and 3.2."""
    return GaussianFilter(Unscented(alpha, beta, kappa), noise)


def _without(missing: Array, cross: Array, innovation_cov: Array, residual: Array) -> tuple[Array, Array, Array]:
    """The same update without the missing numbers (m, runs): they become independent of the state, with no residual.

    Exactly the update with the rows left out, yet of one shape for all runs.
    """
    either = missing[:, None] | missing[None, :]
    identity = np.eye(missing.shape[0]).reshape(*either.shape[:2], 1)
    return np.where(missing, 0.0, cross), np.where(either, identity, innovation_cov), np.where(missing, 0.0, residual)
