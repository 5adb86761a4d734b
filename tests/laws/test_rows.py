"""Matrices as rows of components, against the same matrices with every entry an array."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estlab.maths.stacking import matrix, stacked, through

MANY = 8
CONSTANTS = [0.0, 1.0, -1.0, -0.0, 2.5, 1]
ARRAY = "an array over the batch"


def _rows(pattern, seed=1):
    """Rows in which ARRAY stands for numbers of the members' own."""
    rng = np.random.default_rng(seed)
    return [[rng.standard_normal(MANY) if entry is ARRAY else entry for entry in row] for row in pattern]


def _of_member(rows, i):
    return [[entry[i] if isinstance(entry, np.ndarray) else entry for entry in row] for row in rows]


def _covs(n, seed=2):
    a = np.random.default_rng(seed).standard_normal((n, n, MANY))
    return np.einsum("ik...,jk...->ij...", a, a)


def _dense(rows, cov):
    """A P and A P A' with nothing left out."""
    a = np.stack([np.stack([np.broadcast_to(entry, MANY) for entry in row]) for row in rows]).astype(float)
    p = np.broadcast_to(cov[..., None] if cov.ndim == 2 else cov, (*cov.shape[:2], MANY))
    return np.einsum("ik...,kj...->ij...", a, p), np.einsum("ik...,kl...,jl...->ij...", a, p, a)


def _check(rows, cov):
    """Among many and for each alone the dense products, alike to the last bit."""
    half, spread = through(rows, cov, (MANY,))
    expected_half, expected = _dense(rows, cov)
    np.testing.assert_allclose(matrix(half, (MANY,)), expected_half, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(spread, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(spread, np.swapaxes(spread, 0, 1))
    for i in range(MANY):
        own = cov if cov.ndim == 2 else cov[..., i].copy()
        half_alone, alone = through(_of_member(rows, i), own, ())
        np.testing.assert_array_equal(alone, spread[..., i])
        np.testing.assert_array_equal(half_alone, matrix(half, (MANY,))[..., i])


@st.composite
def patterns(draw):
    """Rows (m, n) of constants and arrays."""
    m, n = draw(st.integers(1, 5)), draw(st.integers(1, 5))
    entry = st.sampled_from([*CONSTANTS, ARRAY])
    return draw(st.lists(st.lists(entry, min_size=n, max_size=n), min_size=m, max_size=m))


@given(patterns())
def test_a_covariance_goes_through_rows_as_through_the_dense_matrix(pattern):
    _check(_rows(pattern), _covs(len(pattern[0])))


@given(patterns(), st.booleans())
def test_a_constant_covariance_goes_through_rows_as_through_the_dense_matrix(pattern, diagonal):
    cov = _covs(len(pattern[0]))[..., 0]
    _check(_rows(pattern), np.diag(np.diag(cov)) if diagonal else cov)


def test_a_constant_covariance_may_have_zeros_and_ones():
    """They are left out as the rows' constants are."""
    cov = np.array([[1.0, 0.0, -1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 4.0]])
    _check(_rows([[ARRAY, 1.0, -1.0], [0.0, ARRAY, 0.0], [-1.0, -1.0, -1.0]]), cov)


def test_rows_of_nothing_but_zeros_give_zeros():
    rows = [[0.0, 0.0], [1.0, 0.0]]
    for cov in (_covs(2), _covs(2)[..., 0]):
        half, spread = through(rows, cov, (MANY,))
        np.testing.assert_array_equal(spread[0], 0.0)
        np.testing.assert_array_equal(matrix(half, (MANY,))[0], 0.0)
        np.testing.assert_array_equal(spread[1, 1], np.broadcast_to(cov[0, 0], MANY))


@pytest.mark.parametrize("where", ["rows", "cov"])
def test_a_member_that_is_not_a_number_keeps_that_to_itself(where):
    rows, cov = _rows([[ARRAY, 1.0, 0.0], [-1.0, ARRAY, ARRAY]]), _covs(3)
    _, sound = through(rows, cov, (MANY,))
    if where == "rows":
        rows[1][2][5] = np.nan
    else:
        cov[2, 2, 5] = np.nan
    _, found = through(rows, cov, (MANY,))
    assert np.isnan(found[1, 1, 5])
    np.testing.assert_array_equal(np.delete(found, 5, axis=2), np.delete(sound, 5, axis=2))


def test_the_rows_may_be_an_array_as_jacobians_by_differences_are():
    a, cov = np.random.default_rng(3).standard_normal((2, 3, MANY)), _covs(3)
    _check(a, cov)


@pytest.mark.parametrize("batch", [(), (1,), (4,), (3, 4)])
def test_components_are_stacked_whether_they_are_numbers_or_arrays(batch):
    own = np.random.default_rng(4).standard_normal(batch)
    np.testing.assert_array_equal(stacked((1.5, own), batch), np.stack([np.full(batch, 1.5), own]))
    found = matrix([[0.0, own], [own, -1.0]], batch)
    np.testing.assert_array_equal(found, [[np.zeros(batch), own], [own, np.full(batch, -1.0)]])
