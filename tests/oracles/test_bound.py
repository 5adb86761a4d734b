"""The posterior Cramer-Rao bound against Kalman, Tichavsky, the optimal estimator, a second implementation, filters."""

from dataclasses import replace

import numpy as np
import pytest

from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Space
from estlab.maths.streams import Streams
from estlab.metrics.bound import posterior_bound
from estlab.metrics.intervals import mean_interval
from estlab.metrics.moments import SampleMoments
from estlab.models.contract import Motion, Sensor
from estlab.record import Readings
from estlab.scenarios import simulation
from tests import linear
from tests.conftest import estimate, settings

NOWHERE = np.empty((0, 1))
RNG = np.random.default_rng(3)
WIDE = RNG.standard_normal((5, 3))
NOISES = {  # slope in the noise (3, q) and covariance (q, q)
    "as given": (linear.G, linear.Q),
    "one is off": (linear.G, np.diag([0.5, 0.0])),
    "all are off": (linear.G, np.zeros((2, 2))),
    "two are one": (linear.G, np.array([[0.1, 0.3], [0.3, 0.9]])),
    "more than states": (RNG.standard_normal((3, 5)), WIDE @ WIDE.T),
    "fewer than states": (linear.G[:, :1], np.array([[0.5]])),
}
SCENARIOS = {
    "field": ("scenario=field",),
    "landmark": ("scenario=landmark",),
    "epuck": ("scenario=epuck", "scenario.truth=model"),
    "car": ("scenario=car", "scenario.truth=model", "scenario.initial=drawn", "scenario.initial_sd=[2,5,1,.78,.8,.25]"),
}


def _problem(name, runs, *overrides):
    experiment = settings(*SCENARIOS[name], *overrides)
    scenario, noise = experiment.scenario, experiment.noise.truth
    record = scenario.simulate(Streams(1, name), range(runs), noise)
    return experiment.filter, scenario.motion(noise), scenario.sensor(noise, record.landmarks), record


def _rows(matrix):
    return tuple(tuple(row) for row in matrix)


def _linear_motion(jacobian, cov):
    def move(state, control, noise, dt):
        return tuple(
            sum(a * x for a, x in zip(row, state, strict=True)) + sum(g * w for g, w in zip(drive, noise, strict=True))
            for row, drive in zip(linear.A, jacobian, strict=True)
        )

    return Motion(linear.STATE, move, lambda control, dt: cov, len(cov), lambda *_: (_rows(linear.A), _rows(jacobian)))


def _gappy(record):
    """Several readings a step or none, some without their first number, some without any; and two steps at one time."""
    readings = record.readings
    values = readings.values.copy()
    values[0, 8:14], values[:, 20:25] = np.nan, np.nan
    step, time = np.repeat(np.arange(0, 40, 2), 2), record.time.copy()
    time[10] = time[9]
    return replace(record, time=time, readings=Readings(step, values, readings.landmark_number))


def _kalman(start, jacobian, cov, record):
    """The covariance (3, 3, T) by the Kalman filter, reading by reading, in its plainest form."""
    p, history = start, np.empty((3, 3, record.time.size))
    for k in range(record.time.size):
        if k == 0 or record.time[k] > record.time[k - 1]:
            p = linear.A @ p @ linear.A.T + jacobian @ cov @ jacobian.T
        for values in record.readings.values[:, record.readings.step == k, 0].T:
            there = ~np.isnan(values)
            h, r = linear.H[there], linear.R[np.ix_(there, there)]
            p = p - p @ h.T @ np.linalg.inv(h @ p @ h.T + r) @ h @ p
        history[:, :, k] = p
    return history


@pytest.mark.parametrize("noise", NOISES)
def test_on_a_linear_model_it_is_the_covariance_of_the_kalman_filter(noise):
    jacobian, cov = NOISES[noise]
    record = _gappy(linear.record(range(3)))
    expected = _kalman(linear.P0, jacobian, cov, record)
    bound = posterior_bound(record, _linear_motion(jacobian, cov), linear.SENSOR)
    np.testing.assert_allclose(bound, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())


def test_a_start_that_every_prior_hits_is_known():
    record = _gappy(linear.record(range(3)))
    known = replace(record, prior=Gaussian(record.origin, linear.P0))
    bound = posterior_bound(known, _linear_motion(linear.G, linear.Q), linear.SENSOR)
    np.testing.assert_allclose(bound, _kalman(np.zeros((3, 3)), linear.G, linear.Q, record), rtol=1e-10, atol=1e-12)


def _tichavsky(start, jacobians, cov, informations):
    """J[k+1] = D22 - D21 (J[k] + D11)^-1 D12 for additive noise; slopes and readings' informations (T, runs, n, n)."""
    j, history = np.linalg.inv(start), []
    inverse = np.linalg.inv(cov)
    for f, information in zip(jacobians, informations, strict=True):
        d11 = (f.transpose(0, 2, 1) @ inverse @ f).mean(axis=0)
        d12 = -(f.transpose(0, 2, 1) @ inverse).mean(axis=0)
        j = inverse + information.mean(axis=0) - d12.T @ np.linalg.inv(j + d11) @ d12
        history.append(np.linalg.inv(j))
    return np.stack(history, axis=-1)


def test_with_a_linear_motion_and_a_bent_sensor_it_is_tichavskys():
    """States and noises are then linear in each other, so both are one information matrix in two coordinates."""
    cov = WIDE.T @ WIDE
    record = linear.record(range(50))
    bent = Sensor(linear.READING, linear.STATE, lambda x, _: (np.arctan(x[0]) + x[2], x[1] ** 2), linear.R, NOWHERE)
    x, y, _ = record.truth.transpose(0, 1, 2)
    zero, one = np.zeros_like(x), np.ones_like(x)
    h = np.array([[1.0 / (1.0 + x**2), zero, one], [zero, 2.0 * y, zero]]).transpose(2, 3, 0, 1)
    informations = h.transpose(0, 1, 3, 2) @ np.linalg.inv(linear.R) @ h
    jacobians = np.broadcast_to(linear.A, (40, 50, 3, 3))
    expected = _tichavsky(linear.P0, jacobians, cov, informations)
    bound = posterior_bound(record, _linear_motion(np.eye(3), cov), bent)
    np.testing.assert_allclose(bound, expected, rtol=1e-7, atol=1e-7)


SCALAR, VARIANCE, BLUR, START = Space(("x",), ("m",)), 0.2, 0.4, np.array([[0.8]])


def _bend(x):
    return 0.6 * x + 0.5 * np.sin(x)


def _cubic(x):
    return x + 0.03 * x**3


SCALAR_MOTION = Motion(SCALAR, lambda x, _, w, dt: (_bend(x[0]) + w[0],), lambda _, dt: np.array([[VARIANCE]]), 1)
SCALAR_SENSOR = Sensor(SCALAR, SCALAR, lambda x, _: (_cubic(x[0]),), np.array([[BLUR]]), NOWHERE)


def _scalar_record(runs, steps):
    time, prior = np.arange(1.0, steps + 1.0), Gaussian(np.zeros(1), START)
    control = np.empty((0, steps, 1))
    return simulation.drawn(Streams(1, "s"), range(runs), SCALAR_MOTION, SCALAR_SENSOR, prior, time, control)


def test_a_prediction_by_a_bent_motion_is_bounded_in_closed_form_above_tichavsky():
    """One step x' = f(x) + w without readings: C = E[f']^2 P0 + Q, Tichavsky's Q + E[f']^2 / (1 / P0 + var(f') / Q)."""
    record = _scalar_record(500, 1)
    unread = replace(record, readings=replace(record.readings, values=np.full((1, 1, 500), np.nan)))
    jacobian = (0.6 + 0.5 * np.cos(record.origin))[0]
    bound = posterior_bound(unread, SCALAR_MOTION, SCALAR_SENSOR)[0, 0, 0]
    assert bound == pytest.approx(jacobian.mean() ** 2 * START[0, 0] + VARIANCE, rel=1e-8)
    nothing = np.zeros((1, 500, 1, 1))
    theirs = _tichavsky(START, jacobian[None, :, None, None], np.array([[VARIANCE]]), nothing)[0, 0, 0]
    assert theirs == pytest.approx(VARIANCE + jacobian.mean() ** 2 / (1 / START[0, 0] + jacobian.var() / VARIANCE))
    assert theirs < bound


def test_the_optimal_estimator_does_not_beat_it_and_comes_near():
    """A point-mass filter on a fine grid is the optimal estimator, its mean variance the least mean squared error."""
    steps, runs = 10, 1500
    record = _scalar_record(runs, steps)
    bound = posterior_bound(record, SCALAR_MOTION, SCALAR_SENSOR)[0, 0]
    grid = np.linspace(-6.0, 6.0, 300)
    moved = np.exp(-0.5 * (grid[:, None] - _bend(grid)) ** 2 / VARIANCE)
    weights = np.exp(-0.5 * grid**2 / START[0, 0])[:, None].repeat(runs, axis=1)
    for k in range(steps):
        off = record.readings.values[0, k] - _cubic(grid)[:, None]
        weights = (moved @ weights) * np.exp(-0.5 * off**2 / BLUR)
        weights = weights / weights.sum(axis=0)
        least = grid**2 @ weights - (grid @ weights) ** 2
        assert bound[k] <= mean_interval(SampleMoments.of(least[None])).high
        assert bound[k] >= 0.95 * least.mean()


@pytest.mark.parametrize("name", SCENARIOS)
def test_of_one_run_it_is_the_linearised_covariance_about_the_truth(name):
    _, motion, sensor, record = _problem(name, 1)
    record = record.first(60)
    bound = posterior_bound(record, motion, sensor)
    known = (record.origin == record.prior.mean).all()
    p, state = np.zeros_like(record.prior.cov) if known else record.prior.cov, record.origin
    lapse, readings = np.diff(record.time, prepend=record.start), record.readings
    for k in range(record.time.size):
        control = record.control[:, k]
        f = motion.function(control, lapse[k]).jacobian(state)[..., 0]
        g = motion.noise_jacobian(state, control, lapse[k])[..., 0]
        m = motion.noise_cov(control, lapse[k])
        p = f @ p @ f.T + g @ m.reshape(m.shape[:2]) @ g.T
        state = record.truth[:, k]
        for i in np.flatnonzero((readings.step == k) & ~np.isnan(readings.values[0, :, 0])):
            h = sensor.function(sensor.landmark(readings.landmark_number[i])).jacobian(state)[..., 0]
            p = p - p @ h.T @ np.linalg.solve(h @ p @ h.T + sensor.noise_cov, h @ p)
        size = np.sqrt(np.diag(p))
        np.testing.assert_allclose(bound[:, :, k] / size / size[:, None], p / size / size[:, None], atol=1e-8)


def _with_all_directions(record, motion, sensor):
    """The bound from the whole information matrix of the start and all noises, in their own units, nothing left out."""
    runs, n, q = record.runs, motion.space.size, motion.noise_size
    jacobians, information = np.repeat(np.eye(n)[None], runs, axis=0), np.linalg.inv(record.prior.cov)
    state, lapse = record.origin, np.diff(record.time, prepend=record.start)
    history = []
    for k in range(record.time.size):
        heading = state[motion.space.angles[0]]
        functions = np.stack([np.ones(runs), np.cos(heading), np.sin(heading)])
        f, g = (
            np.moveaxis(jacobian, 2, 0)
            for jacobian in (
                motion.function(record.control[:, k], lapse[k]).jacobian(state),
                motion.noise_jacobian(state, record.control[:, k], lapse[k]),
            )
        )
        turned = np.concatenate([function[:, None, None] * g for function in functions], axis=2)
        jacobians = np.concatenate([f @ jacobians, turned], axis=2)
        known = np.kron(functions @ functions.T / runs, np.linalg.inv(motion.noise_cov(record.control[:, k], lapse[k])))
        old = len(information)
        information = np.block([[information, np.zeros((old, 3 * q))], [np.zeros((3 * q, old)), known]])
        state = record.truth[:, k]
        for i in np.flatnonzero(record.readings.step == k):
            h = (
                np.moveaxis(sensor.function(sensor.landmark(record.readings.landmark_number[i])).jacobian(state), 2, 0)
                @ jacobians
            )
            weighted = np.linalg.inv(sensor.noise_cov) @ h
            information = information + np.tensordot(h, weighted, axes=((0, 1), (0, 1))) / runs
        mean = jacobians.mean(axis=0)
        history.append(mean @ np.linalg.solve(information, mean.T))
    return np.stack(history, axis=-1)


def test_leaving_out_directions_lowers_it_and_hardly():
    _, motion, sensor, record = _problem("epuck", 100)
    record = record.first(30)
    whole = _with_all_directions(record, motion, sensor)
    kept = posterior_bound(record, motion, sensor)
    size = np.sqrt(np.einsum("iit->it", whole))
    lost = ((whole - kept) / size / size[:, None]).transpose(2, 0, 1)
    assert np.linalg.eigvalsh(lost).min() > -1e-7
    assert np.einsum("kii->ki", lost).max() < 4e-3


@pytest.mark.parametrize("name", ["field", "landmark", "epuck"])
def test_no_filter_beats_it_and_the_unscented_filter_comes_near(name):
    """The mean squared error over time, of independent runs, is not below the bound by three of its errors."""
    filter, motion, sensor, record = _problem(name, 200, "filter=ukf")
    bound = posterior_bound(record, motion, sensor)
    error = motion.space.minus(estimate(filter, motion, sensor, record).mean, record.truth)
    squares = {n: (error[i] ** 2).mean(axis=0) for i, n in enumerate(motion.space.names)}
    bounds = {n: bound[i, i].mean() for i, n in enumerate(motion.space.names)}
    at = list(motion.space.position)
    squares["position"] = (error[at] ** 2).sum(axis=0).mean(axis=0)
    bounds["position"] = bound[at, at].sum(axis=0).mean()
    for component, square in squares.items():
        error_of_mean = square.std(ddof=1) / np.sqrt(square.size)
        assert bounds[component] < square.mean() + 3.0 * error_of_mean, component
        assert np.sqrt(bounds[component] / square.mean()) > 0.85, component
