"""A Gaussian belief through a nonlinear function: mean, covariance and cross-covariance of the result.

The members of the Gaussian filter family differ only in this. Transforms by points are in sigma_points.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np

from estlab.earlier_names import renamed
from estlab.maths.finite_differences import hessian, jacobian
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.linalg import gram, matmul, matvec, summed, symmetric, transpose
from estlab.maths.space import Array, Space
from estlab.maths.stacking import Rows, matrix, through


@renamed(slope="jacobian", slope_rows="jacobian_rows", curvature="hessians")
@dataclass(frozen=True)
class Function:
    """A model with everything fixed except its argument.

    evaluate: (n, *batch) -> (m, *batch), where the batch may have a first axis of points. space: of the values.
    stated_jacobian: (n, *batch) -> m rows of n components; stated_hessians: (n, *batch) -> (m, n, n, *batch); None:
    by differences.
    """

    evaluate: Callable[[Array], Array]
    space: Space
    stated_jacobian: Callable[[Array], Rows] | None = None
    stated_hessians: Callable[[Array], Array] | None = None

    def jacobian(self, at: Array) -> Array:
        """The Jacobian (m, n, *batch), stated or by differences."""
        rows = self.jacobian_rows(at)
        return rows if isinstance(rows, np.ndarray) else matrix(rows, at.shape[1:])

    def jacobian_rows(self, at: Array) -> Rows:
        """Rows of the Jacobian, stated or by differences."""
        return jacobian(self.evaluate, at, self.space) if self.stated_jacobian is None else self.stated_jacobian(at)

    def hessians(self, at: Array) -> Array:
        """The Hessians (m, n, n, *batch), stated or by differences."""
        return hessian(self.evaluate, at, self.space) if self.stated_hessians is None else self.stated_hessians(at)


class Moments(NamedTuple):
    """Mean (m, *batch), covariance (m, m, *batch) and cross-covariance with the argument (n, m, *batch) or empty.

    Angles in the mean are not wrapped to [-pi, pi].
    """

    mean: Array
    cov: Array
    cross: Array


@runtime_checkable
class Transform(Protocol):
    """A belief through a function. crossed: whether the cross-covariance is needed; it may be empty if not."""

    def check(self, n: int) -> None:
        """Raise ValueError that names the parameter if the transform is not defined in n dimensions."""

    def __call__(self, function: Function, belief: Gaussian, crossed: bool = True) -> Moments: ...


class Linearised:
    """First-order Taylor expansion about the mean. Jazwinski 1970, section 8.3."""

    def check(self, n: int) -> None:
        """Defined in any dimension."""

    def __call__(self, function: Function, belief: Gaussian, crossed: bool = True) -> Moments:
        return self.about(function, belief, belief.mean, None)

    def about(self, function: Function, belief: Gaussian, at: Array, offset: Array | None) -> Moments:
        """Expansion about a point (n, *batch). offset: of the mean from the point (n, *batch), or none."""
        jacobian, batch = function.jacobian_rows(at), at.shape[1:]
        jacobian_cov, cov = through(jacobian, belief.cov, batch)  # F P, F P F'
        mean = function.evaluate(at)
        if offset is not None:
            mean = mean + matvec(matrix(jacobian, batch), offset)
        return Moments(mean, cov, transpose(np.array(jacobian_cov)))


@dataclass(frozen=True)
class SecondOrder:
    """Second-order Taylor expansion about the mean.

    The mean gains b_i = tr(H_i P) / 2. ``gaussian`` adds tr(H_i P H_j P) / 2 to the covariance, exact for a quadratic
    function of a Gaussian (Bar-Shalom, Li and Kirubarajan 2001, section 10.3.2). ``modified`` leaves the covariance
    linearised, as document 004 prints it (except for its factor 1/2, which appears twice there).
    """

    form: Literal["gaussian", "modified"]

    def check(self, n: int) -> None:
        """Defined in any dimension."""

    def __call__(self, function: Function, belief: Gaussian, crossed: bool = True) -> Moments:
        mean, cov, cross = Linearised()(function, belief)
        m, n = mean.shape[0], belief.mean.shape[0]
        products = np.stack([matmul(part, belief.cov) for part in function.hessians(belief.mean)])  # H_i P
        bias = 0.5 * summed(np.stack([products[:, i, i] for i in range(n)], axis=1), 1)
        if self.form == "gaussian":
            # tr(H_i P H_j P) is the sum of the entries of H_i P times those of (H_j P)'.
            flat = products.reshape(m, n * n, *mean.shape[1:])
            transposed = products.swapaxes(1, 2).reshape(m, n * n, *mean.shape[1:])
            cov = cov + 0.5 * symmetric(gram(flat, transposed))
        return Moments(mean + bias, cov, cross)
