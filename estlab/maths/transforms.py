"""A Gaussian belief through a nonlinear function: mean, covariance and cross-covariance of what comes out.

This is all in which the members of the Gaussian filter family differ. Transforms by points are in sigma_points.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np

from estlab.maths.derivatives import hessian, jacobian
from estlab.maths.gaussian import Gaussian
from estlab.maths.linalg import matmul, symmetric, transpose
from estlab.maths.space import Array, Space


@dataclass(frozen=True)
class Function:
    """A model with everything but its argument fixed.

    evaluate: (n, p, *batch) -> (m, p, *batch), any number of points at once. space: of the values.
    jacobian: (n, *batch) -> (m, n, *batch); hessian: (n, *batch) -> (m, n, n, *batch); None for differences.
    """

    evaluate: Callable[[Array], Array]
    space: Space
    jacobian: Callable[[Array], Array] | None = None
    hessian: Callable[[Array], Array] | None = None

    def slope(self, at: Array) -> Array:
        """The Jacobian (m, n, *batch), stated or by differences."""
        return jacobian(self.evaluate, at, self.space) if self.jacobian is None else self.jacobian(at)

    def curvature(self, at: Array) -> Array:
        """The Hessians (m, n, n, *batch), stated or by differences."""
        return hessian(self.evaluate, at, self.space) if self.hessian is None else self.hessian(at)

    def at(self, point: Array) -> Array:
        """The value (m, *batch) at one point (n, *batch)."""
        return self.evaluate(point[:, None])[:, 0]


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
        return self.about(function, belief, belief.mean, np.zeros_like(belief.mean))

    def about(self, function: Function, belief: Gaussian, at: Array, offset: Array) -> Moments:
        """Expansion about another point (n, *batch), from which the mean lies at this offset (n, *batch)."""
        slope = function.slope(at)
        cross = matmul(belief.cov, transpose(slope))
        shift = np.einsum("ij...,j...->i...", slope, offset)
        return Moments(function.space.plus(function.at(at), shift), symmetric(matmul(slope, cross)), cross)


@dataclass(frozen=True)
class SecondOrder:
    """Second-order Taylor expansion about the mean.

    The mean gains b_i = tr(H_i P) / 2. ``gaussian`` adds tr(H_i P H_j P) / 2 to the covariance, exact for a quadratic
    function of a Gaussian (Bar-Shalom, Li and Kirubarajan 2001, section 10.3.2); ``modified`` leaves the covariance as
    linearised, as the document 004 prints it (but for its factor 1/2, which is there twice).
    """

    form: Literal["gaussian", "modified"]

    def check(self, n: int) -> None:
        """Defined in any dimension."""

    def __call__(self, function: Function, belief: Gaussian) -> Moments:
        mean, cov, cross = Linearised()(function, belief)
        bent = np.einsum("aij...,jk...->aik...", function.curvature(belief.mean), belief.cov)
        bias = 0.5 * np.einsum("aii...->a...", bent)
        if self.form == "gaussian":
            cov = cov + 0.5 * symmetric(np.einsum("aij...,bji...->ab...", bent, bent))
        return Moments(function.space.plus(mean, bias), cov, cross)
