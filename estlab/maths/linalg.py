"""Dense algebra of many small matrices at once, components first.

A matrix is ``(n, m, *batch)``: entry ``A[i, j]`` is contiguous over the batch, so Python loops over the few
components and NumPy over the many members of the batch. A member without a result becomes NaN and the others
continue: ``numpy.linalg`` would raise for the whole stack.
"""

import math

import numpy as np

from estlab.maths.space import Array

# Share of a variance, for each component of a matrix, that rounding may leave as an error.
ROUNDING = 16.0 * float(np.finfo(float).eps)


def matmul(a: Array, b: Array) -> Array:
    """A B for (n, k, *batch) and (k, m, *batch), either of which may be constant."""
    a, b = _alike(a, b)
    if b.shape[0] == 0:
        return np.zeros((a.shape[0], b.shape[1], *np.broadcast_shapes(a.shape[2:], b.shape[2:])))
    if a.ndim == 2:
        return summed(a[:, None] * b.T, 2)
    product = a[:, 0, None] * b[None, 0]
    for k in range(1, b.shape[0]):
        product += a[:, k, None] * b[None, k]
    return np.asarray(product)


def lower_matmul(factor: Array, b: Array) -> Array:
    """L B for L (n, n, *batch), lower, and B (n, m, *batch): :func:`matmul` without the products with zeros."""
    if factor.ndim == 2:
        return matmul(factor, b)
    product = factor[:, 0, None] * b[None, 0]
    for k in range(1, b.shape[0]):
        product[k:] += factor[k:, k, None] * b[None, k]
    return product


def matvec(a: Array, x: Array) -> Array:
    """A x for (n, k, *batch) and (k, *batch), either of which may be constant."""
    return matmul(a, x[:, None])[:, 0]


def transpose(a: Array) -> Array:
    """A' for (n, m, *batch)."""
    return np.swapaxes(a, 0, 1)


def summed(terms: Array, axis: int) -> Array:
    """The sum along an axis, in order, of terms that lie in memory in the order of their axes.

    NumPy adds in another order if the axis is the last one with more than one entry, and a filter close to divergence
    magnifies the difference. A run alone must equal that run among others.
    """
    if terms.shape[axis] < 3 or math.prod(terms.shape[axis + 1 :]) > 1:
        return np.asarray(np.add.reduce(terms, axis=axis))
    sums = np.add.accumulate(terms, axis=axis)
    return sums[..., -1] if axis == terms.ndim - 1 else np.asarray(sums.take(-1, axis=axis))


def mirrored(p: Array) -> Array:
    """The same matrix (n, n, *batch) with the part above its diagonal replaced by the part below, in place."""
    for i in range(1, p.shape[0]):
        p[:i, i] = p[i, :i]
    return p


def gram(a: Array, b: Array | None = None, weights: Array | None = None) -> Array:
    """A B' for (n, p, *batch) and (m, p, *batch); without B, A W A' symmetric to the last bit, weights (p, *batch)."""
    if b is not None:
        batch = np.broadcast_shapes(a.shape[2:], b.shape[2:])
        product = np.empty((a.shape[0], b.shape[0], *batch))
        for i in range(a.shape[0]):
            product[i] = summed(a[i] * b, 1)
        return product
    if a.ndim == 2:
        return summed(a[:, None] * a, 2) if weights is None else mirrored(summed((weights * a)[:, None] * a, 2))
    square = np.empty((a.shape[0], a.shape[0], *a.shape[2:]))
    for i in range(a.shape[0]):
        row = a[i] if weights is None else weights * a[i]
        square[i, : i + 1] = summed(row * a[: i + 1], 1)
    return mirrored(square)


def sandwich(a: Array, p: Array) -> Array:
    """A P A', symmetric to the last bit, for (n, k, *batch) and (k, k, *batch)."""
    return symmetric(matmul(matmul(a, p), transpose(a)))


def symmetric(p: Array) -> Array:
    """(P + P') / 2."""
    return 0.5 * (p + transpose(p))


def cholesky(p: Array) -> Array:
    """L lower with L L' = P, for (n, n, *batch); all NaN where P is not positive semidefinite.

    Golub and Van Loan, Matrix Computations, 4th ed., algorithm 4.2.1 (by columns). Reads the lower triangle. A
    component that is determined by those before it has a pivot and a column of zeros. An example is g g', the
    covariance of position and velocity under white acceleration, whose factor has the single column g. See
    :func:`semidefinite`.
    """
    if p.ndim == 2:
        return _cholesky_of_one(p)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        factor = _by_columns(p)
        # A failed pivot reaches the last one through its row, so one entry shows whether the member failed.
        failed = ~np.isfinite(factor[-1:, -1:])[0, 0] if p.shape[0] else np.zeros(p.shape[2:], dtype=bool)
    if failed.any():
        factor[:, :, failed] = _one_by_one(p[:, :, failed])
    return factor


def _by_columns(p: Array) -> Array:
    factor = np.zeros(p.shape)
    for j in range(p.shape[0]):
        column = p[j:, j]
        for k in range(j):
            column = column - factor[j:, k] * factor[j, k]
        np.sqrt(column[0], out=factor[j, j])
        np.divide(column[1:], factor[j, j], out=factor[j + 1 :, j])
    return factor


def _one_by_one(p: Array) -> Array:
    """For members (n, n, N), some of which have zero pivots and others no factor."""
    return np.stack([_cholesky_of_one(p[:, :, i]) for i in range(p.shape[2])], axis=2)


def _cholesky_of_one(p: Array) -> Array:
    """The same for a single matrix (n, n), in plain numbers: the same operations in the same order, without NumPy's
    calls.

    A matrix without any variance, such as a noise that is off, has a factor too: zero.
    """
    n = p.shape[0]
    if n == 0:
        return np.zeros((0, 0))
    factor: list[list[float]] = []
    for i, entries in enumerate(p.tolist()):
        row: list[float] = []
        for entry, above in zip(entries, factor, strict=False):
            for left, right in zip(row, above, strict=False):
                entry -= left * right
            root = above[-1]
            row.append(entry / root if root != 0.0 else 0.0 if entry == 0.0 else math.nan)
        square = entries[i]
        for left in row:
            square -= left * left
        row.append(math.sqrt(square) if square >= 0.0 else math.nan)
        factor.append(row)
    if math.isfinite(factor[-1][-1]):
        return np.array([row + [0.0] * (n - len(row)) for row in factor])
    found = np.full((n, n), np.nan)
    if np.isfinite(p).all():
        semidefinite(p, found)
    return found


def semidefinite(p: Array, factor: Array) -> None:
    """L lower with L L' = P in the place of ``factor`` (n, n), for P (n, n) of any rank; unchanged if P has no
    factor.

    Cholesky's factor, with complete pivoting, of the correlations, which reveals the rank; its rows are made
    triangular by the modified Gram-Schmidt method. Higham 2002, section 10.3; Bjoerck 1967. Without pivoting, the
    rounding errors of zeros would be divided by those of other zeros. A matrix further from semidefinite than
    rounding explains has no factor.
    """
    n = p.shape[0]
    slack = n * ROUNDING
    rest, rows = np.zeros((n, n)), np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            size = math.sqrt(max(p[i, i], 0.0)) * math.sqrt(max(p[j, j], 0.0))
            if size > 0.0:
                rest[i, j] = rest[j, i] = p[i, j] / size
            elif p[i, j] != 0.0:
                return
    for c in range(n):
        best = 0
        for i in range(n):
            if rest[i, i] > rest[best, best]:
                best = i
        if rest[best, best] <= slack:
            break
        pivot = math.sqrt(rest[best, best])
        for i in range(n):
            rows[i, c] = rest[i, best] / pivot
        for i in range(n):
            for j in range(n):
                rest[i, j] -= rows[i, c] * rows[j, c]
    for i in range(n):
        for j in range(n):
            if abs(rest[i, j]) > slack:
                return
    for i in range(n):
        scale = math.sqrt(p[i, i])
        for k in range(i + 1):
            along = 0.0
            for c in range(n):
                along += rows[i, c] * rows[k, c]
            if k == i:
                # The part of the row orthogonal to all earlier ones: its length, to which it is scaled.
                along = math.sqrt(along)
                if along <= slack:
                    along = 0.0
                for c in range(n):
                    rows[i, c] = rows[i, c] / along if along > 0.0 else 0.0
            else:
                for c in range(n):
                    rows[i, c] -= along * rows[k, c]
            factor[i, k] = scale * along
        for k in range(i + 1, n):
            factor[i, k] = 0.0


def solve_lower(factor: Array, b: Array) -> Array:
    """L^-1 B by forward substitution, for L (m, m, *batch) and B (m, k, *batch), either of which may be constant."""
    factor, b = _alike(factor, b)
    solution = np.empty(
        b.shape if b.shape[2:] == factor.shape[2:] else np.broadcast_shapes(factor[:, :1].shape, b.shape)
    )
    for i in range(factor.shape[0]):
        rest = b[i]
        for j in range(i):
            rest = rest - factor[i, j] * solution[j]
        np.divide(rest, factor[i, i], out=solution[i])
    return solution


def solve_lower_transposed(factor: Array, b: Array) -> Array:
    """L'^-1 B by backward substitution, for L (m, m, *batch) and B (m, k, *batch), either of which may be constant."""
    factor, b = _alike(factor, b)
    solution = np.empty(np.broadcast_shapes(factor[:, :1].shape, b.shape))
    for i in reversed(range(factor.shape[0])):
        rest = b[i]
        for j in range(i + 1, factor.shape[0]):
            rest = rest - factor[j, i] * solution[j]
        np.divide(rest, factor[i, i], out=solution[i])
    return solution


def _alike(a: Array, b: Array) -> tuple[Array, Array]:
    """Two matrices with the same number of batch axes: a constant one gets axes of length one."""
    more = a.ndim - b.ndim
    if more > 0:
        b = b.reshape(*b.shape, *(1,) * more)
    elif more < 0:
        a = a.reshape(*a.shape, *(1,) * -more)
    return a, b


def without(cov: Array, missing: Array) -> Array:
    """A covariance (m, m, *batch or nothing) with missing entries (m, *batch) independent, of unit variance."""
    more = missing.ndim - 1
    whole = cov.reshape(*cov.shape, *(1,) * (more - cov.ndim + 2))
    if not missing.any():
        return whole
    either = missing[:, None] | missing[None, :]
    return np.where(either, np.eye(missing.shape[0]).reshape(*cov.shape[:2], *(1,) * more), whole)


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
