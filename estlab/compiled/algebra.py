"""Algebra of small matrices whose entries are components of a trace: rows of components, as in a textbook.

An entry that is zero by construction is Python's 0.0. It costs nothing, and its products are 0.0 again. So a run with
a number that is not finite may keep finite numbers that NumPy would lose; the caller of the code checks for this.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

Entry = Any  # a Symbol, or 0.0
Row = list[Entry]
Matrix = list[Row]

TURN = 6.283185307179586


def is_zero(a: Entry) -> bool:
    """Whether an entry is zero by construction."""
    return type(a) is float and a == 0.0


def plus(a: Entry, b: Entry) -> Entry:
    """a + b."""
    return b if is_zero(a) else a if is_zero(b) else a + b


def minus(a: Entry, b: Entry) -> Entry:
    """a - b; equal expressions give zero."""
    if is_zero(b):
        return a
    if is_zero(a):
        return -b
    return 0.0 if getattr(a, "number", None) == getattr(b, "number", -1) else a - b


def times(a: Entry, b: Entry) -> Entry:
    """a b."""
    return 0.0 if is_zero(a) or is_zero(b) else a * b


def total(terms: Iterable[Entry]) -> Entry:
    """Their sum, in order."""
    found: Entry = 0.0
    for term in terms:
        found = plus(found, term)
    return found


def inner(a: Sequence[Entry], b: Sequence[Entry]) -> Entry:
    """The sum of products."""
    return total(times(x, y) for x, y in zip(a, b, strict=True))


def matmul(a: Matrix, b: Matrix) -> Matrix:
    """A B."""
    columns = transpose(b, len(b[0]) if b else 0)
    return [[inner(row, column) for column in columns] for row in a]


def transpose(a: Matrix, columns: int) -> Matrix:
    """A', for A with this number of columns."""
    return [[row[j] for row in a] for j in range(columns)]


def symmetric(size: int, entry: Callable[[int, int], Entry]) -> Matrix:
    """The matrix whose entry (i, j) with j <= i is given."""
    rows: Matrix = []
    for i in range(size):
        rows.append([entry(i, j) for j in range(i + 1)])
    return [[rows[max(i, j)][min(i, j)] for j in range(size)] for i in range(size)]


def gram(a: Matrix) -> Matrix:
    """A A'."""
    return symmetric(len(a), lambda i, j: inner(a[i], a[j]))


def sandwich(a: Matrix, p: Matrix) -> tuple[Matrix, Matrix]:
    """A P and A P A', for a symmetric P."""
    half = matmul(a, p)
    return half, symmetric(len(a), lambda i, j: inner(half[i], a[j]))


def added(a: Matrix, b: Matrix) -> Matrix:
    """A + B, both symmetric."""
    return symmetric(len(a), lambda i, j: plus(a[i][j], b[i][j]))


def block_diagonal(p: Matrix, q: Matrix) -> Matrix:
    """[P 0; 0 Q]."""
    n, m = len(p), len(q)
    return [[*row, *[0.0] * m] for row in p] + [[*[0.0] * n, *row] for row in q]


class Pivots(list[Any]):
    """Conditions that should be false: where one is true there is no factor."""


def cholesky(p: Matrix, failed: Pivots, root: Callable[[Any], Any]) -> Matrix:
    """L lower with L L' = P. Where P is not positive definite, ``failed`` gets a condition that is true."""
    n = len(p)
    factor: Matrix = [[0.0] * n for _ in range(n)]
    for j in range(n):
        square = p[j][j]
        for k in range(j):
            square = minus(square, times(factor[j][k], factor[j][k]))
        failed.append(~(square > 0.0))
        factor[j][j] = root(square)
        inverse = 1.0 / factor[j][j]
        for i in range(j + 1, n):
            entry = p[i][j]
            for k in range(j):
                entry = minus(entry, times(factor[i][k], factor[j][k]))
            factor[i][j] = times(entry, inverse)
    return factor


def solve_lower(factor: Matrix, b: Matrix) -> Matrix:
    """L^-1 B."""
    found: Matrix = []
    for i, row in enumerate(factor):
        inverse = 1.0 / row[i]
        rest = list(b[i])
        for k in range(i):
            rest = [minus(entry, times(row[k], known)) for entry, known in zip(rest, found[k], strict=True)]
        found.append([times(entry, inverse) for entry in rest])
    return found


def solve_lower_transposed(factor: Matrix, b: Matrix) -> Matrix:
    """L'^-1 B."""
    n = len(factor)
    found: Matrix = [[] for _ in range(n)]
    for i in reversed(range(n)):
        inverse = 1.0 / factor[i][i]
        rest = list(b[i])
        for k in range(i + 1, n):
            rest = [minus(entry, times(factor[k][i], known)) for entry, known in zip(rest, found[k], strict=True)]
        found[i] = [times(entry, inverse) for entry in rest]
    return found


def triangle(columns: Matrix, failed: Pivots, root: Callable[[Any], Any]) -> Matrix:
    """The lower L with L L' = A A', by the modified Gram-Schmidt process along the rows of A (n, p)."""
    n = len(columns)
    rest = [list(row) for row in columns]
    factor: Matrix = [[0.0] * n for _ in range(n)]
    for j in range(n):
        square = inner(rest[j], rest[j])
        failed.append(~(square > 0.0))
        factor[j][j] = root(square)
        inverse = 1.0 / factor[j][j]
        unit = [times(entry, inverse) for entry in rest[j]]
        for i in range(j + 1, n):
            factor[i][j] = inner(rest[i], unit)
            rest[i] = [minus(entry, times(factor[i][j], along)) for entry, along in zip(rest[i], unit, strict=True)]
    return factor
