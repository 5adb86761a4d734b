"""The Gaussian filter family: one prediction, one gain, any transform."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from estlab.filters.filter import Filter, Innovation, Prior, Traits, innovation_of
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.linalg import cholesky, matmul, matvec, solve_lower, transpose, without
from estlab.maths.sigma_points import GaussHermite, Julier, Scaled, Simplex
from estlab.maths.space import Array
from estlab.maths.stacking import through
from estlab.maths.streams import Generators
from estlab.maths.transforms import Linearised, Moments, SecondOrder, Transform
from estlab.models.contract import Motion, Sensor

Noise = Literal["additive", "augmented"]


@dataclass(frozen=True)
class GaussianFilter(Filter[Gaussian]):
    """Predict and update a Gaussian belief. Saerkkae 2013, chapter 6: the moment-matching filter.

    transform: how a belief goes through a model; this is the only difference between EKF, UKF and CKF.
    noise: ``augmented`` sends the noises through the models with the state; ``additive`` sends only the state and
    adds their covariances, linearised in the process noise.
    gate: the share of correct readings that pass, such as 0.999; see :func:`estlab.filters.filter.innovation_of`.
    """

    transform: Transform
    noise: Noise
    gate: float | None

    def __post_init__(self) -> None:
        check_gate(self.gate)

    @property
    def traits(self) -> Traits:
        return Traits(gate=self.gate, smooths=True, single=True)

    def check(self, motion: Motion, sensor: Sensor) -> None:
        n = motion.space.size
        self.transform.check(n)
        if self.noise == "augmented":
            self.transform.check(n + motion.noise_size)
            self.transform.check(n + sensor.space.size)

    def start(self, prior: Prior, generators: Generators) -> Gaussian:
        mean, cov = prior.fitted()
        n, runs = mean.shape
        return Gaussian(mean, np.broadcast_to(cov.reshape(n, n, -1), (n, n, runs)))

    def predict(self, motion: Motion, belief: Gaussian, control: Array, dt: float) -> Gaussian:
        moments = self._propagated(motion, belief, control, dt, crossed=False)
        return Gaussian(motion.space.wrapped(moments.mean), moments.cov)

    def propagate(self, motion: Motion, belief: Gaussian, control: Array, dt: float) -> Moments:
        """The prediction with its cross-covariance to the previous state, which a smoother needs."""
        moments = self._propagated(motion, belief, control, dt, crossed=True)
        return moments._replace(mean=motion.space.wrapped(moments.mean))

    def _propagated(self, motion: Motion, belief: Gaussian, control: Array, dt: float, crossed: bool) -> Moments:
        noise_cov = motion.noise_cov(control, dt)
        if self.noise == "augmented":
            joint = self.transform(motion.joint_function(control, dt), belief.joined(noise_cov), crossed)
            return joint._replace(cross=joint.cross[: motion.space.size])
        function, noise_jacobian = motion.over(control, dt)
        moments = self.transform(function, belief, crossed)
        _, added = through(noise_jacobian(belief.mean), noise_cov, belief.mean.shape[1:])
        return moments._replace(cov=moments.cov + added)

    def update(self, sensor: Sensor, belief: Gaussian, reading: Array, landmark: Array) -> tuple[Gaussian, Innovation]:
        return self.condition(sensor, belief, self.predicted(sensor, belief, landmark), reading, self.gate)

    def predicted(self, sensor: Sensor, belief: Gaussian, landmark: Array) -> Moments:
        """Mean and covariance of the next reading, noise included, and its cross-covariance with the state."""
        if self.noise == "augmented":
            n = belief.mean.shape[0]
            joint = self.transform(sensor.joint_function(landmark, n), belief.joined(sensor.noise_cov))
            return joint._replace(cross=joint.cross[:n])
        moments = self.transform(sensor.function(landmark), belief)
        return moments._replace(cov=moments.cov + _shaped(sensor.noise_cov, moments.cov))

    def condition(
        self, sensor: Sensor, belief: Gaussian, predicted: Moments, reading: Array, gate: float | None
    ) -> tuple[Gaussian, Innovation]:
        """A Gaussian belief given a reading: x | z from the joint moments of x and z.

        With S = L L' the Kalman gain is K = C S^-1 = (L^-1 C')' L^-1. The update needs it in two halves alone:
        K (z - z_hat) = (L^-1 C')' (L^-1 (z - z_hat)), and K S K' = (L^-1 C')' (L^-1 C') is symmetric by construction.
        Bar-Shalom, Li and Kirubarajan 2001, equations 1.4.14-5 and -6; Saerkkae 2013, equations 6.7.
        """
        cross, innovation_cov = predicted.cross, predicted.cov
        innovation = sensor.space.minus(reading, predicted.mean)
        missing = np.isnan(reading)
        if missing.any():
            cross, innovation_cov, innovation = _without(missing, cross, innovation_cov, innovation)

        factor = cholesky(innovation_cov)  # L
        both = solve_lower(factor, np.concatenate([transpose(cross), innovation[:, None]], axis=1))
        half_gain, whitened = both[:, :-1], both[:, -1]  # L^-1 C' = (K L)', L^-1 (z - z_hat)
        found = innovation_of(whitened, factor, missing, gate)
        if found.gated.any():
            half_gain = np.where(found.gated, 0.0, half_gain)
        mean = sensor.state.plus(belief.mean, matvec(transpose(half_gain), whitened))
        return Gaussian(mean, belief.cov - matmul(transpose(half_gain), half_gain)), found

    def moments(self, belief: Gaussian, motion: Motion) -> Gaussian:
        return belief


@dataclass(frozen=True)
class DeadReckoning(GaussianFilter):
    """Prediction only: uses the commands and no readings. The baseline for every other filter."""

    @property
    def traits(self) -> Traits:
        return super().traits._replace(reads=False)

    def update(self, sensor: Sensor, belief: Gaussian, reading: Array, landmark: Array) -> tuple[Gaussian, Innovation]:
        nothing = np.full(reading.shape, np.nan)
        return belief, Innovation(nothing, nothing, np.zeros(reading.shape[1:], dtype=bool))


@dataclass(frozen=True)
class IteratedFilter(GaussianFilter):
    """The update repeated, with the sensor relinearised about the latest estimate: Gauss-Newton. Bell and Cathey
    1993.

    iterations: >= 1 linearisations; 1 is the EKF. The innovation is that of the first, about the prediction.
    """

    iterations: int

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.iterations <= 1000:
            raise ValueError(f"iterations must be from 1 to 1000, got {self.iterations}")

    def update(self, sensor: Sensor, belief: Gaussian, reading: Array, landmark: Array) -> tuple[Gaussian, Innovation]:
        found, first = super().update(sensor, belief, reading, landmark)
        noise_cov = _shaped(sensor.noise_cov, belief.cov)
        for _ in range(self.iterations - 1):
            offset = sensor.state.minus(belief.mean, found.mean)
            moments = Linearised().about(sensor.function(landmark), belief, found.mean, offset)
            # A reading that passed the gate is not tested again.
            again, _ = self.condition(sensor, belief, moments._replace(cov=moments.cov + noise_cov), reading, None)
            mean = np.where(first.gated, found.mean, again.mean)
            found = Gaussian(mean, np.where(first.gated, found.cov, again.cov))
        return found, first


def extended(noise: Noise, gate: float | None) -> GaussianFilter:
    """The extended Kalman filter. Jazwinski 1970, theorem 8.1."""
    return GaussianFilter(Linearised(), noise, gate)


def dead_reckoning() -> DeadReckoning:
    """The models alone, linearised for the covariance."""
    return DeadReckoning(Linearised(), "additive", None)


def second_order(form: Literal["gaussian", "modified"], noise: Noise, gate: float | None) -> GaussianFilter:
    """The second-order filter. Bar-Shalom, Li and Kirubarajan 2001, section 10.3.2; modified as in document 004."""
    return GaussianFilter(SecondOrder(form), noise, gate)


def gauss_hermite(order: int, noise: Noise, gate: float | None) -> GaussianFilter:
    """The Gauss-Hermite Kalman filter. Ito and Xiong 2000."""
    return GaussianFilter(GaussHermite(order), noise, gate)


def iterated(iterations: int, gate: float | None) -> IteratedFilter:
    """The iterated extended Kalman filter. Bell and Cathey 1993."""
    return IteratedFilter(Linearised(), "additive", gate, iterations)


def unscented(
    points: Literal["merwe", "julier", "simplex"],
    alpha: float,
    beta: float,
    kappa: float,
    noise: Noise,
    gate: float | None,
) -> GaussianFilter:
    """The unscented Kalman filter. Van der Merwe 2004, algorithms 3.1 and 3.2.

    points: ``merwe``, the scaled set of alpha, beta, kappa; ``julier``, of kappa only; ``simplex``, of none.
    """
    sets: dict[str, Transform] = {"merwe": Scaled(alpha, beta, kappa), "julier": Julier(kappa), "simplex": Simplex()}
    return GaussianFilter(sets[points], noise, gate)


def check_gate(gate: float | None) -> None:
    """Raise ValueError unless a gate is a probability or none."""
    if gate is not None and not 0.0 < gate < 1.0:
        raise ValueError(f"gate must lie between 0 and 1, or be null, got {gate:g}")


def _shaped(constant: Array, like: Array) -> Array:
    """A constant covariance (m, m) with as many axes as another (n, n, *batch)."""
    return constant.reshape(*constant.shape, *(1,) * (like.ndim - 2))


def _without(missing: Array, cross: Array, innovation_cov: Array, innovation: Array) -> tuple[Array, Array, Array]:
    """The same update without the missing numbers (m, runs): they become independent of the state, with no
    innovation.

    Exactly the update with those rows removed, but with one shape for all runs.
    """
    return np.where(missing, 0.0, cross), without(innovation_cov, missing), np.where(missing, 0.0, innovation)
