"""Weighted points of many runs, processed in chunks that stay in the cache.

A cloud is ``(n, N, runs)`` and its weights ``(N, runs)``. In memory each run's numbers of a component lie side by
side, so a sum over a run's points is always taken in the same order: a run alone equals that run among others to the
last bit.
"""

from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numpy as np

from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Array, Space

# Numbers of one component in a chunk: few enough that a dozen such arrays stay in a second-level cache of 1 MB, and
# so many that calling NumPy costs little beside them. OpenBLAS splits larger sums among its threads, and their order
# would depend on the machine.
CHUNK = 10_000

Part = TypeVar("Part")


def empty(n: int, count: int, runs: int) -> Array:
    """An uninitialised cloud (n, count, runs), each run's numbers of a component side by side."""
    return np.empty((n, runs, count)).swapaxes(1, 2)


def even(count: int, runs: int, value: float) -> Array:
    """Equal weights (count, runs) for all points."""
    return np.full((runs, count), value).T


def laid_out(points: Array) -> Array:
    """A copy of points (n, N, runs) with the memory layout of a cloud."""
    cloud = empty(*points.shape)
    cloud[:] = points
    return cloud


def groups(count: int, runs: int) -> Iterator[slice]:
    """Groups of runs, so that a component of a group's points is about a chunk."""
    together = max(1, CHUNK // count)
    return (slice(first, min(first + together, runs)) for first in range(0, runs, together))


def each(work: Callable[[slice], Part], count: int) -> list[Part]:
    """The result of the work for each chunk of a run's points, in order; the chunks do not depend on the runs."""
    return [work(slice(first, min(first + CHUNK, count))) for first in range(0, count, CHUNK)]


def fill(room: Array, components: tuple[Any, ...]) -> None:
    """Put components, numbers or arrays, into an array (n, *batch)."""
    for place, component in zip(room, components, strict=True):
        place[...] = component


def dot(a: Array, b: Array) -> Array:
    """Sums (*shape, runs) of the products of (*shape, N, runs), with N at most a chunk."""
    return np.vecdot(np.swapaxes(a, -1, -2), np.swapaxes(b, -1, -2))


def combined(matrix: Array, vectors: Array) -> Array:
    """A x for A (n, k, 1 or runs) and x (k, N, runs), skipping products with zeros: most noises are independent."""
    product = np.empty_like(vectors, shape=(matrix.shape[0], *vectors.shape[1:]))
    for row, place in zip(matrix, product, strict=True):
        terms = [(entry, vector) for entry, vector in zip(row, vectors, strict=True) if entry.any()]
        if not terms:
            place[...] = 0.0
        for number, (entry, vector) in enumerate(terms):
            if number == 0:
                np.multiply(entry, vector, out=place)
            else:
                place += entry * vector
    return product


def mean(space: Space, points: Array, weights: Array) -> Array:
    """Weighted mean (n, runs) of a cloud whose weights sum to one; the circular mean for angles."""
    parts = each(lambda part: space.sums(points[:, part], weights[part]), len(weights))
    return space.mean_of(sum(parts[1:], parts[0]))


def moments(space: Space, points: Array, weights: Array) -> Gaussian:
    """Weighted mean (n, runs) and covariance (n, n, runs) of a cloud whose weights sum to one."""
    n, count, runs = points.shape
    means, cov = np.empty((n, runs)), np.empty((n, n, runs))
    for own in groups(count, runs):
        means[:, own], cov[..., own] = _moments(space, points[..., own], weights[:, own])
    return Gaussian(means, cov)


def sampled(points: Array, weights: Array, most: int) -> tuple[Array, Array]:
    """A few points (n, S, runs) of a cloud and their weights (S, runs): from each stretch of neighbours the one in
    the middle of their weights, with the weight of all.

    Nothing is random. After resampling, neighbours come from neighbouring parents, so every parent has its share.
    """
    n, count, runs = points.shape
    if count <= most:
        return points.copy(), weights.copy()
    edges = np.linspace(0, count, most + 1).astype(int)
    few, heavy = empty(n, most, runs), np.empty((most, runs))
    for run in range(runs):
        up_to = np.concatenate([[0.0], np.cumsum(weights[:, run])])
        heavy[:, run] = np.diff(up_to[edges])
        middle = np.searchsorted(up_to[1:], 0.5 * (up_to[edges[1:]] + up_to[edges[:-1]]))
        few[:, :, run] = points[:, np.clip(middle, edges[:-1], edges[1:] - 1), run]
    return few, heavy


def gram(a: Array, b: Array) -> Array:
    """A B' (n, m, runs) of clouds (n, N, runs) and (m, N, runs): the products summed over the points."""
    parts = each(lambda part: np.stack([dot(row, b[:, part]) for row in a[:, part]]), a.shape[1])
    return sum(parts[1:], parts[0])


def _moments(space: Space, points: Array, weights: Array) -> Gaussian:
    about = mean(space, points, weights)

    def about_mean(part: slice) -> list[Array]:
        spread = space.minus(points[:, part], about[:, None])
        weighted = weights[part] * spread
        return [dot(row, spread[: i + 1]) for i, row in enumerate(weighted)]

    rows = [sum(parts[1:], parts[0]) for parts in zip(*each(about_mean, len(weights)), strict=True)]
    cov = np.empty((len(about), *about.shape))
    for i, row in enumerate(rows):
        cov[i, : i + 1] = cov[: i + 1, i] = row
    return Gaussian(about, cov)


def take(values: Array, runs: Array | slice) -> Array:
    """The values of some of the runs: (*shape, runs), each run's side by side."""
    return np.moveaxis(np.moveaxis(values, -1, -2)[..., runs, :], -2, -1)


def replaced(values: Array, runs: Array, part: Array) -> Array:
    """A copy of (*shape, runs) with some of the runs replaced."""
    some = np.size(runs) < values.shape[-1]
    copy = values.copy(order="K") if some else np.empty_like(values)
    copy[..., runs] = part
    return copy


def chosen(points: Array, runs: Array, indices: Array) -> Array:
    """The points (n, N, some) with these indices (N, some) in some of the runs."""
    n, count, every = points.shape
    flat = points.swapaxes(1, 2).reshape(n, every * count)
    places = (indices + count * runs).T
    found = empty(n, count, len(runs))
    for component, room in zip(flat, found.swapaxes(1, 2), strict=True):
        component.take(places, out=room, mode="clip")  # no index is out of range, and without clipping NumPy would copy
    return found
