"""Recorded truth is used where it can be trusted and nowhere else."""

import numpy as np

from estlab.datasets.truth import on_timeline, trusted_heading


def test_truth_is_linear_between_samples_and_never_over_a_gap():
    samples = np.array([0.0, 0.1, 0.2, 1.0, 1.1])
    values = np.array([[0.0, 1.0, 2.0, 10.0, 11.0]])
    found = on_timeline(np.array([-0.1, 0.05, 0.2, 0.5, 1.0, 1.05, 1.1, 1.2]), samples, values, (), 0.15)
    np.testing.assert_allclose(found[0], [np.nan, 0.5, 2.0, np.nan, 10.0, 10.5, 11.0, np.nan])


def test_a_heading_is_taken_the_short_way_round():
    found = on_timeline(np.array([0.5]), np.array([0.0, 1.0]), np.array([[3.1, -3.1]]), (0,), 2.0)
    np.testing.assert_allclose(np.abs(found), [[np.pi]], atol=1e-9)


def test_a_stretch_whose_heading_disagrees_with_the_course_is_refused():
    time = np.arange(0.0, 60.0, 0.02)
    heading = 0.1 * time
    x, y = np.cumsum(0.004 * np.cos(heading)), np.cumsum(0.004 * np.sin(heading))
    wrong = (time > 20.0) & (time < 30.0)
    good = trusted_heading(time, x, y, heading + 2.2 * wrong, 0.1)
    np.testing.assert_array_equal(good, ~wrong)


def test_a_robot_that_stands_is_trusted_unless_its_heading_jumps():
    time = np.arange(0.0, 10.0, 0.02)
    still = np.zeros_like(time)
    assert trusted_heading(time, still, still, still, 0.1).all()
    jump = (time > 4.0) & (time < 5.0)
    assert not trusted_heading(time, still, still, 2.0 * jump, 0.1)[jump].any()
