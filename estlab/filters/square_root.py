"""Sigma-point filters that carry a factor of the covariance, so that it cannot lose its sign."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estlab.filters.filter import Filter, Innovation, Prior, Traits, innovation_of
from estlab.filters.gaussian import check_gate
from estlab.maths.gaussian_belief import Gaussian, replaced
from estlab.maths.linalg import (
    cholesky,
    gram,
    matmul,
    matvec,
    solve_lower,
    solve_lower_transposed,
    summed,
    transpose,
    without,
)
from estlab.maths.sigma_points import Cubature, Scaled, SigmaPoints
from estlab.maths.space import Array
from estlab.maths.streams import Generators
from estlab.maths.transforms import Function
from estlab.models.contract import Motion, Sensor


class Root(NamedTuple):
    """Mean (n, runs) and lower factor (n, n, runs) of the covariance."""

    mean: Array
    factor: Array

    def take(self, runs: Array) -> "Root":
        """The belief in some of the runs."""
        return Root(self.mean[..., runs], self.factor[..., runs])

    def replaced(self, runs: Array, part: "Root") -> "Root":
        """The belief with those of some runs replaced."""
        return Root(replaced(self.mean, runs, part.mean), replaced(self.factor, runs, part.factor))


@dataclass(frozen=True)
class SquareRootFilter(Filter[Root]):
    """The additive-noise sigma-point filter on factors: every covariance is the triangle of a QR decomposition.

    Van der Merwe and Wan 2001; Arasaratnam and Haykin 2009, appendix B. Nothing is ever subtracted, so weights must
    not be negative. transform: the points. gate: as in GaussianFilter.
    """

    transform: SigmaPoints
    gate: float | None

    def __post_init__(self) -> None:
        check_gate(self.gate)

    @property
    def traits(self) -> Traits:
        return Traits(gate=self.gate)

    def check(self, motion: Motion, sensor: Sensor) -> None:
        n = motion.space.size
        self.transform.check(n)
        centre = 1.0 - self.transform.weights(n).sum()
        if self.transform.weights(n).min() < 0.0 or centre + self.transform.bonus() < -1e-12:
            raise ValueError(
                "alpha, beta and kappa give a point a negative weight, which has no square root; raise alpha or beta"
            )

    def start(self, prior: Prior, generators: Generators) -> Root:
        mean, cov = prior.fitted()
        n, runs = mean.shape
        return Root(mean, np.broadcast_to(cholesky(cov).reshape(n, n, -1), (n, n, runs)))

    def predict(self, motion: Motion, belief: Root, control: Array, dt: float) -> Root:
        mean, _, of_value = self._deviations(motion.function(control, dt), belief)
        noise = matmul(motion.noise_jacobian(belief.mean, control, dt), cholesky(motion.noise_cov(control, dt)))
        return Root(motion.space.wrapped(mean), triangle(np.concatenate([of_value, noise], axis=1)))

    def update(self, sensor: Sensor, belief: Root, reading: Array, landmark: Array) -> tuple[Root, Innovation]:
        mean, of_state, of_value = self._deviations(sensor.function(landmark), belief)
        m, runs = reading.shape
        missing = np.isnan(reading)
        # A missing number gets no deviation and unit noise: it is independent of the state.
        of_value = np.where(missing[:, None], 0.0, of_value)
        noise = np.broadcast_to(cholesky(without(sensor.noise_cov, missing)), (m, m, runs))
        innovation = np.where(missing, 0.0, sensor.space.minus(reading, mean))
        factor = triangle(np.concatenate([of_value, noise], axis=1))
        whitened = solve_lower(factor, innovation[:, None])[:, 0]
        kalman_gain = transpose(solve_lower_transposed(factor, solve_lower(factor, gram(of_value, of_state))))
        found = innovation_of(whitened, factor, missing, self.gate)
        kalman_gain = np.where(found.gated, 0.0, kalman_gain)
        step = matvec(kalman_gain, innovation)
        # (X - K Z)(X - K Z)' + K R K' is the covariance of the update, a sum of squares.
        rest = triangle(np.concatenate([of_state - matmul(kalman_gain, of_value), matmul(kalman_gain, noise)], axis=1))
        updated = Root(sensor.state.plus(belief.mean, step), np.where(found.gated, belief.factor, rest))
        return updated, found

    def moments(self, belief: Root, motion: Motion) -> Gaussian:
        return Gaussian(belief.mean, gram(belief.factor))

    def _deviations(self, function: Function, belief: Root) -> tuple[Array, Array, Array]:
        """Mean of the value, and columns X (n, p, runs), Z (m, p, runs) with cov = Z Z' and cross = X Z'."""
        middle, of_value = self.transform.images(function, belief.mean, belief.factor)
        of_state = self.transform.offsets(belief.factor)
        weights = self.transform.weights(belief.mean.shape[0]).reshape(-1, 1)
        shift = summed(weights * of_value, 1)
        root = np.sqrt(weights)
        # The centre's column: it does not move in the state, and lies at -shift from the mean.
        centre = np.sqrt(max(1.0 - float(weights.sum()) + self.transform.bonus(), 0.0))
        still = np.zeros_like(of_state[:, :1])
        columns = np.concatenate([root * (of_value - shift[:, None]), -centre * shift[:, None]], axis=1)
        return function.space.plus(middle, shift), np.concatenate([root * of_state, still], axis=1), columns


def triangle(columns: Array) -> Array:
    """The lower triangular L (n, n, runs) with L L' = A A', for A (n, p, runs), p >= n; NaN where A is not finite."""
    sound = np.isfinite(columns).all(axis=(0, 1))
    tall = np.moveaxis(np.where(sound, columns, 0.0), -1, 0).swapaxes(1, 2)
    upper = np.asarray(np.linalg.qr(tall, mode="r"))
    lower = np.moveaxis(upper.swapaxes(1, 2), 0, -1)
    signs = np.where(lower.diagonal().T < 0.0, -1.0, 1.0)
    return np.where(sound, lower * signs[None], np.nan)


def square_root_unscented(alpha: float, beta: float, kappa: float, gate: float | None) -> SquareRootFilter:
    """The square-root unscented Kalman filter. Van der Merwe and Wan 2001."""
    return SquareRootFilter(Scaled(alpha, beta, kappa), gate)


def square_root_cubature(gate: float | None) -> SquareRootFilter:
    """The square-root cubature Kalman filter. Arasaratnam and Haykin 2009, appendix B."""
    return SquareRootFilter(Cubature(), gate)
