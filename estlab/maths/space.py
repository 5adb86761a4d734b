"""The components of a vector, and how to subtract, add and average them."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

Array = np.ndarray[Any, np.dtype[Any]]

TURN = 2.0 * np.pi


def wrap(angle: Any) -> Any:
    """The same angle in [-pi, pi] [rad]."""
    return angle - TURN * np.rint(angle / TURN)


def cos_sin(angle: Any) -> tuple[Any, Any]:
    """Cosine and sine of an angle [rad], to 2e-16, by the tangent of half the angle.

    NumPy's tangent is vectorised; its cosine and sine of doubles are not. Both together take a quarter of the time
    this way. A symbolic angle (estlab.compiled.symbols) has its own method.
    """
    if (own := getattr(angle, "cos_sin", None)) is not None:
        cosine, sine = own()
        return cosine, sine
    half = np.tan(0.5 * angle)
    square = half * half
    whole = 1.0 / (1.0 + square)
    return (1.0 - square) * whole, 2.0 * half * whole


@dataclass(frozen=True)
class Space:
    """A vector space in which some components are angles.

    Vectors are arrays of shape ``(n, *batch)``. Code outside this class subtracts, adds and averages states and
    readings without knowing that pi exists.

    names, units: one per component. angles: the indices of the components that wrap. position: the indices of the
    components that together form a position, scored as one distance.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    angles: tuple[int, ...] = ()
    position: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        return len(self.names)

    @cached_property
    def _angles(self) -> tuple[int | slice, ...]:
        """The angles, with neighbours as one slice, so that they are wrapped at once."""
        first = [i for i in self.angles if i - 1 not in self.angles]
        ends = [next(k for k in range(i, self.size + 1) if k not in self.angles) for i in first]
        return tuple(i if end == i + 1 else slice(i, end) for i, end in zip(first, ends, strict=True))

    def minus(self, a: Array, b: Array) -> Array:
        """a - b, with angles the short way round; shapes (n, *batch) that broadcast."""
        difference = np.asarray(a - b)
        for part in self._angles:
            difference[part] = wrap(difference[part])
        return difference

    def plus(self, a: Array, step: Array) -> Array:
        """a + step with angles wrapped to [-pi, pi]; the inverse of :meth:`minus`."""
        total = np.asarray(a + step)
        for part in self._angles:
            total[part] = wrap(total[part])
        return total

    def wrapped(self, a: Array) -> Array:
        """The same vectors (n, *batch) with angles in [-pi, pi]."""
        if not self.angles:
            return a
        wrapped = a.copy()
        for part in self._angles:
            wrapped[part] = wrap(wrapped[part])
        return wrapped

    def mean(self, points: Array, weights: Array) -> Array:
        """Weighted mean of points (n, p, *batch) with angles anywhere on the circle; weights (p, *batch) >= 0 that
        sum to one.

        For angles the circular mean, the direction of the sum of unit vectors. Mardia and Jupp 2000, section 2.2.1.
        """
        return self.mean_of(self.sums(points, weights))

    def sums(self, points: Array, weights: Array) -> Array:
        """Weighted sums (n + number of angles, *batch) of points (n, p, *batch), as :meth:`mean_of` needs them.

        For an angle, the sum of cosines in its place and the sum of sines after all components. Sums over parts of
        the points can be added.
        """
        # The sum runs over numbers that are contiguous in a cloud (estlab.maths.cloud).
        values, weight = np.moveaxis(points, 1, -1), np.moveaxis(weights, 0, -1)
        total = np.empty((self.size + len(self.angles), *points.shape[2:]))
        np.vecdot(values, weight, out=total[: self.size])
        for k, i in enumerate(self.angles):
            # Cosine and sine by one tangent: NumPy's tangent is vectorised; its sine and cosine are not and take
            # several times as long.
            half = np.tan(0.5 * values[i])
            square = half * half
            share = weight / (1.0 + square)
            np.vecdot(1.0 - square, share, out=total[i, ...])
            total[self.size + k] = 2.0 * np.vecdot(half, share)
        return total

    def mean_of(self, sums: Array) -> Array:
        """The weighted mean (n, *batch) from the :meth:`sums` of points whose weights sum to one."""
        mean = sums[: self.size].copy()
        for k, i in enumerate(self.angles):
            mean[i] = np.arctan2(sums[self.size + k], sums[i])
        return mean

    def repeat(self, times: int) -> "Space":
        """The space of several vectors of this one, one after another."""
        return Space(
            names=tuple(f"{name}[{k}]" for k in range(times) for name in self.names),
            units=self.units * times,
            angles=tuple(k * self.size + i for k in range(times) for i in self.angles),
        )
