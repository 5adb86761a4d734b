"""Worked values of the bearing-only problem and its real evaluation file."""

import numpy as np
import pytest

from estlab.maths.finite_differences import hessian
from estlab.maths.linalg import cholesky
from estlab.maths.stacking import matrix
from estlab.maths.streams import Streams
from estlab.models import landmarks, odometry
from tests.conftest import estimate, metrics, settings, tallied

COMMAND, POSE, MARK = np.array([0.0, 10.0, 0.0]), np.array([180.0, 50.0, 0.0]), np.array([21.0, 0.0])


def _problem(*overrides):
    experiment = settings("scenario=field", *overrides)
    return experiment, experiment.scenario, experiment.noise


def _real(shared, filter):
    experiment, problem, noise = _problem(f"filter={filter}", "scenario.bearing_sd=0.35")
    record = problem.read(shared / "field", "", Streams(1, "field"), range(1))
    sensor = problem.sensor(noise.filter, record.landmarks)
    found = estimate(experiment.filter, problem.motion(noise.filter), sensor, record)
    return record, found, np.sqrt(((found.mean - record.truth)[:2] ** 2).sum(axis=0).mean())


def test_worked_noise_covariance_and_jacobians():
    _, problem, noise = _problem()
    motion = problem.motion(noise.filter)
    np.testing.assert_allclose(motion.noise_cov(COMMAND, 0.1), np.diag([1e-4, 0.25, 1e-4]), rtol=1e-12)
    in_pose, in_noise = (matrix(rows, ()) for rows in odometry.jacobians(POSE, COMMAND, 0.1))
    np.testing.assert_array_equal(in_pose, [[1, 0, 0], [0, 1, 10], [0, 0, 1]])
    np.testing.assert_array_equal(in_noise, [[0, 1, 0], [10, 0, 0], [1, 0, 1]])
    moved = motion.step(POSE, COMMAND, np.zeros(3), 0.1)
    np.testing.assert_array_equal(moved, [190.0, 50.0, 0.0])
    jacobian = matrix(landmarks.bearing_jacobian(moved, MARK), ())
    np.testing.assert_allclose(jacobian, [[-50 / 31061, 169 / 31061, -1.0]], rtol=1e-14)
    np.testing.assert_array_equal(np.round(jacobian, 4), [[-0.0016, 0.0054, -1.0]])
    sensor = problem.sensor(noise.filter, problem._landmarks)
    np.testing.assert_allclose(sensor.noise_cov, 0.1218, atol=5e-5)


def test_stated_hessians_are_the_second_differences():
    _, problem, noise = _problem()
    motion, sensor = problem.motion(noise.filter), problem.sensor(noise.filter, problem._landmarks)
    states = np.array([[190.0, 60.0], [50.0, 240.0], [0.3, -2.0]])
    control = np.array([0.4, 10.0, -0.2])
    for function in (motion.function(control, 0.1), sensor.function(sensor.landmark(np.array([0, 5])))):
        by_difference = hessian(function.evaluate, states, function.space)
        np.testing.assert_allclose(function.hessians(states), by_difference, atol=3e-6)


def test_a_robot_told_to_stay_has_noise_that_can_be_factored():
    _, problem, noise = _problem()
    still = problem.motion(noise.filter).noise_cov(np.zeros((3, 2)), 0.1)
    assert np.isfinite(cholesky(still)).all()
    np.testing.assert_allclose(np.einsum("ii...->i...", still), 1e-12)


def test_the_landmarks_take_turns_and_the_square_closes():
    _, problem, noise = _problem()
    record = problem.simulate(Streams(1, "field"), range(2), noise.truth)
    assert record.readings.landmark_number[:8, 0].tolist() == [0, 1, 1, 2, 2, 3, 3, 4]
    np.testing.assert_allclose(record.extra["commanded"][:2, -1], [180.0, 50.0], atol=1e-9)
    np.testing.assert_array_equal(
        record.control[:, [0, 19, 39], 0].T,
        np.array([[0, 10, 0], [np.pi / 4, 10, np.pi / 4], [np.pi / 4, 0, np.pi / 4]]),
    )


@pytest.mark.parametrize(("filter", "rms", "within"), [("ekf", 13.612, 1e-3), ("dead_reckoning", 22.74, 5e-3)])
def test_position_errors_on_the_real_file(shared, filter, rms, within):
    assert _real(shared, filter)[2] == pytest.approx(rms, abs=within)


def test_an_extended_filter_written_out_plainly_gives_the_same_on_the_real_file(shared):
    """A second implementation, from the file's own arrays and by the page: G, V, M, H, K."""
    _, found, _ = _real(shared, "ekf")
    with np.load(shared / "field" / "evaluation-input.npy", allow_pickle=False) as archive:
        motion, observed = archive["noise_free_motion"], archive["real_observations"]
    marks = [(21, 0), (242, 0), (463, 0), (463, 292), (242, 292), (21, 292)]
    a1, a2, a3, a4 = 0.05**2, 0.001**2, 0.05**2, 0.01**2
    (x, y, th), p = (180.0, 50.0, 0.0), 1e-12 * np.eye(3)
    for k, ((r1, d, r2), (z, number)) in enumerate(zip(motion, observed, strict=True)):
        c, s = np.cos(th + r1), np.sin(th + r1)
        g = np.array([[1, 0, -d * s], [0, 1, d * c], [0, 0, 1]])
        v = np.array([[-d * s, c, 0], [d * c, s, 0], [1, 0, 1]])
        m = np.diag([a1 * r1**2 + a2 * d**2, a3 * d**2 + a4 * (r1**2 + r2**2), a1 * r2**2 + a2 * d**2])
        x, y, th = x + d * c, y + d * s, th + r1 + r2
        p = g @ p @ g.T + v @ m @ v.T
        dx, dy = marks[int(number)][0] - x, marks[int(number)][1] - y
        h = np.array([dy / (dx**2 + dy**2), -dx / (dx**2 + dy**2), -1.0])
        kalman_gain = p @ h / (h @ p @ h + 0.35**2)
        off = (z - np.arctan2(dy, dx) + th + np.pi) % (2 * np.pi) - np.pi
        x, y, th = np.array([x, y, th]) + kalman_gain * off
        p = (np.eye(3) - np.outer(kalman_gain, h)) @ p
        np.testing.assert_allclose(found.mean[:2, k, 0], [x, y], atol=1e-6)
        assert np.cos(found.mean[2, k, 0] - th) == pytest.approx(1.0, abs=1e-12)
        np.testing.assert_allclose(found.cov[:, :, k, 0], p, atol=1e-6)


def _metrics(filter, runs, *overrides):
    experiment, problem, noise = _problem(f"filter={filter}", *overrides)
    record = problem.simulate(Streams(1, "field"), range(runs), noise.truth)
    sensor = problem.sensor(noise.filter, record.landmarks)
    found = estimate(experiment.filter, problem.motion(noise.filter), sensor, record)
    rows = {key: row.value for key, row in metrics(tallied(problem, record, found)).items()}
    last = problem.space.minus(found.mean[:, -1], record.truth[:, -1])
    return rows, (np.abs(last) <= 3.0 * np.sqrt(found.cov[range(3), range(3), -1])).sum(axis=1)


@pytest.mark.parametrize("filter", ["ukf", "second_order"])
def test_a_matched_filter_is_consistent(filter):
    """Mean NEES in its 99 % interval over the runs, which alone are independent; 99.73 % inside 3 sigma at the end."""
    runs = 400
    rows, inside = _metrics(filter, runs)
    # The deviation of a run's mean NEES / n is 0.45 at these lengths: NEES changes slowly within a run.
    assert abs(rows["anees", "all"] - 1.0) < 2.576 * 0.45 / np.sqrt(runs)
    # Of 400, a binomial of share 0.9973 is at least 395 with probability 0.9991.
    assert (inside >= 395).all()


def test_a_lost_robot_is_found_by_particles():
    rows, _ = _metrics("pf", 8, "scenario.prior=uniform", "filter.particles=2000")
    assert rows["found", "position"] >= 0.8


def test_a_known_robot_is_not_lost():
    _, problem, _ = _problem()
    assert problem.found_within is None


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("scenario.bearing_sd=0", "scenario.bearing_sd must be > 0"),
        ("scenario.alphas=[1,2,3]", "scenario.alphas must have 4 numbers, got 3"),
        ("scenario.alphas=[1,2,3,-4]", r"scenario.alphas\[3\] must be >= 0, got -4"),
        ("scenario.landmarks=[]", "scenario.landmarks must have at least one"),
        ("scenario.landmarks=[[1,2,3]]", r"scenario.landmarks\[0\] must have 2 numbers, got 3"),
        ("scenario.box_high=[0,10]", r"scenario.box_high\[0\] must be > box_low\[0\]=0, got 0"),
        ("scenario.prior_sd=[1,1,0]", r"scenario.prior_sd\[2\] must be > 0"),
        ("scenario.duration=0.01", "scenario.duration must be from one to ten million steps"),
    ],
)
def test_a_wrong_value_is_named(override, message):
    from estlab.errors import UserError

    with pytest.raises(UserError, match=message):
        _problem(override)
