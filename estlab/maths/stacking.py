"""A matrix as rows of components. Constant components are plain numbers: they cost nothing over the batch."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from estlab.maths.linalg import mirrored, summed
from estlab.maths.space import Array

Components = tuple[Any, ...]
Rows = Sequence[Sequence[Any]] | Array


def stacked(components: Components, batch: tuple[int, ...]) -> Array:
    """Components, each a number or an array, as one array (n, *batch)."""
    if not batch:
        return np.array(components, dtype=float)
    array = np.empty((len(components), *batch))
    for i, component in enumerate(components):
        array[i] = component
    return array


def matrix(rows: Rows, batch: tuple[int, ...]) -> Array:
    """Rows of components as one array (n, m, *batch)."""
    array = np.empty((len(rows), len(rows[0]), *batch))
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            array[i, j] = entry
    return array


def through(rows: Rows, cov: Array, batch: tuple[int, ...]) -> tuple[Rows, Array]:
    """Rows of A P, and A P A' (m, m, *batch), symmetric to the last bit, for a symmetric P (n, n, *batch).

    P may also be constant, (n, n). Entries of A and of a constant P that are 0, 1 or -1 as Python numbers cost no
    multiplication.
    """
    if not batch:
        # For a single member, calls of NumPy cost more than the arithmetic that they save.
        a = np.array(rows).reshape(len(rows), cov.shape[0])
        carried = summed(a[:, None] * cov, 2)
        return carried, mirrored(summed(carried[:, None] * a, 2))
    sparse = [_entries(row) for row in rows]
    if cov.ndim == 2:
        columns = [_entries(column) for column in cov.tolist()]
        half: list[Any] = [[_inner(column, row) for column in columns] for row in rows]
    else:
        half = [_inner(row, cov) if row else np.zeros(cov.shape[1:]) for row in sparse]
    spread = np.empty((len(rows), len(rows), *batch))
    for i, left in enumerate(half):
        for j, row in enumerate(sparse[: i + 1]):
            spread[i, j] = _inner(row, left)
    return half, mirrored(spread)


def _entries(row: Sequence[Any]) -> list[tuple[int, Any]]:
    """The entries of a row that are not a constant zero, each with its index."""
    return [(k, entry) for k, entry in enumerate(row) if type(entry) is not float or entry != 0.0]


def _inner(row: list[tuple[int, Any]], values: Any) -> Any:
    """The sum of row[k] values[k] in the order of k."""
    total: Any = None
    for k, entry in row:
        value = values[k]
        if type(value) is float and value == 0.0:
            continue
        if type(entry) is float and entry == 1.0:
            total = value if total is None else total + value
        elif type(entry) is float and entry == -1.0 and total is not None:
            total = total - value
        else:
            total = entry * value if total is None else total + entry * value
    return 0.0 if total is None else total
