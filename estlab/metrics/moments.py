"""Means and scatters over runs, added block by block, in memory that does not grow with the runs."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from estlab.maths.space import Array


@dataclass(frozen=True)
class SampleMoments:
    """Number (*shape), mean (p, *shape) and scatter (p, p, *shape) of vectors of p numbers, one vector per run.

    A run with a NaN in a vector does not count in that vector's moments.
    """

    count: Array
    mean: Array
    scatter: Array

    @classmethod
    def of(cls, values: Array) -> "SampleMoments":
        """The moments of a block's values (p, *shape, runs)."""
        known = np.isfinite(values).all(axis=0)
        count = known.sum(axis=-1)
        mean = np.where(known, values, 0.0).sum(axis=-1) / np.maximum(count, 1)
        off = np.where(known, values - mean[..., None], 0.0)
        return cls(count, mean, np.einsum("i...r,j...r->ij...", off, off))

    def plus(self, other: "SampleMoments") -> "SampleMoments":
        """The moments of the runs of both. Chan, Golub and LeVeque 1983, equation 2.1, which avoids cancellation."""
        count = self.count + other.count
        share = other.count / np.maximum(count, 1)
        shift = other.mean - self.mean
        between = shift[:, None] * shift[None, :] * (self.count * share)
        return SampleMoments(count, self.mean + shift * share, self.scatter + other.scatter + between)

    @property
    def cov(self) -> Array:
        """The unbiased covariance (p, p, *shape); NaN for fewer than two runs."""
        return self.scatter / np.where(self.count > 1, self.count - 1, np.nan)

    def at(self, *index: int) -> "SampleMoments":
        """The moments at a place of the shape."""
        place: Any = (..., *index)
        return SampleMoments(self.count[place], self.mean[place], self.scatter[place])

    def component(self, i: int) -> "SampleMoments":
        """The moments of one of the numbers of each vector."""
        return SampleMoments(self.count, self.mean[i : i + 1], self.scatter[i : i + 1, i : i + 1])

    def leading(self, size: int) -> "SampleMoments":
        """The moments of the first numbers of each vector."""
        return SampleMoments(self.count, self.mean[:size], self.scatter[:size, :size])


class Histogram:
    """How many runs lie in each bin, with edges evenly spaced in the logarithm, for (*shape, runs) values.

    The first bin counts values below all of these, zero included, the last those above. NaN is not counted.
    """

    PER_DECADE, DECADES = 20, 12  # bins per decade, decades on each side of one

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.counts = np.zeros((*shape, 2 * self.DECADES * self.PER_DECADE + 2), dtype=np.int64)

    def plus(self, other: "Histogram") -> "Histogram":
        """The counts of the runs of both."""
        both = Histogram(self.counts.shape[:-1])
        both.counts = self.counts + other.counts
        return both

    def add(self, values: Array) -> None:
        """Count a block's values (*shape, runs)."""
        bins = self.counts.shape[-1]
        with np.errstate(divide="ignore", invalid="ignore"):
            place = np.floor((np.log10(values) + self.DECADES) * self.PER_DECADE) + 1.0
        known = ~np.isnan(values)
        place = np.clip(np.where(known, place, 0.0), 0, bins - 1).astype(int)
        for index in np.ndindex(*self.counts.shape[:-1]):
            self.counts[index] += np.bincount(place[index][known[index]], minlength=bins)

    def edges(self) -> Array:
        """The edges of the bins, one more than the number of bins: from zero to infinity."""
        inner = 10.0 ** (np.arange(self.counts.shape[-1] - 1) / self.PER_DECADE - self.DECADES)
        return np.concatenate([[0.0], inner, [np.inf]])
