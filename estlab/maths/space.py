"""What the components of a vector are, and how to subtract, add and average them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

Array = np.ndarray[Any, np.dtype[Any]]

TURN = 2.0 * np.pi


def wrap(angle: Any) -> Any:
    """The same angle in [-pi, pi] [rad]."""
    return angle - TURN * np.rint(angle / TURN)


@dataclass(frozen=True)
class Space:
    """A vector space in which some components are angles.

    Vectors are arrays of shape ``(n, *batch)``. Everything outside this class may subtract, add and
    average states and readings without knowing that pi exists.

    names, units: one per component. angles: the indices of the components that wrap.
    position: the indices of the components that together are a place, scored as one distance.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    angles: tuple[int, ...] = ()
    position: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        return len(self.names)

    def minus(self, a: Array, b: Array) -> Array:
        """a - b, the short way round for angles; shapes (n, *batch) that broadcast."""
        difference = np.asarray(a - b)
        for i in self.angles:
            difference[i] = wrap(difference[i])
        return difference

    def plus(self, a: Array, step: Array) -> Array:
        """a + step with angles brought back to [-pi, pi]; the inverse of :meth:`minus`."""
        total = np.asarray(a + step)
        for i in self.angles:
            total[i] = wrap(total[i])
        return total

    def wrapped(self, a: Array) -> Array:
        """The same vectors (n, *batch) with angles in [-pi, pi]."""
        if not self.angles:
            return a
        wrapped = a.copy()
        for i in self.angles:
            wrapped[i] = wrap(wrapped[i])
        return wrapped

    def mean(self, points: Array, weights: Array) -> Array:
        """Weighted mean of points (n, p, *batch) that may lie all round; weights (p, *batch) >= 0 of sum one.

        Angles by the circular mean, the direction of the sum of unit vectors. Mardia and Jupp 2000, section 2.2.1.
        """
        mean = np.einsum("ip...,p...->i...", points, weights)
        for i in self.angles:
            sine, cosine = (np.einsum("p...,p...->...", f(points[i]), weights) for f in (np.sin, np.cos))
            mean[i] = np.arctan2(sine, cosine)
        return mean

    def repeat(self, times: int) -> "Space":
        """The space of several vectors of this one, one after another."""
        return Space(
            names=tuple(f"{name}[{k}]" for k in range(times) for name in self.names),
            units=self.units * times,
            angles=tuple(k * self.size + i for k in range(times) for i in self.angles),
        )
