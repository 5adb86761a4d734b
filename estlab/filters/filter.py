"""The contract of every filter."""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple, Protocol, Self

import numpy as np

from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.linalg import summed
from estlab.maths.space import Array
from estlab.maths.streams import Generators
from estlab.maths.uniform import Uniform
from estlab.models.contract import Motion, Sensor

Prior = Gaussian | Uniform


class Innovation(NamedTuple):
    """How far a reading lies from its prediction, in units of what the filter expects.

    whitened: (m, runs) the innovation divided by the lower factor of its covariance: independent standard normals if
    the filter's assumptions hold; their squares sum to the NIS. NaN where nothing was measured or the reading was
    gated.
    log_scale: (m, runs) the logarithm of that factor's diagonal, which sums to half the log-determinant; NaN
    likewise.
    gated: (runs,) whether the reading was rejected as an outlier.
    """

    whitened: Array
    log_scale: Array
    gated: Array


class Sample(NamedTuple):
    """Describes a sample covariance: (runs,) the number of states, and the factor between it and the unbiased
    covariance.
    """

    size: Array
    scale: Array


class Cloud(NamedTuple):
    """A sample of the points of a belief: points (n, S, runs), weights (S, runs) that sum to one."""

    points: Array
    weights: Array


def innovation_of(whitened: Array, factor: Array, missing: Array, gate: float | None) -> Innovation:
    """The innovation of a reading, whitened, and the factor (m, m, runs) that whitened it.

    missing: (m, runs) the parts of the reading that were not measured.
    gate: the share of correct readings that pass; a reading whose NIS exceeds that quantile is rejected. None lets
    all pass. Bar-Shalom, Li and Kirubarajan 2001, section 10.4.
    """
    every = range(whitened.shape[0])
    log_scale = np.log(factor[every, every])
    if gate is None:
        refused, unused = np.zeros(whitened.shape[1:], dtype=bool), missing
    else:
        nis = summed(whitened * whitened, 0)
        refused = np.asarray(nis > chi_square_quantile(gate, (~missing).sum(axis=0)))
        unused = missing | refused
    if unused.any():
        whitened, log_scale = np.where(unused, np.nan, whitened), np.where(unused, np.nan, log_scale)
    return Innovation(whitened, log_scale, refused)


def chi_square_quantile(share: float, freedom: Array) -> Array:
    """The quantile of a chi-square with these degrees of freedom at this probability; infinite for no freedom."""
    from scipy.special import gammaincinv

    return np.where(freedom > 0, 2.0 * gammaincinv(0.5 * np.maximum(freedom, 1), share), np.inf)


class Belief(Protocol):
    """What a filter carries for a batch of runs."""

    def take(self, runs: Array) -> Self:
        """The belief in some of the runs, by their index in the batch."""

    def replaced(self, runs: Array, part: Any) -> Self:
        """The belief with those of some runs replaced."""


class Filter(ABC):
    """A belief, carried from reading to reading. Each family defines its own kind of belief."""

    def check(self, motion: Motion, sensor: Sensor) -> None:  # noqa: B027 - most have nothing to refuse
        """Raise ValueError that names the key if the filter is not defined for these models."""

    @abstractmethod
    def start(self, prior: Prior, generators: Generators) -> Any:
        """The belief before the first step. generators: the filter's own, one per run."""

    @abstractmethod
    def predict(self, motion: Motion, belief: Any, control: Array, dt: float) -> Any:
        """The belief dt [s] later."""

    @abstractmethod
    def update(self, sensor: Sensor, belief: Any, reading: Array, landmark: Array) -> tuple[Any, Innovation]:
        """The belief given a reading (m, runs) about landmarks (p, runs). NaN in the reading means not measured."""

    @abstractmethod
    def moments(self, belief: Any, motion: Motion) -> Gaussian:
        """Mean (n, runs) and covariance (n, n, runs) of a belief."""

    def sample(self, belief: Any) -> Sample | None:
        """The sample whose covariance :meth:`moments` returns; None if the covariance is computed, not sampled."""
        return None

    def cloud(self, belief: Any, runs: int) -> Cloud | None:
        """A sample of the points of the first runs; None if a belief is no cloud."""
        return None

    def notes(self, belief: Any) -> dict[str, Array]:
        """Further numbers (runs,) to store for each step, by name, such as the effective sample size."""
        return {}
