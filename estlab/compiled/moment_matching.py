"""A Gaussian belief through a traced function: estlab.maths.transforms and sigma_points, in components."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from estlab.compiled.algebra import (
    Matrix,
    Pivots,
    Row,
    added,
    cholesky,
    inner,
    is_zero,
    matmul,
    minus,
    plus,
    sandwich,
    symmetric,
    times,
    total,
    transpose,
)
from estlab.compiled.model_graphs import root


class TracedMoments(NamedTuple):
    """Mean, covariance, and cross-covariance with the argument, by rows of the argument's components."""

    mean: Row
    cov: Matrix
    cross: Matrix


@dataclass(frozen=True)
class Points:
    """Sigma points for so many axes. Symmetric points lie at ``scale`` along each axis and weigh ``weight`` each;
    others are listed for a unit covariance, (axes, p), with their weights. bonus: the centre's weight in the
    covariance minus one.
    """

    scale: Any = None
    weight: Any = None
    listed: Sequence[Sequence[float]] | None = None
    weights: Sequence[float] = ()
    bonus: Any = -1.0

    def offsets(self, factor: Matrix) -> list[Row]:
        """The points' offsets from the mean."""
        n = len(factor)
        if self.listed is None:
            outward = [[times(self.scale, factor[i][j]) for i in range(n)] for j in range(n)]
            return outward + [[entry if is_zero(entry) else -entry for entry in offset] for offset in outward]
        return [
            [total(_scaled(factor[i][c], self.listed[c][p]) for c in range(i + 1)) for i in range(n)]
            for p in range(len(self.weights))
        ]

    def of(self, p: int) -> Any:
        """The weight of a point."""
        return self.weight if self.listed is None else self.weights[p]

    @property
    def alike(self) -> bool:
        """Whether all weights are equal."""
        return self.listed is None or len(set(self.weights)) == 1


def _scaled(entry: Any, by: float) -> Any:
    return 0.0 if is_zero(entry) or by == 0.0 else entry * by


def point(mean: Row, offset: Row) -> Row:
    """The mean and an offset."""
    return [plus(offset[i], mean[i]) for i in range(len(mean))]


def by_points(
    points: Points,
    function: Callable[[Row], Row],
    wrap: Callable[[Row], Row],
    mean: Row,
    factor: Matrix,
    crossed: int,
) -> TracedMoments:
    """Moments through points about the mean. wrap: wraps differences. crossed: components with a cross-covariance."""
    offsets = points.offsets(factor)
    middle, rises = deviations(points, function, wrap, mean, offsets)
    m, count = len(middle), len(offsets)
    if points.alike:
        weight = points.of(0)
        weighted = rises
    else:
        weight = 1.0
        weighted = [[_scaled(entry, points.weights[p]) for entry in rises[p]] for p in range(count)]
    shift = [times(weight, total(weighted[p][i] for p in range(count))) for i in range(m)]

    def spread(i: int, j: int) -> Any:
        square = total(times(weighted[p][i], rises[p][j]) for p in range(count))
        return plus(times(weight, square), times(points.bonus, times(shift[i], shift[j])))

    cross = [
        [times(weight, total(times(offsets[p][c], weighted[p][i]) for p in range(count))) for i in range(m)]
        for c in range(crossed)
    ]
    if points.listed is None:
        cross = _opposite(points, factor, rises, crossed, m)
    return TracedMoments([plus(middle[i], shift[i]) for i in range(m)], symmetric(m, spread), cross)


def _opposite(points: Points, factor: Matrix, rises: list[Row], crossed: int, m: int) -> Matrix:
    """For points that lie opposite each other: the sum over the axes of L times the difference of their values."""
    n = len(factor)
    difference = [[minus(rises[k][i], rises[n + k][i]) for i in range(m)] for k in range(n)]
    scale = points.weight * points.scale
    return [
        [times(scale, total(times(factor[c][k], difference[k][i]) for k in range(c + 1))) for i in range(m)]
        for c in range(crossed)
    ]


def deviations(
    points: Points,
    function: Callable[[Row], Row],
    wrap: Callable[[Row], Row],
    mean: Row,
    offsets: list[Row],
) -> tuple[Row, list[Row]]:
    """The value at the mean, and the values at the points minus it."""
    middle = function(mean)
    rises = []
    for offset in offsets:
        value = function(point(mean, offset))
        rises.append(wrap([minus(value[i], middle[i]) for i in range(len(middle))]))
    return middle, rises


def linearised(value: Row, jacobian: Matrix, cov: Matrix) -> TracedMoments:
    """Linearised at the mean, with the Jacobian F: F P F' and P F'."""
    jacobian_cov, spread = sandwich(jacobian, cov)
    return TracedMoments(value, spread, transpose(jacobian_cov, len(cov)))


def second_order(moments: TracedMoments, hessians: list[Matrix], cov: Matrix, gaussian: bool) -> TracedMoments:
    """The same with second derivatives; see estlab.maths.transforms.SecondOrder."""
    n = len(cov)
    products = [matmul(matrix, cov) for matrix in hessians]  # H_i P
    mean = [
        plus(value, times(0.5, total(part[i][i] for i in range(n))))
        for value, part in zip(moments.mean, products, strict=True)
    ]
    if not gaussian:
        return moments._replace(mean=mean)

    def twice(i: int, j: int) -> Any:
        return times(0.5, total(inner(products[i][a], [row[a] for row in products[j]]) for a in range(n)))

    return TracedMoments(mean, added(moments.cov, symmetric(len(products), twice)), moments.cross)


def factored(cov: Matrix, failed: Pivots) -> Matrix:
    """The lower factor of a covariance."""
    return cholesky(cov, failed, root)
