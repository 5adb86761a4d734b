import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from estlab.maths.space import Space, cos_sin, wrap

POSE = Space(("x", "heading"), ("m", "rad"), angles=(1,))
moderate = st.floats(-50.0, 50.0)
vectors = arrays(float, (2, 3), elements=moderate)


@given(vectors, vectors)
def test_minus_undoes_plus(a, step):
    step[1] = wrap(step[1])
    found = POSE.minus(POSE.plus(a, step), a)
    gap = found - step
    gap[1] = wrap(gap[1])  # half a turn to either side is the same step
    np.testing.assert_allclose(gap, 0.0, atol=1e-12)


@given(moderate)
def test_wrap_is_the_same_angle_within_half_a_turn(angle):
    assert -np.pi <= wrap(angle) <= np.pi
    np.testing.assert_allclose([np.cos(wrap(angle)), np.sin(wrap(angle))], [np.cos(angle), np.sin(angle)], atol=1e-12)


@given(st.floats(-10, 10), arrays(float, (2, 5), elements=st.floats(-1.0, 1.0)))
def test_mean_of_headings_turns_with_them(turn, points):
    weights = np.array([0.1, 0.3, 0.2, 0.15, 0.25])
    shift = np.array([0.0, turn])[:, None]
    turned = POSE.mean(POSE.plus(points, shift), weights)
    np.testing.assert_allclose(POSE.minus(turned, POSE.mean(points, weights) + shift[:, 0]), 0.0, atol=1e-9)


@given(vectors)
def test_wrapping_changes_angles_by_whole_turns_and_nothing_else(a):
    turns = (POSE.wrapped(a) - a) / (2 * np.pi)
    np.testing.assert_array_equal(turns[0], 0.0)
    np.testing.assert_allclose(turns[1], np.rint(turns[1]), atol=1e-12)


def test_repeated_space_keeps_its_angles():
    twice = POSE.repeat(2)
    assert twice.angles == (1, 3)
    assert twice.names == ("x[0]", "heading[0]", "x[1]", "heading[1]")


QUARTERS = 0.5 * np.pi * np.arange(-8, 9)
# Through 200 turns either way, at the quarters of some and as near to them as numbers come, and near zero.
ANGLES = np.concatenate(
    [
        np.linspace(-400.0 * np.pi, 400.0 * np.pi, 100_003),
        *(QUARTERS, np.nextafter(QUARTERS, np.inf), np.nextafter(QUARTERS, -np.inf), QUARTERS + 1e-8),
        *(10.0 ** np.arange(-300, 0, 7), -(10.0 ** np.arange(-300, 0, 7))),
    ]
)


def test_cosine_and_sine_by_the_tangent_of_the_half_are_numpys():
    cos, sin = cos_sin(ANGLES)
    np.testing.assert_allclose(cos, np.cos(ANGLES), rtol=0.0, atol=4e-16)
    np.testing.assert_allclose(sin, np.sin(ANGLES), rtol=0.0, atol=4e-16)


def test_the_half_turn_has_a_cosine_and_a_sine_though_the_tangent_of_its_half_has_none():
    for angle in (np.pi, -np.pi, 3.0 * np.pi):
        cos, sin = cos_sin(angle)
        assert abs(cos + 1.0) < 4e-16
        assert abs(sin - np.sin(angle)) < 4e-16


def test_the_sine_of_a_small_angle_keeps_all_of_its_digits():
    small = 10.0 ** np.linspace(-300.0, -2.0, 500)
    np.testing.assert_allclose(cos_sin(small)[1], np.sin(small), rtol=4e-16, atol=0.0)


def test_cosine_and_sine_of_a_number_are_those_of_the_same_number_in_an_array():
    some = np.concatenate([ANGLES[::97], ANGLES[-200:]])
    together = np.stack(cos_sin(some))
    np.testing.assert_array_equal(np.stack([cos_sin(angle) for angle in some], axis=1), together)
    np.testing.assert_array_equal(np.stack([cos_sin(float(angle)) for angle in some], axis=1), together)
    np.testing.assert_array_equal(
        np.concatenate([cos_sin(some[i : i + 1]) for i in range(some.size)], axis=1), together
    )
    np.testing.assert_array_equal(np.stack(cos_sin(np.repeat(some, 3)[::3])), together)


def test_an_angle_that_is_not_a_number_has_neither():
    with np.errstate(invalid="ignore"):
        assert np.isnan(cos_sin(np.array([np.nan, np.inf, -np.inf]))).all()


@pytest.mark.parametrize("angles", [(), (0,), (3,), (1, 2), (0, 2), (0, 1, 3), (0, 1, 2, 3), (2, 1)])
@pytest.mark.parametrize("batch", [(), (1,), (5,), (3, 5)])
def test_angles_wrap_wherever_they_stand_and_the_rest_does_not(angles, batch):
    space = Space(tuple("abcd"), ("",) * 4, angles=angles)
    a, b = 20.0 * np.random.default_rng(8).standard_normal((2, 4, *batch))
    before = a.copy(), b.copy()
    for found, plain in ((space.minus(a, b), a - b), (space.plus(a, b), a + b), (space.wrapped(a), a)):
        expected = [wrap(part) if i in angles else part for i, part in enumerate(plain)]
        np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal((a, b), before)


def test_a_difference_is_the_same_for_vectors_that_broadcast():
    space = Space(tuple("abc"), ("",) * 3, angles=(1, 2))
    points, mean = 9.0 * np.random.default_rng(9).standard_normal((3, 7, 5)), np.array([1.0, 3.0, -3.0])
    whole = np.broadcast_to(mean[:, None, None], points.shape)
    np.testing.assert_array_equal(space.minus(points, mean[:, None, None]), space.minus(points, whole))
    np.testing.assert_array_equal(space.plus(mean[:, None, None], points), space.plus(whole, points))
