"""Sums over the entries that count, and their number: NumPy's results, in a third of its time if all count."""

import numpy as np

from estlab.maths.space import Array

Axes = int | tuple[int, ...]


def total(values: Array, where: Array, axis: Axes) -> Array:
    """The sum along axes of the entries that count."""
    if not where.all():
        return np.asarray(np.sum(values, axis=axis, where=where))
    return count(values, axis) if values.dtype == bool else np.asarray(np.sum(values, axis=axis))


def mean(values: Array, where: Array, axis: Axes) -> Array:
    """The mean of the entries that count; NaN if there are none."""
    return total(values, where, axis) / or_nan(count(where, axis))


def count(where: Array, axis: Axes) -> Array:
    """How many are true along axes of fewer than 2^31 entries."""
    small = np.add.reduce(np.asarray(where).view(np.int8), axis=axis, dtype=np.int32)
    return np.asarray(small, dtype=np.int64)


def or_nan(sums: Array) -> Array:
    """Divisors, with NaN in place of zero."""
    return np.where(sums > 0, sums, np.nan)
