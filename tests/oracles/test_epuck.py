"""The document's own equations for the robot on video, and its filters written out plainly."""

import numpy as np
import pytest

import estlab
from estlab.cli.main import main
from estlab.errors import UserError
from estlab.maths.finite_differences import hessian
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.linalg import cholesky
from estlab.maths.stacking import matrix
from estlab.maths.streams import Streams
from estlab.maths.transforms import SecondOrder
from estlab.models import camera
from estlab.models.contract import Motion
from tests.conftest import estimate, options, settings

DT = 1.0 / 3.0
STATE = np.array([31.0, 42.0, 6.5, 2.1])
NOTHING = np.empty(0)


def _record(*overrides: str, runs: int = 3):
    experiment = settings("scenario=epuck", *overrides)
    problem, noise = experiment.scenario, experiment.noise.filter
    record = problem.simulate(Streams(1, "epuck"), range(runs), experiment.noise.truth)
    return experiment.filter, problem.motion(noise), problem.sensor(noise, record.landmarks), record


def _printed_hessians(state, dt):
    """Equation 20, entry by entry."""
    _, _, v, th = state
    first, second = np.zeros((4, 4)), np.zeros((4, 4))
    first[2, 3] = first[3, 2] = -dt * np.sin(th)
    first[3, 3] = -dt * v * np.cos(th)
    second[2, 3] = second[3, 2] = dt * np.cos(th)
    second[3, 3] = -dt * v * np.sin(th)
    return np.stack([first, second, np.zeros((4, 4)), np.zeros((4, 4))])


def test_the_hessians_are_the_printed_ones_and_the_differences():
    stated = np.stack([matrix(rows, ()) for rows in camera.coast_hessians(STATE, NOTHING, DT)])
    np.testing.assert_allclose(stated, _printed_hessians(STATE, DT), atol=1e-15)
    motion = Motion(camera.SPACE, camera.coast, lambda control, dt: np.eye(2), 2)
    by_difference = hessian(motion.function(NOTHING, DT).evaluate, STATE, camera.SPACE)
    np.testing.assert_allclose(stated, by_difference, atol=1e-5)


def test_the_noise_that_a_step_adds_is_the_documents():
    motion = settings("scenario=epuck", "scenario.dv2=0.3", "scenario.dth2=0.07").scenario.motion(
        settings("scenario=epuck").noise.filter
    )
    jacobian = motion.noise_jacobian(STATE[:, None], NOTHING[:, None], DT)[..., 0]
    gamma = np.zeros((4, 2))
    gamma[2, 0], gamma[3, 1] = np.sqrt(0.3) * np.sqrt(DT), np.sqrt(0.07) * np.sqrt(DT)
    np.testing.assert_allclose(jacobian @ motion.noise_cov(NOTHING, DT) @ jacobian.T, gamma @ gamma.T, atol=1e-15)


def test_the_bias_is_half_the_trace_by_hand():
    """P with P33 = 2, P34 = .3, P44 = .5 at v = 6, th = pi / 6, dt = 1 / 3: the traces in closed form."""
    state = np.array([0.0, 0.0, 6.0, np.pi / 6])
    cov = np.diag([1.0, 1.0, 2.0, 0.5])
    cov[2, 3] = cov[3, 2] = 0.3
    motion = settings("scenario=epuck").scenario.motion(settings("scenario=epuck").noise.filter)
    function, belief = motion.function(NOTHING[:, None], DT), Gaussian(state[:, None], cov[:, :, None])
    moved = SecondOrder("modified")(function, belief).mean[:, 0] - function.evaluate(state[:, None])[:, 0]
    # b1 = -dt sin(th) P34 - dt v cos(th) P44 / 2 and b2 = dt cos(th) P34 - dt v sin(th) P44 / 2
    half_root3 = np.sqrt(3.0) / 2.0
    by_hand = [-0.05 - 0.5 * half_root3, 0.1 * half_root3 - 0.25, 0.0, 0.0]
    np.testing.assert_allclose(moved, by_hand, atol=1e-14)


def _plain(record, run, dv2, dth2, bias=0.5):
    """The document's second-order filter, equations 16 to 23, one run, plainly; its mean and covariance at each step.

    bias: the factor before the trace; the document prints a quarter where a half is meant.
    """
    mean, p = record.prior.mean[:, run], record.prior.cov
    h, r = np.eye(2, 4), 0.1434 * np.eye(2)
    means, covs = [], []
    for k in range(record.time.size):
        _, _, v, th = mean
        shift = bias * np.array([np.trace(f @ p) for f in _printed_hessians(mean, DT)])
        phi = np.eye(4)
        phi[0, 2:] = DT * np.cos(th), -DT * v * np.sin(th)
        phi[1, 2:] = DT * np.sin(th), DT * v * np.cos(th)
        mean = mean + np.array([DT * v * np.cos(th), DT * v * np.sin(th), 0.0, 0.0]) + shift
        p = phi @ p @ phi.T + np.diag([0.0, 0.0, dv2 * DT, dth2 * DT])
        p = p - p @ h.T @ np.linalg.inv(h @ p @ h.T + r) @ h @ p
        mean = mean + p @ h.T @ np.linalg.inv(r) @ (record.readings.values[:, k, run] - mean[:2])
        means.append(mean)
        covs.append(p)
    return np.array(means).T, np.moveaxis(np.array(covs), 0, -1)


@pytest.mark.parametrize(("dv2", "dth2"), [(0.05, 0.01), (1.0, 1.0)])
def test_the_modified_filter_is_the_documents_written_out_plainly(dv2, dth2):
    settings_of = ("filter=second_order", "filter.form=modified", f"scenario.dv2={dv2}", f"scenario.dth2={dth2}")
    filter, motion, sensor, record = _record(*settings_of)
    found = estimate(filter, motion, sensor, record)
    for run in (0, 2):
        mean, cov = _plain(record, run, dv2, dth2)
        np.testing.assert_allclose(camera.SPACE.minus(found.mean[:, :, run], mean), 0.0, atol=1e-10)
        np.testing.assert_allclose(found.cov[..., run], cov, atol=1e-10)


def _furthest(mean, record, run):
    """How far the position is ever from the truth [cm]; infinite where it is not finite."""
    away = np.hypot(*(mean[:2] - record.truth[:2, :, run]))
    return np.where(np.isfinite(away), away, np.inf).max()


def test_at_ten_and_ten_the_modified_filter_diverges_and_the_others_hold_the_position():
    wide = ("scenario.dv2=10", "scenario.dth2=10")
    for form, lost in (("filter=ekf",), False), (("filter=second_order",), False), (("filter.form=modified",), True):
        _, *models, record = _record(*wide)
        filter = settings("scenario=epuck", *(("filter=second_order",) if lost else ()), *form).filter
        found = estimate(filter, *models, record)
        assert np.isnan(found.mean).any(axis=(0, 1)).tolist() == [lost] * 3
        assert all((_furthest(found.mean[:, :, run], record, run) > 1e6) == lost for run in range(3))
    speed = found.mean[2] if not lost else estimate(settings("filter=second_order").filter, *models, record).mean[2]
    assert (speed[-1] > 60.0).all(), "the gaussian form's speed runs away"


def test_with_the_printed_quarter_in_its_bias_the_filter_would_not_diverge():
    *_, record = _record("scenario.dv2=10", "scenario.dth2=10")
    quarter, _ = _plain(record, 0, 10.0, 10.0, 0.25)
    assert _furthest(quarter, record, 0) < 2.0
    early = record.first(15)
    half, _ = _plain(early, 0, 10.0, 10.0, 0.5)
    assert _furthest(half, early, 0) > 10.0


def test_the_initial_estimate_is_from_the_first_two_fixes():
    *_, record = _record()
    fixes = record.extra["fixes"]
    (x0, y0), (x1, y1) = fixes[:, 0], fixes[:, 1]
    speed = np.sqrt((x1 - x0) ** 2 + (y1 - y0) ** 2) * 3.0
    np.testing.assert_allclose(record.prior.mean[:, 0], [x0, y0, speed, np.arctan2(y1 - y0, x1 - x0)], rtol=1e-12)
    p11 = 3 * 0.3786**2 / 9
    expected = np.diag([p11, p11, 2 * p11 * 9, (10 * np.pi / 180) ** 2])
    np.testing.assert_allclose(record.prior.cov, expected, rtol=1e-12)
    assert record.start == 0.0
    np.testing.assert_array_equal(record.readings.values[:, :, 0], fixes[:, 1:], "the second fix is a reading too")


def test_the_documents_initial_matrix_is_refused_in_one_line(capsys):
    assert main(["run", "scenario=epuck", "scenario.initial_covariance=document"]) == 2
    text = capsys.readouterr().err
    assert text.startswith("estlab: scenario.initial_covariance=document is not a covariance: not positive definite")
    assert "correlation is 1.25" in text
    assert text.count("\n") == 1
    sharper = settings("scenario=epuck", "scenario.initial_covariance=document", "scenario.led_sd=0.1").scenario
    assert np.isfinite(cholesky(sharper._initial_cov())).all(), "with better lights it is a covariance, and taken"


@pytest.mark.parametrize(
    ("key", "value"),
    [("dt", 0), ("dv2", 0), ("dth2", -1), ("fix_variance", 0), ("led_sd", -0.1), ("alpha_sd", 0), ("duration", 0.5)],
)
def test_a_number_out_of_range_is_named(key, value):
    with pytest.raises(UserError, match=rf"scenario\.{key} must"):
        settings("scenario=epuck", f"scenario.{key}={value}")


@pytest.mark.slow
@pytest.mark.parametrize("name", options("filter"))
def test_every_filter_follows_the_robot(name):
    if name == "dead_reckoning":
        pytest.skip("uses no reading")
    filter, motion, sensor, record = _record(f"filter={name}", "scenario.truth=model")
    found = estimate(filter, motion, sensor, record)
    assert np.isfinite(found.mean).all()
    assert np.hypot(*(found.mean - record.truth)[:2]).max() < 3.0
    assert np.isfinite(cholesky(found.cov[:, :, -1])).all()


@pytest.mark.parametrize("name", ["ekf", "second_order", "ukf", "ckf"])
def test_matched_runs_are_consistent_once_the_start_is_forgotten(name):
    filter, motion, sensor, record = _record(f"filter={name}", "scenario.truth=model", runs=200)
    found = estimate(filter, motion, sensor, record)
    error = np.moveaxis(camera.SPACE.minus(found.mean, record.truth), 0, -1)[30:]
    cov = np.moveaxis(found.cov, (0, 1), (-2, -1))[30:]
    nees = np.einsum("tri,tri->tr", error, np.linalg.solve(cov, error[..., None])[..., 0])
    per_run = nees.mean(axis=0) / 4
    low, high = per_run.mean() + np.array([-2.576, 2.576]) * per_run.std(ddof=1) / np.sqrt(200)
    assert low < 1.0 < high


def test_the_simulated_drive_stays_on_the_table():
    *_, record = _record(runs=50)
    assert record.truth[:2].min() > -15.0
    assert record.truth[:2].max() < 115.0
    assert record.truth[2].min() > 2.0


def test_the_divergence_is_told_and_drawn_with_its_three_filters(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "+experiment=epuck_divergence", "runs=2", "steps=60", "expect=null", "hydra.run.dir=out"]) == 0
    closeness = estlab.load("out").own.set_index("run 0")
    assert list(closeness.index) == ["ekf", "second_order", "modified"]
    furthest = closeness["largest distance [cm]"]
    assert (furthest[["ekf", "second_order"]] < 1.0).all()
    assert furthest["modified"] > 1e6
    assert "2 of 2" in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "out/plots").iterdir()} >= {"epuck_motion.png", "trajectory.png"}
