"""What every filter answers."""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple, Protocol, Self

import numpy as np

from estlab.maths.gaussian import Gaussian
from estlab.maths.space import Array
from estlab.maths.streams import Draws
from estlab.maths.uniform import Uniform
from estlab.models.contract import Motion, Sensor

Prior = Gaussian | Uniform


class Fit(NamedTuple):
    """How a reading fitted.

    nis: (runs,) its normalised innovation squared. size: (runs,) the numbers in it. gated: (runs,) 1 where it
    was refused as an outlier; such a reading is in neither of the other two.
    """

    nis: Array
    size: Array
    gated: Array

    def add(self, runs: Array, other: "Fit") -> "Fit":
        """This fit and that of one more reading, which these of the runs had."""
        total = Fit(*(np.array(whole) for whole in self))
        for whole, part in zip(total, other, strict=True):
            whole[runs] += part
        return total


def no_fit(runs: int) -> Fit:
    """The fit of no reading."""
    return Fit(np.zeros(runs), np.zeros(runs, dtype=int), np.zeros(runs, dtype=int))


class Belief(Protocol):
    """What a filter carries for a batch of runs."""

    def of(self, runs: Array) -> Self:
        """The belief in some of the runs, by their place in the batch."""

    def put(self, runs: Array, part: Any) -> Self:
        """The belief with those of some runs replaced."""


class Filter(ABC):
    """A belief, carried from reading to reading. What a belief is, each family knows for itself."""

    def check(self, motion: Motion, sensor: Sensor) -> None:  # noqa: B027 - most have nothing to refuse
        """Raise ValueError, naming the key, if the filter is not defined for these models."""

    @abstractmethod
    def start(self, prior: Prior, draws: Draws) -> Any:
        """The belief before the first step. draws: the filter's own streams, one a run."""

    @abstractmethod
    def predict(self, motion: Motion, belief: Any, control: Array, dt: float) -> Any:
        """The belief dt [s] later."""

    @abstractmethod
    def update(self, sensor: Sensor, belief: Any, reading: Array, place: Array) -> tuple[Any, Fit]:
        """The belief given a reading (m, runs) about places (p, runs). A NaN in the reading was not measured."""

    @abstractmethod
    def moments(self, belief: Any, motion: Motion) -> Gaussian:
        """Mean (n, runs) and covariance (n, n, runs) of a belief."""

    def notes(self, belief: Any) -> dict[str, Array]:
        """Further numbers (runs,) to keep of each step, by name, such as the effective sample size."""
        return {}
