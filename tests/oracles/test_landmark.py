"""Worked values of the landmark problem and the real UTIAS recordings."""

import numpy as np
import pytest

from estlab.datasets import mrclam
from estlab.maths.streams import Streams
from estlab.models import landmarks, unicycle
from estlab.models.contract import Motion, Sensor
from tests.conftest import estimate, metrics, settings, tallied

WORKED = [
    ((2.0, 3.0, 0.0), 6, 8.573, -1.585),
    ((0.0, 3.0, 0.0), 13, 4.129, -0.729),
    ((1.0, -2.0, 0.0), 17, 5.216, 1.973),
]


@pytest.mark.parametrize(("pose", "subject", "distance", "bearing"), WORKED)
def test_worked_ranges_and_bearings(shared, pose, subject, distance, bearing):
    recording = mrclam.read(shared / "me469_ds1", "ds1_", 0.01)
    mark = recording.landmarks[:, recording.subjects == subject][:, 0]
    np.testing.assert_allclose(landmarks.range_bearing(np.array(pose), mark), [distance, bearing], atol=5e-4)


def test_the_sample_commands_end_where_the_arithmetic_says():
    commands = [(0.5, 0.0), (0.0, -1 / (2 * np.pi)), (0.5, 0.0), (0.0, 1 / (2 * np.pi)), (0.5, 0.0)]
    pose = np.zeros(3)
    for command in commands:
        pose = np.array(unicycle.arc(pose, np.array(command), np.zeros(2), 1.0))
    turn = 1 / (2 * np.pi)
    np.testing.assert_allclose(pose, [1.0 + 0.5 * np.cos(turn), -0.5 * np.sin(turn), 0.0], atol=1e-12)


def test_the_motion_is_linear_in_its_speed_and_not_in_its_turn_rate():
    """Document 003, question 1, with the numbers of docs/problems/landmark.md."""

    def moved(*command):
        return np.array(unicycle.arc(np.zeros(3), np.array(command), np.zeros(2), 1.0))

    np.testing.assert_allclose(moved(0.5, 0.4), [0.4868, 0.0987, 0.4], atol=5e-5)
    np.testing.assert_allclose(moved(1.0, 0.4)[:2], 2.0 * moved(0.5, 0.4)[:2], atol=1e-15)
    np.testing.assert_allclose(moved(0.5, 0.8), [0.4483, 0.1896, 0.8], atol=5e-5)
    assert not np.allclose(moved(0.5, 0.0) + moved(0.0, 0.4), moved(0.5, 0.4), atol=0.01)


def _position_rms(shared, folder, prefix, filter):
    experiment = settings("scenario=landmark", "data=files", f"data.path={shared / folder}", f"filter={filter}")
    problem = experiment.scenario
    record = problem.read(shared / folder, prefix, Streams(1, "landmark"), range(1))
    sensor = problem.sensor(experiment.noise.filter, record.landmarks)
    found = estimate(experiment.filter, problem.motion(experiment.noise.filter), sensor, record, *problem.scheme)
    error2 = ((found.mean - record.truth)[:2] ** 2).sum(axis=0)
    return np.sqrt(np.nanmean(error2)), np.isfinite(error2).mean(), np.isfinite(record.truth).all(axis=0).mean()


def test_a_filter_follows_the_real_robot(shared):
    rms, scored, whole = _position_rms(shared, "me469_ds1", "ds1_", "ekf")
    assert rms < 0.2
    assert 0.96 < scored < 0.98, "steps in gaps of the truth are not scored"
    assert 0.86 < whole < 0.89, "a tenth of the time the recorded heading is wrong"


def test_an_extended_filter_written_out_plainly_gives_the_same_on_the_real_robot(shared):
    """A second implementation, per event and by hand, of the sequential EKF."""
    experiment = settings("scenario=landmark", "data=files", "data.path=.", "scenario.initial=truth", "filter=ekf")
    problem = experiment.scenario
    record = problem.read(shared / "me469_ds1", "ds1_", Streams(1, "landmark"), range(1)).first(1500)
    sensor = problem.sensor(experiment.noise.filter, record.landmarks)
    found = estimate(experiment.filter, problem.motion(experiment.noise.filter), sensor, record, *problem.scheme)

    pose, p, now = record.prior.mean[:, 0], record.prior.cov, record.start
    r = np.diag([0.3**2, 0.15**2])
    bounds = record.readings.bounds(1500)
    for k in range(1500):
        dt, (v, w) = record.time[k] - now, record.control[:, k, 0]
        now = record.time[k]
        x, y, th = pose
        if abs(w) > 1e-9:
            radius, end = v / w, th + w * dt
            pose = np.array([x + radius * (np.sin(end) - np.sin(th)), y + radius * (np.cos(th) - np.cos(end)), end])
            f = np.array(
                [[1, 0, radius * (np.cos(end) - np.cos(th))], [0, 1, radius * (np.sin(end) - np.sin(th))], [0, 0, 1]]
            )
            dx_dw = radius / w * (np.sin(th) - np.sin(end)) + radius * dt * np.cos(end)
            dy_dw = radius / w * (np.cos(end) - np.cos(th)) + radius * dt * np.sin(end)
            g = np.array([[(np.sin(end) - np.sin(th)) / w, dx_dw], [(np.cos(th) - np.cos(end)) / w, dy_dw], [0, dt]])
        else:
            pose = np.array([x + v * dt * np.cos(th), y + v * dt * np.sin(th), th])
            f = np.array([[1, 0, -v * dt * np.sin(th)], [0, 1, v * dt * np.cos(th)], [0, 0, 1]])
            g = np.array(
                [[dt * np.cos(th), -v * dt**2 / 2 * np.sin(th)], [dt * np.sin(th), v * dt**2 / 2 * np.cos(th)], [0, dt]]
            )
        p = f @ p @ f.T + g @ np.diag([0.05**2, 0.3**2]) @ g.T / dt
        for i in range(bounds[k], bounds[k + 1]):
            dx, dy = record.landmarks[:, record.readings.landmark_number[i, 0]] - pose[:2]
            q = dx**2 + dy**2
            h = np.array([[-dx / np.sqrt(q), -dy / np.sqrt(q), 0], [dy / q, -dx / q, -1]])
            residual = record.readings.values[:, i, 0] - [np.sqrt(q), np.arctan2(dy, dx) - pose[2]]
            residual[1] = np.arctan2(np.sin(residual[1]), np.cos(residual[1]))
            kalman_gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
            pose, p = pose + kalman_gain @ residual, (np.eye(3) - kalman_gain @ h) @ p
    np.testing.assert_allclose(problem.space.minus(found.mean[:, -1, 0], pose), 0.0, atol=1e-8)
    np.testing.assert_allclose(found.cov[:, :, -1, 0], p, atol=1e-9)


def test_readings_of_other_robots_are_left_out(shared):
    recording = mrclam.read(shared / "me469_ds1", "ds1_", 0.0)
    codes = np.loadtxt(shared / "me469_ds1" / "ds1_Measurement.dat")[:, 1]
    of_robots = np.isin(codes, [5, 14, 41, 32, 23]).sum()
    assert of_robots > 1000
    assert recording.readings.shape == (2, 6167 - of_robots)


def test_simulated_matched_filter_is_consistent():
    """NEES over 200 matched runs is one within its interval; 99.73 % lie inside 3 sigma."""
    experiment = settings("scenario=landmark", "filter=ukf")
    problem, noise = experiment.scenario, experiment.noise
    record = problem.simulate(Streams(1, "landmark"), range(200), noise.truth).first(250)
    motion: Motion = problem.motion(noise.filter)
    sensor: Sensor = problem.sensor(noise.filter, record.landmarks)
    rows = metrics(tallied(problem, record, estimate(experiment.filter, motion, sensor, record, *problem.scheme)))
    assert abs(rows["anees", "all"].value - 1.0) < 0.06
    assert abs(rows["anis", "all"].value - 1.0) < 0.03
    for name in problem.space.names:
        assert abs(rows["inside_3sigma", name].value - 0.9973) < 0.003
