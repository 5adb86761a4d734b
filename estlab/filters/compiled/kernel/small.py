"""Algebra of one small matrix in plain loops, as it is compiled. What has no answer becomes NaN, as in maths.linalg."""

import numpy as np

from estlab.filters.compiled.scalars import NJIT, jit
from estlab.maths import linalg
from estlab.maths.space import Array

semidefinite = NJIT(error_model="numpy")(linalg.semidefinite)  # seldom called, so no part of what calls it


@jit
def cholesky(p: Array, factor: Array) -> None:
    """L lower with L L' = P into the lower triangle of ``factor``; see estlab.maths.linalg.cholesky."""
    n = p.shape[0]
    for j in range(n):
        nothing = True
        for i in range(j, n):
            known = 0.0
            for k in range(j):
                known += factor[i, k] * factor[j, k]
            factor[i, j] = p[i, j] - known
            nothing = nothing and factor[i, j] == 0.0
        if nothing:
            continue
        pivot = np.sqrt(factor[j, j]) if factor[j, j] > 0.0 else np.nan
        for i in range(j, n):
            factor[i, j] /= pivot
    if n > 0 and not np.isfinite(factor[n - 1, n - 1]):
        fail(factor)
        if np.isfinite(p).all():
            semidefinite(p, factor)


@jit
def fail(factor: Array) -> None:
    """No factor: NaN in the lower triangle."""
    for i in range(factor.shape[0]):
        for j in range(i + 1):
            factor[i, j] = np.nan


@jit
def sandwich(a: Array, p: Array, half: Array, total: Array) -> None:
    """A P A' added to ``total``, for A (n, k) and P (k, k), symmetric to the last bit; ``half`` (n, k) becomes A P."""
    n, k = a.shape
    for i in range(n):
        for j in range(k):
            half[i, j] = 0.0
            for c in range(k):
                half[i, j] += a[i, c] * p[c, j]
    for i in range(n):
        for j in range(i + 1):
            one, other = 0.0, 0.0
            for c in range(k):
                one += half[i, c] * a[j, c]
                other += half[j, c] * a[i, c]
            total[i, j] += 0.5 * (one + other)
            total[j, i] = total[i, j]
