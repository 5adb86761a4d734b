"""Transforms by points: a few points, weighted so that they have the low moments of a Gaussian."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.linalg import cholesky, gram, lower_matmul, matmul, summed, transpose
from estlab.maths.space import Array
from estlab.maths.transforms import Function, Moments

# The smallest squared distance of points, in standard deviations. A point's image and the mean's are known to 2e-16
# of their size, and the mean is the sum of their differences over twice this square. If a state is a thousand
# standard deviations from zero, the mean is then off by a twentieth of one (measured on the field:
# docs/statistics.md).
_NEAREST2 = 1e3 * np.finfo(float).eps / 0.05
_HIGHEST_ORDER = 300  # of a Gauss-Hermite rule; from 380 on its weights overflow


class SigmaPoints(ABC):
    """Weighted points about the mean; a subclass defines their positions and weights.

    All moments are taken about the image of the mean, d_i = f(x_i) - f(mean). With weights w_i of the points and m =
    sum w_i d_i, the covariance  sum w_i (d_i - m)(d_i - m)'  is  sum w_i d_i d_i' - m m', whatever the centre's
    weight w_0 = 1 - sum w_i, because d_0 = 0. That weight, near -1e6 for the scaled points at alpha = 1e-3, never
    appears, and nothing cancels. Sets whose centre has another weight in the covariance give the difference as
    ``bonus``.
    """

    @abstractmethod
    def weights(self, n: int) -> Array:
        """The weight of each point, (p,), without the centre. Raises ValueError if n dimensions are not possible."""

    @abstractmethod
    def offsets(self, factor: Array) -> Array:
        """The points' offsets (n, p, *batch) from the mean, for the covariance's factor (n, n, *batch)."""

    def bonus(self) -> float:
        """The centre's weight in the covariance minus that in the mean."""
        return 0.0

    def check(self, n: int) -> None:
        """Raise ValueError that names the parameter if there is no such set in n dimensions."""
        self.weights(n)

    def __call__(self, function: Function, belief: Gaussian, crossed: bool = True) -> Moments:
        n, factor = belief.mean.shape[0], cholesky(belief.cov)
        middle, of_value = self.images(function, belief.mean, factor)
        weights = _weights(self, n, belief.mean.ndim - 1)
        if weights.size == 1:
            shift, cov = weights * summed(of_value, 1), weights * gram(of_value)
        else:
            shift, cov = summed(weights * of_value, 1), gram(of_value, weights=weights)
        cov += (self.bonus() - 1.0) * shift[:, None] * shift
        cross = self.cross(factor, weights, of_value) if crossed else np.empty((n, 0))
        return Moments(middle + shift, cov, cross)

    def images(self, function: Function, mean: Array, factor: Array) -> tuple[Array, Array]:
        """The image of the mean (m, *batch), and of the points as offsets from it (m, p, *batch)."""
        images = function.evaluate(self.points(mean, factor))
        return images[:, 0], function.space.minus(images[:, 1:], images[:, :1])

    def points(self, mean: Array, factor: Array) -> Array:
        """The mean, then the points: (n, 1 + p, *batch)."""
        middle = mean[:, None]
        return np.concatenate([middle, middle + self.offsets(factor)], axis=1)

    def cross(self, factor: Array, weights: Array, of_value: Array) -> Array:
        """The cross-covariance (n, m, *batch) of argument and value, by weights (p, ...) or one for all."""
        return gram(self.offsets(factor), weights * of_value)


class SymmetricSigmaPoints(SigmaPoints):
    """Two points on each axis of the covariance, all of equal weight."""

    @abstractmethod
    def spread2(self, n: int) -> float:
        """The squared distance of the points, in standard deviations; n + lambda in the usual notation."""

    def check(self, n: int) -> None:
        if self.spread2(n) < _NEAREST2:
            raise ValueError(
                f"{self.width} puts the points {np.sqrt(self.spread2(n)):.2g} standard deviations from the mean "
                f"of {n} dimensions, where rounding errors dominate; raise it so that they lie at least "
                f"{np.sqrt(_NEAREST2):.2g} away"
            )
        super().check(n)

    width = "their spread"  # the key that determines it

    def weights(self, n: int) -> Array:
        return np.full(2 * n, 0.5 / self.spread2(n))

    def offsets(self, factor: Array) -> Array:
        outward = np.sqrt(self.spread2(factor.shape[0])) * factor
        return np.concatenate([outward, -outward], axis=1)

    def points(self, mean: Array, factor: Array) -> Array:
        n = mean.shape[0]
        outward = np.sqrt(self.spread2(n)) * factor
        points = np.empty((n, 2 * n + 1, *mean.shape[1:]))
        points[:, 0] = mean
        np.add(mean[:, None], outward, out=points[:, 1 : n + 1])
        np.subtract(mean[:, None], outward, out=points[:, n + 1 :])
        return points

    def cross(self, factor: Array, weights: Array, of_value: Array) -> Array:
        """For points opposite each other: the sum over the axes of L times the difference of their values."""
        n = factor.shape[0]
        difference = of_value[:, :n] - of_value[:, n:]
        return (weights * np.sqrt(self.spread2(n))) * lower_matmul(factor, transpose(difference))


@dataclass(frozen=True)
class Scaled(SymmetricSigmaPoints):
    """The scaled unscented transform. Van der Merwe 2004, section 3.2.2; Julier 2002.

    n + lambda = alpha^2 (n + kappa). alpha = 1 by default: at 1e-3, the value in many texts, the points lie so close
    together that correct implementations differ in the second digit on strongly nonlinear problems.

    alpha: > 0, the spread of the points. beta: >= 0, 2 for Gaussians. kappa: > -n, usually 0 or 3 - n.
    Raises ValueError outside these ranges; n is known only when the transform meets a belief.
    """

    alpha: float
    beta: float
    kappa: float

    width = "alpha"

    def __post_init__(self) -> None:
        if not self.alpha > 0.0:
            raise ValueError(f"alpha must be > 0, got {self.alpha:g}")
        if not 1e-8 <= self.alpha <= 1e8:
            raise ValueError(
                f"alpha must be from 1e-8 to 1e8, got {self.alpha:g}: rounding errors dominate closer or farther points"
            )
        if not 0.0 <= self.beta <= 1e8:
            raise ValueError(f"beta must be >= 0 and at most 1e8, got {self.beta:g}")

    def spread2(self, n: int) -> float:
        return _beyond(self.kappa, n) * self.alpha**2

    def bonus(self) -> float:
        return 1.0 - self.alpha**2 + self.beta


@dataclass(frozen=True)
class Julier(SymmetricSigmaPoints):
    """The first unscented transform, n + kappa wide. Julier and Uhlmann 1997."""

    kappa: float

    width = "kappa"

    def spread2(self, n: int) -> float:
        return _beyond(self.kappa, n)


class Cubature(SymmetricSigmaPoints):
    """The third-degree spherical-radial cubature rule. Arasaratnam and Haykin 2009, section IV."""

    def spread2(self, n: int) -> float:
        return float(n)


class Simplex(SigmaPoints):
    """n + 1 points of equal weight, the corners of a regular simplex. Moireau and Chapelle 2011, section 3.2."""

    def weights(self, n: int) -> Array:
        return np.full(n + 1, 1.0 / (n + 1))

    def offsets(self, factor: Array) -> Array:
        return matmul(factor, _simplex(factor.shape[0]))


@dataclass(frozen=True)
class GaussHermite(SigmaPoints):
    """Product Gauss-Hermite rule, exact for polynomials up to degree 2 order - 1 along each axis. Ito and Xiong 2000.

    order: from 2 to 300; order ** n points, at most 20,000. Raises ValueError outside these ranges.
    """

    order: int

    def __post_init__(self) -> None:
        if not 2 <= self.order <= _HIGHEST_ORDER:
            raise ValueError(
                f"order must be from 2 to {_HIGHEST_ORDER}, got {self.order}: weights overflow beyond that"
            )

    def weights(self, n: int) -> Array:
        if self.order**n > 20_000:
            fewer = "lower it, or set noise=additive" if 2**n <= 20_000 else "use another filter, such as ckf"
            raise ValueError(
                f"order = {self.order} makes {self.order**n:.4g} points in {n} dimensions, more than 20000; {fewer}"
            )
        return _product_rule(self.order, n)[1]

    def offsets(self, factor: Array) -> Array:
        return matmul(factor, _product_rule(self.order, factor.shape[0])[0])


@lru_cache
def _weights(points: SigmaPoints, n: int, axes: int) -> Array:
    """The weight of each point (p, 1, ...), with enough batch axes; a single number if all are equal."""
    weights = points.weights(n)
    return weights[0] if (weights == weights[0]).all() else weights.reshape(-1, *(1,) * axes)


def _beyond(kappa: float, n: int) -> float:
    if kappa > 1e8:
        raise ValueError(f"kappa must be at most 1e8, got {kappa:g}")
    if not n + kappa > 0.0:
        raise ValueError(f"kappa must be > -n = {-n} for {n} dimensions, got {kappa:g}")
    return n + kappa


@lru_cache
def _simplex(n: int) -> Array:
    """Corners (n, n + 1) with mean zero and, with equal weights, covariance one."""
    corners = np.zeros((n, n + 1))
    for i in range(n):
        # Axis i separates corner i + 1 from the earlier ones, which stay together.
        corners[i, : i + 1] = -1.0
        corners[i, i + 1] = i + 1.0
        corners[i] /= np.sqrt((i + 1.0) * (i + 2.0) / (n + 1.0))
    return corners


@lru_cache
def _product_rule(order: int, n: int) -> tuple[Array, Array]:
    """Points (n, order ** n) and weights for the standard normal in n dimensions."""
    points, weights = np.polynomial.hermite_e.hermegauss(order)
    weights = weights / weights.sum()
    grid = np.stack(np.meshgrid(*[points] * n, indexing="ij")).reshape(n, -1)
    product = np.prod(np.stack(np.meshgrid(*[weights] * n, indexing="ij")).reshape(n, -1), axis=0)
    return grid, product
