"""The kidnapped robot's models and its simulated drive."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estlab.maths.space import TURN
from estlab.maths.streams import Streams
from estlab.models import sonar_beams
from estlab.scenarios.scenario import Scales
from tests.conftest import settings

PLACE = st.tuples(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0))


@given(PLACE, st.lists(PLACE, min_size=3, max_size=8))
def test_the_ranges_are_the_three_smallest_of_all_in_order(at, beacons):
    brute = sorted(np.hypot(x - at[0], y - at[1]) for x, y in beacons)[:3]
    found = sonar_beams.nearest_ranges(np.array([*at, 0.3]), np.array(beacons).T)
    np.testing.assert_allclose(found, brute, rtol=1e-12, atol=1e-12)


def test_a_batch_is_each_of_its_members():
    rng = np.random.default_rng(3)
    poses, beacons = rng.uniform(-5.0, 20.0, (3, 4, 6)), rng.uniform(-5.0, 20.0, (2, 5))
    together = np.stack(sonar_beams.nearest_ranges(poses, beacons))
    jacobians = [np.broadcast_arrays(*row, poses[0])[:3] for row in sonar_beams.nearest_ranges_jacobian(poses, beacons)]
    for i in range(4):
        for j in range(6):
            np.testing.assert_array_equal(together[:, i, j], sonar_beams.nearest_ranges(poses[:, i, j], beacons))
            alone = np.array(sonar_beams.nearest_ranges_jacobian(poses[:, i, j], beacons))
            np.testing.assert_allclose([[entry[i, j] for entry in row] for row in jacobians], alone, rtol=1e-15)


def test_a_robot_turns_before_it_moves():
    found = sonar_beams.turn_and_move(np.array([1.0, 2.0, 0.0]), np.array([3.0, np.pi / 2]), np.zeros(2), 0.1)
    np.testing.assert_allclose(found, [1.0, 5.0, np.pi / 2], atol=1e-15)


def simulated(noise=None, *overrides):
    problem = settings("scenario=sonar", *overrides).scenario
    noise = noise or Scales(1.0, 1.0)
    return problem, problem.simulate(Streams(1, "sonar"), range(60), noise)


def test_robots_stay_on_the_map_and_begin_anywhere_on_it():
    problem, record = simulated()
    low_x, high_x, low_y, high_y = problem.bounds
    x, y, _ = record.truth
    assert low_x < x.min() < x.max() < high_x
    assert low_y < y.min() < y.max() < high_y
    width = high_x - low_x - 2.0 * problem.margin
    for first in (x[0], y[0]):
        # The spread of 60 uniform numbers is known to about a tenth.
        assert first.std() == pytest.approx(width / np.sqrt(12.0), rel=0.2)
    np.testing.assert_array_equal(record.prior.low, [low_x, low_y, 0.0])
    np.testing.assert_array_equal(record.prior.high, [high_x, high_y, TURN])


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_encoders_and_sonar_are_off_by_their_noise_at_each_step_whatever_its_length(scale):
    for dt in (0.1, 0.4):
        problem, record = simulated(Scales(scale, 2.0 * scale), f"scenario.dt={dt}")
        before, after = record.truth[:, :-1], record.truth[:, 1:]
        turn = problem.space.minus(after, before)[2]
        way = np.hypot(*(after - before)[:2])
        off = record.control[:, 1:] - np.stack([way, turn])
        np.testing.assert_allclose(off.reshape(2, -1).std(axis=1), scale * np.array(problem.process_sd), rtol=0.05)
        np.testing.assert_allclose(off.reshape(2, -1).mean(axis=1), 0.0, atol=scale * 0.01)
        exact = np.stack(sonar_beams.nearest_ranges(record.truth, record.landmarks))
        error = record.readings.values - exact
        np.testing.assert_allclose(error.reshape(3, -1).std(axis=1), 2.0 * scale, rtol=0.05)


def test_filters_assume_the_noise_they_are_told():
    problem, _ = simulated()
    motion, sensor = problem.motion(Scales(2.0, 3.0)), problem.sensor(Scales(2.0, 3.0), np.zeros((2, 3)))
    np.testing.assert_allclose(motion.noise_cov(np.zeros(2), 0.7), np.diag([0.2**2, np.radians(10.0) ** 2]))
    np.testing.assert_allclose(sensor.noise_cov, 9.0 * np.eye(3))
