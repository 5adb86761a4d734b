"""The contract of every filter."""

from abc import ABC, abstractmethod
from typing import Any, Generic, NamedTuple, Protocol, Self, TypeVar

import numpy as np

from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.linalg import summed
from estlab.maths.space import Array
from estlab.maths.streams import Generators
from estlab.maths.transforms import Moments
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
    """A sample covariance: (runs,) the number of states, and the factor between it and the unbiased covariance."""

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

    def replaced(self, runs: Array, part: Self) -> Self:
        """The belief with those of some runs replaced."""


class Traits(NamedTuple):
    """What a filter says of itself, for those who run it and judge it.

    points: how many points stand for the belief of a run, by which runs are cut into blocks. sampled_by: the filter's
    key for their number, if a belief's covariance is that of a sample; else "". gate: the share of right readings that
    pass, None for all. reads: whether readings are used. smooths: whether it has :meth:`Filter.propagate`.
    single: whether its belief is a Gaussian and its steps take one without the axis of runs too.
    """

    points: int = 1
    sampled_by: str = ""
    gate: float | None = None
    reads: bool = True
    smooths: bool = False
    single: bool = False


B = TypeVar("B", bound=Belief)


class Filter(ABC, Generic[B]):
    """A belief B, carried from reading to reading. What a belief is, each family knows for itself."""

    @property
    def traits(self) -> Traits:
        """What it says of itself."""
        return Traits()

    def check(self, motion: Motion, sensor: Sensor) -> None:
        """Raise ValueError that names the key if the filter is not defined for these models."""

    @abstractmethod
    def start(self, prior: Prior, generators: Generators) -> B:
        """The belief before the first step. generators: the filter's own, one per run."""

    @abstractmethod
    def predict(self, motion: Motion, belief: B, control: Array, dt: float) -> B:
        """The belief dt [s] later."""

    def propagate(self, motion: Motion, belief: B, control: Array, dt: float) -> Moments:
        """A Gaussian prediction with its cross-covariance to the state before, which a smoother needs.

        Raises TypeError unless ``traits.smooths``.
        """
        raise TypeError(f"{type(self).__name__} does not smooth")

    @abstractmethod
    def update(self, sensor: Sensor, belief: B, reading: Array, landmark: Array) -> tuple[B, Innovation]:
        """The belief given a reading (m, runs) about landmarks (p, runs). NaN in the reading means not measured."""

    @abstractmethod
    def moments(self, belief: B, motion: Motion) -> Gaussian:
        """Mean (n, runs) and covariance (n, n, runs) of a belief."""

    def sample(self, belief: B) -> Sample | None:
        """The sample whose covariance :meth:`moments` returns; None if the covariance is computed, not sampled."""
        return None

    def cloud(self, belief: B, runs: int) -> Cloud | None:
        """A sample of the points of the first runs; None if a belief is no cloud."""
        return None

    def notes(self, belief: B) -> dict[str, Array]:
        """Further numbers (runs,) to store for each step, by name, such as the effective sample size."""
        return {}


AnyFilter = Filter[Any]


def check_traits(filter: AnyFilter) -> None:
    """Raise ValueError, naming the field, unless a filter says of itself what can be."""
    traits: object = filter.traits
    if not isinstance(traits, Traits):
        raise ValueError(f"traits is a {type(traits).__name__}; must be a Traits")
    if not isinstance(traits.points, int) or traits.points < 1:
        raise ValueError(f"traits.points is {traits.points!r}; must be a whole number >= 1")
    if traits.smooths and type(filter).propagate is Filter.propagate:
        raise ValueError("traits.smooths is true, so the filter must define propagate")
