"""A Gaussian belief through a nonlinear function: mean, covariance and cross-covariance of what comes out.

This is all in which the members of the Gaussian filter family differ.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from estlab.maths.derivatives import jacobian
from estlab.maths.gaussian import Gaussian
from estlab.maths.linalg import cholesky, gram, matmul, symmetric, transpose
from estlab.maths.space import Array, Space


@dataclass(frozen=True)
class Function:
    """A model with everything but its argument fixed.

    evaluate: (n, p, *batch) -> (m, p, *batch), any number of points at once.
    space: of the values. jacobian: (n, *batch) -> (m, n, *batch), or None for differences.
    """

    evaluate: Callable[[Array], Array]
    space: Space
    jacobian: Callable[[Array], Array] | None = None


class Moments(NamedTuple):
    """Mean (m, *batch), covariance (m, m, *batch) and cross-covariance with the argument (n, m, *batch)."""

    mean: Array
    cov: Array
    cross: Array


@runtime_checkable
class Transform(Protocol):
    """A belief through a function."""

    def check(self, n: int) -> None:
        """Raise ValueError, naming the parameter, if the transform is not defined in n dimensions."""

    def __call__(self, function: Function, belief: Gaussian) -> Moments: ...


class Linearised:
    """First-order Taylor expansion about the mean. Jazwinski 1970, section 8.3."""

    def check(self, n: int) -> None:
        """Defined in any dimension."""

    def __call__(self, function: Function, belief: Gaussian) -> Moments:
        if function.jacobian is None:
            slope = jacobian(function.evaluate, belief.mean, function.space)
        else:
            slope = function.jacobian(belief.mean)
        cross = matmul(belief.cov, transpose(slope))
        mean = function.evaluate(belief.mean[:, None])[:, 0]
        return Moments(mean, symmetric(matmul(slope, cross)), cross)


class SymmetricSigmaPoints(ABC):
    """2 n + 1 points: the mean, and one standard deviation times ``spread`` to each side of it along each axis.

    A subclass says how wide the points lie and how much the centre counts; see ``spread2`` and ``centre``.
    """

    @abstractmethod
    def spread2(self, n: int) -> float:
        """The squared distance of the outer points, in standard deviations; n + lambda in the usual notation."""

    def centre(self, n: int) -> float:
        """The sum of the covariance weights less 2: what multiplies the squared shift of the mean."""
        return -1.0

    def check(self, n: int) -> None:
        """Raise ValueError, naming the parameter, if the outer points fall on the mean or cannot be placed."""
        self.spread2(n)

    def __call__(self, function: Function, belief: Gaussian) -> Moments:
        # Everything is taken about the image of the mean, d_i = f(x_i) - f(x_0). With the outer weights w and
        # m = w sum d_i, the covariance  sum wc_i (d_i - m)(d_i - m)'  is  w sum d_i d_i' + (sum wc - 2) m m'.
        # The centre's weight, near -1e6 at alpha = 1e-3, never appears, and nothing cancels.
        n = belief.mean.shape[0]
        spread2 = self.spread2(n)
        weight = 0.5 / spread2
        offsets = np.sqrt(spread2) * cholesky(belief.cov)
        middle = belief.mean[:, None]
        images = function.evaluate(np.concatenate([middle, middle + offsets, middle - offsets], axis=1))
        steps = function.space.minus(images[:, 1:], images[:, :1])
        shift = weight * steps.sum(axis=1)
        cov = weight * gram(steps) + self.centre(n) * gram(shift[:, None])
        cross = weight * gram(offsets, steps[:, :n] - steps[:, n:])
        return Moments(function.space.plus(images[:, 0], shift), symmetric(cov), cross)


@dataclass(frozen=True)
class Unscented(SymmetricSigmaPoints):
    """The scaled unscented transform. Van der Merwe 2004, section 3.2.2; Julier 2002.

    n + lambda = alpha^2 (n + kappa). alpha = 1 by default: at 1e-3, the value of many texts, the points lie so
    close together that correct implementations differ in the second digit on strongly nonlinear problems.

    alpha: > 0, how wide the points lie. beta: >= 0, 2 for Gaussians. kappa: > -n, 0 or 3 - n usually.
    Raises ValueError outside these ranges; n is known only once the transform meets a belief.
    """

    alpha: float
    beta: float
    kappa: float

    def __post_init__(self) -> None:
        if not self.alpha > 0.0:
            raise ValueError(f"alpha must be > 0, got {self.alpha:g}")
        if not self.beta >= 0.0:
            raise ValueError(f"beta must be >= 0, got {self.beta:g}")

    def spread2(self, n: int) -> float:
        if not n + self.kappa > 0.0:
            raise ValueError(f"kappa must be > -n = {-n} for {n} dimensions, got {self.kappa:g}")
        return self.alpha**2 * (n + self.kappa)

    def centre(self, n: int) -> float:
        return self.beta - self.alpha**2


@dataclass(frozen=True)
class Cubature(SymmetricSigmaPoints):
    """The third-degree spherical-radial cubature rule. Arasaratnam and Haykin 2009, section IV."""

    def spread2(self, n: int) -> float:
        return float(n)
