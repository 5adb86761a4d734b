import numpy as np

from estlab.maths.linalg import block_diagonal, cholesky, sandwich, solve_lower


def _matrices(n, batch, seed=0):
    a = np.random.default_rng(seed).standard_normal((n, n, *batch))
    return np.einsum("ik...,jk...->ij...", a, a) + 0.1 * np.eye(n).reshape(n, n, *(1,) * len(batch))


def test_cholesky_is_numpys_for_every_member():
    p = _matrices(5, (4, 7))
    expected = np.linalg.cholesky(np.moveaxis(p, (0, 1), (-2, -1)))
    np.testing.assert_allclose(np.moveaxis(cholesky(p), (0, 1), (-2, -1)), expected, rtol=1e-12)


def test_a_member_that_is_not_positive_definite_becomes_nan_and_its_neighbours_go_on():
    p = _matrices(4, (5,))
    p[2, 2, 3] = -1.0
    factor = cholesky(p)
    assert np.isnan(factor[..., 3]).all()
    np.testing.assert_array_equal(factor[..., [0, 1, 2, 4]], cholesky(p[..., [0, 1, 2, 4]]))


def test_forward_substitution_solves():
    factor, b = cholesky(_matrices(4, (6,))), np.random.default_rng(1).standard_normal((4, 3, 6))
    np.testing.assert_allclose(np.einsum("ik...,kj...->ij...", factor, solve_lower(factor, b)), b, atol=1e-12)


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
