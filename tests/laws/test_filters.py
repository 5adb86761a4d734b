from dataclasses import replace

import numpy as np
import pytest

from estlab.filters.gaussian import GaussianFilter, dead_reckoning, extended, unscented
from estlab.maths.gaussian import Gaussian
from estlab.maths.sigma_points import Scaled
from estlab.maths.streams import Streams
from estlab.models.contract import Sensor
from estlab.record import Readings, Record
from tests import linear
from tests.conftest import estimate, options, settings

UKF = unscented("merwe", 1.0, 2.0, 0.0, "augmented", None)


def _pick(record, run):
    one = slice(run, run + 1)
    control = record.control if record.control.shape[2] == 1 else record.control[:, :, one]
    readings = Readings(record.readings.step, record.readings.values[:, :, one], record.readings.target[:, one])
    prior = Gaussian(record.prior.mean[:, one], record.prior.cov) if record.each_its_own else record.prior
    return replace(record, truth=record.truth[:, :, one], control=control, readings=readings, prior=prior)


@pytest.mark.parametrize("scenario", options("scenario"))
@pytest.mark.parametrize("name", options("filter"))
def test_runs_in_a_batch_do_not_see_each_other(scenario, name):
    experiment = settings(f"scenario={scenario}", f"filter={name}")
    problem, noise = experiment.scenario, experiment.noise.filter
    record = problem.simulate(Streams(2, scenario), range(5), noise).first(40)
    motion, sensor = problem.motion(noise), problem.sensor(noise, record.places)
    together = estimate(experiment.filter, motion, sensor, record, *problem.scheme)
    for run in (0, 3):
        own = run if record.each_its_own else 0  # the stream of the belief
        alone = estimate(experiment.filter, motion, sensor, _pick(record, run), *problem.scheme, numbers=[own])
        # Equal but for the last bits of sums, which differences of the car's kinked sensor magnify most.
        np.testing.assert_allclose(together.mean[:, :, run], alone.mean[:, :, 0], rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(together.cov[..., run], alone.cov[..., 0], rtol=1e-5, atol=1e-5)
        np.testing.assert_array_equal(together.nis_size[:, run], alone.nis_size[:, 0])


def test_a_run_that_breaks_becomes_nan_and_its_neighbours_are_untouched():
    record = linear.record(range(4))
    values = record.readings.values.copy()
    values[:, 10, 2] = np.inf
    broken = Record(
        record.start, record.time, record.truth, record.control,
        Readings(record.readings.step, values, record.readings.target), record.prior,
    )  # fmt: skip
    good, bad = (estimate(UKF, linear.MOTION, linear.SENSOR, r) for r in (record, broken))
    np.testing.assert_array_equal(bad.diverged, [False, False, True, False])
    assert np.isfinite(bad.mean[:, :10, 2]).all()
    np.testing.assert_array_equal(np.delete(bad.mean, 2, axis=2), np.delete(good.mean, 2, axis=2))


@pytest.mark.parametrize("noise", ["additive", "augmented"])
def test_a_missing_number_is_the_update_without_its_row(noise):
    belief = Gaussian(np.array([[0.3], [-1.0], [0.2]]), linear.P0[:, :, None])
    filter = unscented("merwe", 1.0, 2.0, 0.0, noise, None)
    reading = np.array([[np.nan], [0.7]])
    found, fit = filter.update(linear.SENSOR, belief, reading, np.empty((0, 1)))
    second = Sensor(
        linear.READING, linear.STATE, lambda x, p: (linear.measure(x, p)[1],), linear.R[1:, 1:], np.empty((0, 1))
    )
    expected, _ = filter.update(second, belief, reading[1:], np.empty((0, 1)))
    np.testing.assert_allclose(found.mean, expected.mean, atol=1e-12)
    np.testing.assert_allclose(found.cov, expected.cov, atol=1e-12)
    assert fit.size == 1


def test_no_number_at_all_leaves_the_belief_as_it_was():
    belief = Gaussian(np.array([[0.3], [-1.0], [0.2]]), linear.P0[:, :, None])
    found, fit = UKF.update(linear.SENSOR, belief, np.full((2, 1), np.nan), np.empty((0, 1)))
    np.testing.assert_array_equal(found.mean, belief.mean)
    np.testing.assert_allclose(found.cov, belief.cov, atol=1e-15)
    assert fit.size == 0


def test_several_readings_of_a_linear_sensor_may_be_stacked_or_taken_in_turn():
    record = linear.record(range(3))
    step = np.repeat(np.arange(20), 2)
    doubled = Record(
        0.0, record.time[:20], record.truth[:, :20], record.control[:, :20],
        Readings(step, record.readings.values, record.readings.target), record.prior,
    )  # fmt: skip
    turns = estimate(UKF, linear.MOTION, linear.SENSOR, doubled, "sequential")
    stack = estimate(UKF, linear.MOTION, linear.SENSOR, doubled, "stacked")
    np.testing.assert_allclose(stack.mean, turns.mean, atol=1e-10)
    np.testing.assert_allclose(stack.nis, turns.nis, atol=1e-9)
    np.testing.assert_array_equal(stack.nis_size, turns.nis_size)
    paused = estimate(UKF, linear.MOTION, linear.SENSOR, doubled, "interleaved", 0.1)
    assert np.abs(paused.mean - turns.mean).max() > 1e-3, "a prediction between readings must forget a little"


def test_dead_reckoning_uses_no_reading():
    record = linear.record(range(2))
    filter = dead_reckoning()
    found = estimate(filter, linear.MOTION, linear.SENSOR, record)
    expected = np.linalg.matrix_power(linear.A, 40) @ record.prior.mean
    np.testing.assert_allclose(found.mean[:, -1], expected, atol=1e-12)
    assert not found.nis_size.any()


def test_a_sigma_point_set_that_cannot_be_placed_is_refused():
    with pytest.raises(ValueError, match=r"kappa must be > -n = -3 for 3 dimensions, got -3"):
        GaussianFilter(Scaled(1.0, 2.0, -3.0), "additive", None).check(linear.MOTION, linear.SENSOR)
    with pytest.raises(ValueError, match="alpha must be > 0"):
        Scaled(0.0, 2.0, 0.0)


def test_extended_with_augmented_noise_is_extended():
    record = linear.record(range(2))
    one, other = (estimate(extended(n, None), linear.MOTION, linear.SENSOR, record) for n in ("additive", "augmented"))
    np.testing.assert_allclose(one.mean, other.mean, atol=1e-12)
