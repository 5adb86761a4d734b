"""The ensemble Kalman filter: a belief as a few dozen states, moved individually and corrected together."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estlab.filters.filter import Filter, Innovation, Prior, Sample, Traits, innovation_of
from estlab.filters.step import Step
from estlab.maths import cloud
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.linalg import cholesky, matmul, solve_lower, transpose, without
from estlab.maths.space import Array, Space
from estlab.maths.streams import Generators
from estlab.models.contract import Motion, Sensor


class Members(NamedTuple):
    """Members (n, members, runs), and the generators of their perturbations."""

    points: Array
    generators: Generators

    def take(self, runs: Array) -> "Members":
        """The belief in some of the runs."""
        return Members(cloud.take(self.points, runs), self.generators.take(runs))

    def replaced(self, runs: Array, part: "Members") -> "Members":
        """The belief with those of some runs replaced."""
        return Members(cloud.replaced(self.points, runs, part.points), self.generators)


@dataclass(frozen=True)
class EnsembleFilter(Filter[Members]):
    """The stochastic ensemble Kalman filter, with perturbed readings. Burgers, van Leeuwen and Evensen 1998.

    members: >= 2, and more than the number of components of the state for a definite covariance.
    inflation: >= 1, the factor by which members spread about their mean after each prediction.
    """

    members: int
    inflation: float

    def __post_init__(self) -> None:
        if not 2 <= self.members <= 20_000_000:
            raise ValueError(f"members must be from 2 to 2e7, got {self.members}")
        if not self.inflation >= 1.0:
            raise ValueError(f"inflation must be >= 1, got {self.inflation:g}")

    @property
    def traits(self) -> Traits:
        return Traits(points=self.members, sampled_by="members")

    def check(self, motion: Motion, sensor: Sensor) -> None:
        if self.members <= motion.space.size:
            raise ValueError(f"members must be > {motion.space.size}, the size of the state, got {self.members}")

    def start(self, prior: Prior, generators: Generators) -> Members:
        return Members(cloud.laid_out(prior.sample(generators, self.members)), generators)

    def predict(self, motion: Motion, belief: Members, control: Array, dt: float) -> Members:
        points = Step.drawn(motion, belief.points, control, dt, belief.generators).points()
        if self.inflation > 1.0:
            mean = _mean(motion.space, points)[:, None]
            points = motion.space.plus(mean, self.inflation * motion.space.minus(points, mean))
        return Members(points, belief.generators)

    def update(self, sensor: Sensor, belief: Members, reading: Array, landmark: Array) -> tuple[Members, Innovation]:
        m = sensor.space.size
        expected = cloud.laid_out(sensor.read(belief.points, landmark))
        mean = _mean(sensor.space, expected)
        of_value = sensor.space.minus(expected, mean[:, None])
        of_state = sensor.state.minus(belief.points, _mean(sensor.state, belief.points)[:, None])
        blur = cloud.combined(cholesky(sensor.noise_cov)[..., None], belief.generators.normals((m, self.members)))
        missing = np.isnan(reading)
        innovation, each = sensor.space.minus(reading, mean), sensor.space.minus(reading[:, None] + blur, expected)
        if missing.any():
            innovation = np.where(missing, 0.0, innovation)
            of_value, each = (np.where(missing[:, None], 0.0, values) for values in (of_value, each))
        factor = cholesky(cloud.gram(of_value, of_value) / (self.members - 1) + without(sensor.noise_cov, missing))
        whitening = solve_lower(factor, np.broadcast_to(np.eye(m)[..., None], factor.shape))
        cross = cloud.gram(of_state, of_value) / (self.members - 1)
        kalman_gain = matmul(matmul(cross, transpose(whitening)), whitening)
        points = sensor.state.plus(belief.points, cloud.combined(kalman_gain, each))
        whitened = solve_lower(factor, innovation[:, None])[:, 0]
        return Members(points, belief.generators), innovation_of(whitened, factor, missing, None)

    def moments(self, belief: Members, motion: Motion) -> Gaussian:
        even = cloud.even(self.members, belief.points.shape[2], 1.0 / self.members)
        mean, cov = cloud.moments(motion.space, belief.points, even)
        return Gaussian(mean, cov * (self.members / (self.members - 1)))

    def sample(self, belief: Members) -> Sample:
        runs = belief.points.shape[2]
        return Sample(np.full(runs, float(self.members)), np.ones(runs))


def _mean(space: Space, members: Array) -> Array:
    count, runs = members.shape[1:]
    return cloud.mean(space, members, cloud.even(count, runs, 1.0 / count))
