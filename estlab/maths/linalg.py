"""Dense algebra of many small matrices at once, components first.

A matrix is ``(n, m, *batch)``: entry ``A[i, j]`` is contiguous over the batch, so that loops run over the few
components in Python and over the many members of the batch in NumPy. A member that has no answer becomes NaN
and its neighbours go on: ``numpy.linalg`` would raise for the whole stack.
"""

import numpy as np

from estlab.maths.space import Array


def matmul(a: Array, b: Array) -> Array:
    """A B for (n, k, *batch) and (k, m, *batch)."""
    return np.einsum("ik...,kj...->ij...", a, b)


def matvec(a: Array, x: Array) -> Array:
    """A x for (n, k, *batch) and (k, *batch)."""
    return np.einsum("ik...,k...->i...", a, x)


def transpose(a: Array) -> Array:
    """A' for (n, m, *batch)."""
    return np.swapaxes(a, 0, 1)


def gram(a: Array, b: Array | None = None) -> Array:
    """A B' for (n, p, *batch) and (m, p, *batch); A A' when B is left out."""
    return np.einsum("ip...,jp...->ij...", a, a if b is None else b)


def sandwich(a: Array, p: Array) -> Array:
    """A P A', symmetric to the last bit, for (n, k, *batch) and (k, k, *batch)."""
    return symmetric(gram(matmul(a, p), a))


def symmetric(p: Array) -> Array:
    """(P + P') / 2."""
    return 0.5 * (p + transpose(p))


def cholesky(p: Array) -> Array:
    """L lower with L L' = P, for (n, n, *batch); all NaN where P is not positive definite but for rows of zeros.

    Golub and Van Loan, Matrix Computations, 4th ed., algorithm 4.2.1 (by columns). Reads the lower triangle.
    """
    n = p.shape[0]
    factor = np.zeros_like(p)
    for j in range(n):
        column = p[j:, j] - np.einsum("ik...,k...->i...", factor[j:, :j], factor[j, :j])
        pivot = np.sqrt(np.where(column[0] > 0.0, column[0], np.nan))
        factor[j:, j] = column / pivot
        if (column[0] == 0.0).any():
            # What has no variance at all, such as a noise that is off, has a factor too: nothing.
            factor[j:, j] = np.where((column == 0.0).all(axis=0), 0.0, factor[j:, j])
    if n == 0:
        return factor
    # A failed pivot reaches the last one through its row, so one entry tells of the whole member.
    failed = ~np.isfinite(factor[-1, -1])
    if np.any(failed):
        factor = np.where(failed, np.nan, factor)
    return factor


def solve_lower(factor: Array, b: Array) -> Array:
    """L^-1 B by forward substitution, for L (m, m, *batch) and B (m, k, *batch)."""
    solution = np.empty(np.broadcast_shapes(factor[:, :1].shape, b.shape))
    for i in range(factor.shape[0]):
        known = np.einsum("j...,jk...->k...", factor[i, :i], solution[:i])
        solution[i] = (b[i] - known) / factor[i, i]
    return solution


def solve_lower_transposed(factor: Array, b: Array) -> Array:
    """L'^-1 B by backward substitution, for L (m, m, *batch) and B (m, k, *batch)."""
    solution = np.empty(np.broadcast_shapes(factor[:, :1].shape, b.shape))
    for i in reversed(range(factor.shape[0])):
        known = np.einsum("j...,jk...->k...", factor[i + 1 :, i], solution[i + 1 :])
        solution[i] = (b[i] - known) / factor[i, i]
    return solution


def without(cov: Array, missing: Array) -> Array:
    """A covariance (m, m, runs or nothing) in which what is missing (m, runs) is independent and of unit variance."""
    whole = cov if cov.ndim > 2 else cov[..., None]
    if not missing.any():
        return whole
    either = missing[:, None] | missing[None, :]
    return np.where(either, np.eye(missing.shape[0])[..., None], whole)


def diagonal(values: Array) -> Array:
    """The (n, n, *batch) matrix with these values (n, *batch) on its diagonal."""
    values = np.asarray(values)
    n = values.shape[0]
    matrix = np.zeros((n, *values.shape))
    matrix[range(n), range(n)] = values
    return matrix


def block_diagonal(p: Array, q: Array) -> Array:
    """[P 0; 0 Q] for (n, n, *batch) and (m, m, *batch or nothing)."""
    n, m = p.shape[0], q.shape[0]
    batch = np.broadcast_shapes(p.shape[2:], q.shape[2:])
    joint = np.zeros((n + m, n + m, *batch))
    joint[:n, :n] = p.reshape(n, n, *(1,) * (len(batch) - p.ndim + 2), *p.shape[2:])
    joint[n:, n:] = q.reshape(m, m, *(1,) * (len(batch) - q.ndim + 2), *q.shape[2:])
    return joint
