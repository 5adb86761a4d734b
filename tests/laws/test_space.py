import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from estlab.maths.space import Space, wrap

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
