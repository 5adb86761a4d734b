"""Small matrices: against NumPy's, and each member of a batch what it is alone, to the last bit."""

import numpy as np
import pytest

from estlab.maths.linalg import (
    block_diagonal,
    cholesky,
    gram,
    matmul,
    matvec,
    mirrored,
    sandwich,
    solve_lower,
    solve_lower_transposed,
    summed,
    transpose,
)

SIZES = range(1, 7)
MANY = 9


def _normals(*shape, seed=0):
    return np.random.default_rng(seed).standard_normal(shape)


def _matrices(n, batch, seed=0):
    a = _normals(n, n, *batch, seed=seed)
    return np.einsum("ik...,jk...->ij...", a, a) + 0.1 * np.eye(n).reshape(n, n, *(1,) * len(batch))


def _each_alone(function, *operands):
    """What a function of (n, m, many) or, where constant, (n, m) gives among many; it must be what it gives of one.

    Bit for bit, whether the one has no axis of batch or one of length one.
    """
    together = function(*operands)
    for i in range(MANY):
        unbatched = function(*(a if a.ndim == 2 else a[..., i].copy() for a in operands))
        of_one = function(*(a if a.ndim == 2 else a[..., i : i + 1].copy() for a in operands))
        np.testing.assert_array_equal(unbatched, together[..., i])
        np.testing.assert_array_equal(of_one, together[..., i : i + 1])
    return together


def _added(terms, axis):
    """The sum written out."""
    total = np.zeros(np.delete(terms.shape, axis))
    for entry in np.moveaxis(terms, axis, 0):
        total = total + entry
    return total


@pytest.mark.parametrize("batch", [(), (0,), (1,), (2,), (50,), (1, 1), (3, 1), (1, 4)])
@pytest.mark.parametrize("entries", [0, 1, 2, 3, 8, 9, 40])
def test_summed_adds_one_after_another(batch, entries):
    for axis, shape in enumerate([(entries, 3, 2), (3, entries, 2), (3, 2, entries), (1, 1, entries)]):
        axis = min(axis, 2)
        terms = _normals(*shape, *batch)
        found = summed(terms, axis)
        assert found.shape == tuple(np.delete(terms.shape, axis))
        np.testing.assert_array_equal(found, _added(terms, axis))


def test_summed_adds_in_one_order_of_matrices_transposed_reversed_or_part_of_others():
    terms = _normals(40, 3, 7)
    for same in (transpose(transpose(terms).copy()), terms[::-1].copy()[::-1], np.repeat(terms, 2, axis=0)[::2]):
        np.testing.assert_array_equal(summed(same, 0), _added(terms, 0))
        np.testing.assert_array_equal(summed(transpose(same), 1), _added(terms, 0))


def test_the_order_of_a_sum_is_seen_in_its_last_bit():
    """Were NumPy's own sum the same number, the laws above would claim nothing."""
    terms = _normals(40)
    assert terms.sum() != summed(terms, 0)


@pytest.mark.parametrize("n", SIZES)
def test_products_of_one_member_are_those_among_many(n):
    a, b = _normals(n, 2 * n, MANY), _normals(2 * n, 3, MANY, seed=1)
    cases = [(a, b), (a[..., 0], b), (a, b[..., 0])]
    for left, right in cases:
        product = _each_alone(matmul, left, right)
        np.testing.assert_allclose(product, np.einsum("ik...,kj...->ij...", *_batched(left, right)), atol=1e-13)
        half = _each_alone(lambda x, y: matvec(x, y[:, 0]), left, right)
        np.testing.assert_array_equal(half, product[:, 0])
    np.testing.assert_array_equal(matmul(a[..., 0], b[..., 0]), matmul(a, b)[..., 0])


def _batched(*operands):
    return [a if a.ndim > 2 else np.repeat(a[..., None], MANY, axis=2) for a in operands]


def test_a_product_over_nothing_is_zero():
    np.testing.assert_array_equal(matmul(np.empty((2, 0, 5)), np.empty((0, 3))), np.zeros((2, 3, 5)))


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("points", [1, 2, 3, 13, 27])
def test_gram_matrices_of_one_member_are_those_among_many(n, points):
    a, b, weights = _normals(n, points, MANY), _normals(3, points, MANY, seed=1), _normals(points, seed=2)
    square = _each_alone(gram, a)
    np.testing.assert_allclose(square, np.einsum("ip...,jp...->ij...", a, a), atol=1e-12)
    np.testing.assert_array_equal(square, transpose(square))
    both = _each_alone(gram, a, b)
    np.testing.assert_allclose(both, np.einsum("ip...,jp...->ij...", a, b), atol=1e-12)
    weighted = _each_alone(lambda x: gram(x, weights=weights.reshape(-1, *(1,) * (x.ndim - 2))), a)
    np.testing.assert_allclose(weighted, np.einsum("p,ip...,jp...->ij...", weights, a, a), atol=1e-12)
    np.testing.assert_array_equal(weighted, transpose(weighted))


@pytest.mark.parametrize("n", SIZES)
def test_mirrored_keeps_the_lower_triangle_and_repeats_it_above(n):
    a = _normals(n, n, MANY)
    found = _each_alone(lambda x: mirrored(x.copy()), a)
    for i in range(n):
        for j in range(n):
            np.testing.assert_array_equal(found[i, j], a[max(i, j), min(i, j)])


def test_cholesky_is_numpys_for_every_member():
    p = _matrices(5, (4, 7))
    expected = np.linalg.cholesky(np.moveaxis(p, (0, 1), (-2, -1)))
    np.testing.assert_allclose(np.moveaxis(cholesky(p), (0, 1), (-2, -1)), expected, rtol=1e-12)


@pytest.mark.parametrize("n", SIZES)
def test_the_factor_of_one_member_is_that_among_many_whatever_the_others_are(n):
    p = _matrices(n, (MANY,))
    p[n // 2, :, 2] = p[:, n // 2, 2] = 0.0  # no variance in one component
    p[..., 3] = 0.0  # nor in any
    p[n - 1, n - 1, 4] = -1.0  # not definite in the last pivot
    p[0, 0, 5] = -1.0  # nor in the first
    p[n - 1, n - 1, 6] = np.inf
    p[n - 1, n - 1, 7] = np.nan
    factor = _each_alone(cholesky, p)
    lost = np.isnan(factor)
    np.testing.assert_array_equal(lost.any(axis=(0, 1)), np.arange(MANY) // 4 == 1)
    np.testing.assert_array_equal(lost.all(axis=(0, 1)), lost.any(axis=(0, 1)))
    np.testing.assert_allclose(_square(factor)[..., [0, 1, 2, 3, 8]], p[..., [0, 1, 2, 3, 8]], atol=1e-12)


def _square(factor):
    return np.einsum("ik...,jk...->ij...", factor, factor)


def test_a_component_without_variance_that_varies_with_another_has_no_factor():
    p = np.stack([np.array([[0.0, 0.1], [0.1, 1.0]]), np.eye(2)], axis=2)
    factor = cholesky(p)
    assert np.isnan(factor[..., 0]).all()
    np.testing.assert_array_equal(factor[..., 1], np.eye(2))
    assert np.isnan(cholesky(p[..., 0])).all()


def test_the_factor_of_nothing_is_nothing():
    for batch in ((), (1,), (3,)):
        assert cholesky(np.empty((0, 0, *batch))).shape == (0, 0, *batch)
    assert cholesky(np.empty((3, 3, 0))).shape == (3, 3, 0)


def test_a_member_that_is_not_positive_definite_becomes_nan_and_its_neighbours_go_on():
    p = _matrices(4, (5,))
    p[2, 2, 3] = -1.0
    factor = cholesky(p)
    assert np.isnan(factor[..., 3]).all()
    np.testing.assert_array_equal(factor[..., [0, 1, 2, 4]], cholesky(p[..., [0, 1, 2, 4]]))


@pytest.mark.parametrize("n", SIZES)
def test_substitution_solves_and_one_member_alone_as_among_many(n):
    factor, b = cholesky(_matrices(n, (MANY,))), _normals(n, 3, MANY, seed=1)
    for left, right in [(factor, b), (factor[..., 0], b), (factor, b[..., 0])]:
        whole, rest = _batched(left, right)
        forward = _each_alone(solve_lower, left, right)
        np.testing.assert_allclose(np.einsum("ik...,kj...->ij...", whole, forward), rest, atol=1e-10)
        backward = _each_alone(solve_lower_transposed, left, right)
        np.testing.assert_allclose(np.einsum("ki...,kj...->ij...", whole, backward), rest, atol=1e-10)
    for solve in (solve_lower, solve_lower_transposed):
        np.testing.assert_array_equal(solve(factor[..., 0], b[..., 0]), solve(factor, b)[..., 0])


def test_a_member_without_a_factor_has_no_solution_and_its_neighbours_have_theirs():
    factor, b = cholesky(_matrices(3, (MANY,))), _normals(3, 2, MANY, seed=1)
    broken = factor.copy()
    broken[..., 4] = np.nan
    for solve in (solve_lower, solve_lower_transposed):
        found, expected = _each_alone(solve, broken, b), solve(factor, b)
        assert np.isnan(found[..., 4]).all()
        np.testing.assert_array_equal(np.delete(found, 4, axis=2), np.delete(expected, 4, axis=2))


def test_sandwich_takes_a_constant_covariance_and_stays_symmetric():
    a, q = np.random.default_rng(3).standard_normal((3, 2, 5)), np.array([[2.0, 0.3], [0.3, 1.0]])
    found = sandwich(a, q)
    np.testing.assert_allclose(found[..., 4], a[..., 4] @ q @ a[..., 4].T, rtol=1e-12)
    np.testing.assert_array_equal(found, np.swapaxes(found, 0, 1))


def test_block_diagonal_joins_batched_and_constant():
    joint = block_diagonal(_matrices(2, (3,)), np.eye(2))
    assert joint.shape == (4, 4, 3)
    np.testing.assert_array_equal(joint[2:, 2:, 1], np.eye(2))
    np.testing.assert_array_equal(joint[:2, 2:], 0.0)


def test_whole_numbers_have_factors_too():
    p = np.array([[4, 2], [2, 2]])
    many = np.repeat(p[..., None], 3, axis=2)
    np.testing.assert_array_equal(cholesky(many)[..., 1], cholesky(p))
    np.testing.assert_array_equal(cholesky(p), [[2.0, 0.0], [1.0, 1.0]])
