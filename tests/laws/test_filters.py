import re
from dataclasses import replace

import numpy as np
import pytest

from estlab.filters.filter import Traits
from estlab.filters.gaussian import GaussianFilter, dead_reckoning, extended, unscented
from estlab.filters.loop import Loop
from estlab.filters.particle import ParticleFilter
from estlab.filters.square_root import square_root_unscented
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.resampling import Weights
from estlab.maths.sigma_points import Scaled
from estlab.maths.streams import Streams
from estlab.models.contract import Sensor
from estlab.record import Readings, Record
from tests import linear
from tests.conftest import estimate, options, settings

UKF = unscented("merwe", 1.0, 2.0, 0.0, "augmented", None)


def test_a_run_that_breaks_becomes_nan_and_its_neighbours_are_untouched():
    record = linear.record(range(4))
    values = record.readings.values.copy()
    values[:, 10, 2] = np.inf
    broken = Record(
        record.start, record.time, record.truth, record.control,
        Readings(record.readings.step, values, record.readings.landmark_number), record.prior,
    )  # fmt: skip
    good, bad = (estimate(UKF, linear.MOTION, linear.SENSOR, r) for r in (record, broken))
    np.testing.assert_array_equal(np.isnan(bad.mean).any(axis=(0, 1)), [False, False, True, False])
    assert np.isfinite(bad.mean[:, :10, 2]).all()
    np.testing.assert_array_equal(np.delete(bad.mean, 2, axis=2), np.delete(good.mean, 2, axis=2))


@pytest.mark.parametrize("name", ["ekf", "ukf", "ckf", "ghkf", "srukf", "second_order", "enkf"])
def test_a_prediction_never_makes_the_heading_more_certain(name):
    """However wide: sigma points more than half a turn apart stay apart."""
    experiment = settings("scenario=landmark", f"filter={name}", *(["filter.members=4000"] if name == "enkf" else []))
    motion = experiment.scenario.motion(experiment.noise.filter)
    for sd in (0.5, 1.3, 2.0, 3.0):
        prior = Gaussian(np.array([[1.0], [2.0], [0.3]]), np.diag([0.01, 0.01, sd**2]))
        belief = experiment.filter.start(prior, Streams(1, "test").generators("wide", [0]))
        after = experiment.filter.predict(motion, belief, np.array([[0.2], [0.1]]), 0.02)
        found = np.sqrt(experiment.filter.moments(after, motion).cov[2, 2, 0])
        expected = np.sqrt(sd**2 + 0.3**2 * 0.02)
        if name == "enkf":
            # An ensemble's headings are on the circle, on which a spread beyond half a turn has no size.
            assert sd > 1.0 or abs(found / expected - 1.0) < 0.05
        else:
            np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_a_gate_refuses_what_no_right_reading_is_and_counts_it():
    record = linear.record(range(3))
    values = record.readings.values.copy()
    values[:, 20, 1] += 50.0
    readings = Readings(record.readings.step, values, record.readings.landmark_number)
    spoilt = replace(record, readings=readings)
    gated = unscented("merwe", 1.0, 2.0, 0.0, "augmented", 0.9999)
    found = estimate(gated, linear.MOTION, linear.SENSOR, spoilt)
    assert found.notes["gated"].sum() == 1
    assert found.notes["gated"][20, 1] == 1
    assert np.isnan(found.whitened[:, 20, 1]).all()
    without = values.copy()
    without[:, 20, 1] = np.nan
    missing = replace(record, readings=Readings(record.readings.step, without, record.readings.landmark_number))
    expected = estimate(gated, linear.MOTION, linear.SENSOR, missing)
    np.testing.assert_allclose(found.mean, expected.mean, atol=1e-12)


@pytest.mark.parametrize("noise", ["additive", "augmented"])
def test_a_missing_number_is_the_update_without_its_row(noise):
    belief = Gaussian(np.array([[0.3], [-1.0], [0.2]]), linear.P0[:, :, None])
    filter = unscented("merwe", 1.0, 2.0, 0.0, noise, None)
    reading = np.array([[np.nan], [0.7]])
    found, innovation = filter.update(linear.SENSOR, belief, reading, np.empty((0, 1)))
    second = Sensor(
        linear.READING, linear.STATE, lambda x, p: (linear.measure(x, p)[1],), linear.R[1:, 1:], np.empty((0, 1))
    )
    expected, _ = filter.update(second, belief, reading[1:], np.empty((0, 1)))
    np.testing.assert_allclose(found.mean, expected.mean, atol=1e-12)
    np.testing.assert_allclose(found.cov, expected.cov, atol=1e-12)
    assert np.isfinite(innovation.whitened).sum() == 1


def test_no_number_at_all_leaves_the_belief_as_it_was():
    belief = Gaussian(np.array([[0.3], [-1.0], [0.2]]), linear.P0[:, :, None])
    found, innovation = UKF.update(linear.SENSOR, belief, np.full((2, 1), np.nan), np.empty((0, 1)))
    np.testing.assert_array_equal(found.mean, belief.mean)
    np.testing.assert_allclose(found.cov, belief.cov, atol=1e-15)
    assert np.isnan(innovation.whitened).all()


def test_several_readings_of_a_linear_sensor_may_be_stacked_or_taken_in_turn():
    record = linear.record(range(3))
    step = np.repeat(np.arange(20), 2)
    doubled = Record(
        0.0, record.time[:20], record.truth[:, :20], record.control[:, :20],
        Readings(step, record.readings.values, record.readings.landmark_number), record.prior,
    )  # fmt: skip
    turns = estimate(UKF, linear.MOTION, linear.SENSOR, doubled, "sequential")
    stack = estimate(UKF, linear.MOTION, linear.SENSOR, doubled, "stacked")
    np.testing.assert_allclose(stack.mean, turns.mean, atol=1e-10)
    np.testing.assert_allclose(stack.whitened, turns.whitened, atol=1e-9)
    paused = estimate(UKF, linear.MOTION, linear.SENSOR, doubled, "interleaved", 0.1)
    assert np.abs(paused.mean - turns.mean).max() > 1e-3, "a prediction between readings must forget a little"


def test_dead_reckoning_uses_no_reading():
    record = linear.record(range(2))
    filter = dead_reckoning()
    found = estimate(filter, linear.MOTION, linear.SENSOR, record)
    expected = np.linalg.matrix_power(linear.A, 40) @ record.prior.mean
    np.testing.assert_allclose(found.mean[:, -1], expected, atol=1e-12)
    assert np.isnan(found.whitened).all()


def test_a_sigma_point_set_that_cannot_be_placed_is_refused():
    with pytest.raises(ValueError, match=r"kappa must be > -n = -3 for 3 dimensions, got -3"):
        GaussianFilter(Scaled(1.0, 2.0, -3.0), "additive", None).check(linear.MOTION, linear.SENSOR)
    with pytest.raises(ValueError, match="alpha must be > 0"):
        Scaled(0.0, 2.0, 0.0)


@pytest.mark.parametrize("points", ["merwe", "julier"])
@pytest.mark.parametrize("noise", ["additive", "augmented"])
def test_points_so_near_that_rounding_is_all_they_show_are_refused(points, noise):
    near = unscented(points, 1e-7, 2.0, 1e-13 - 3.0 if points == "julier" else 0.0, noise, None)
    with pytest.raises(ValueError, match=r"(alpha|kappa) puts the points .* standard deviations from the mean"):
        near.check(linear.MOTION, linear.SENSOR)
    root = square_root_unscented(1e-7, 1e8, 0.0, None)
    with pytest.raises(ValueError, match="alpha puts the points"):
        root.check(linear.MOTION, linear.SENSOR)


def test_extended_with_augmented_noise_is_extended():
    record = linear.record(range(2))
    one, other = (estimate(extended(n, None), linear.MOTION, linear.SENSOR, record) for n in ("additive", "augmented"))
    np.testing.assert_allclose(one.mean, other.mean, atol=1e-12)


def _correlated():
    prior = Gaussian(np.zeros((3, 1)), linear.P0)
    noise = np.array([[1.0, 0.9], [0.9, 1.0]])
    return prior, replace(linear.SENSOR, noise_cov=noise)


@pytest.mark.parametrize("name", ["srukf", "srckf", "enkf", "pf"])
@pytest.mark.parametrize("missing", [0, 1])
def test_a_missing_number_says_nothing_where_noises_are_correlated(name, missing):
    """The other filters' answer to a reading with a hole is near the EKF's, whose masked update is exact."""
    prior, sensor = _correlated()
    reading = np.array([[1.0], [0.7]])
    reading[missing] = np.nan
    more = {"enkf": ["filter.members=20000"], "pf": ["filter.particles=40000"]}.get(name, [])
    found = []
    for chosen in (settings(f"filter={name}", *more).filter, settings("filter=ekf").filter):
        belief = chosen.start(prior, Streams(1, "test").generators("hole", [0]))
        belief, innovation = chosen.update(sensor, belief, reading, np.empty((0, 1)))
        assert np.isfinite(innovation.whitened).sum() == 1
        found.append(chosen.moments(belief, linear.MOTION))
    tolerance = 1e-10 if name.startswith("sr") else 0.04
    np.testing.assert_allclose(found[0].mean, found[1].mean, atol=tolerance)
    np.testing.assert_allclose(found[0].cov, found[1].cov, atol=tolerance)


def test_an_iterated_update_asks_the_gate_once():
    """Readings that pass about the prediction are used, however many iterations follow."""
    bent = Sensor(linear.READING, linear.STATE, lambda x, _: (x[0] ** 2, x[1]), np.diag([0.1, 1.0]), np.empty((0, 1)))
    belief = Gaussian(np.array([[1.5], [0.0], [0.0]]), np.diag([1.0, 1.0, 1.0])[..., None])
    found = []
    for iterations in (1, 2, 3, 4, 5):
        chosen = settings("filter=iekf", "filter.gate=0.95", f"filter.iterations={iterations}").filter
        after, innovation = chosen.update(bent, belief, np.array([[-1.0], [0.0]]), np.empty((0, 1)))
        assert innovation.gated == 0
        found.append(after.mean[0, 0])
    assert 1.5 not in found


def test_roughening_does_not_depend_on_where_the_heading_is_cut():
    experiment = settings("scenario=landmark", "filter=pf", "filter.roughening=0.2", "filter.threshold=1")
    motion = experiment.scenario.motion(experiment.noise.filter)
    spread = []
    for heading in (0.0, np.pi):
        prior = Gaussian(np.array([[0.0], [0.0], [heading]]), np.diag([1e-4, 1e-4, 1e-4]))
        belief = experiment.filter.start(prior, Streams(1, "test").generators("rough", [0]))
        belief = belief._replace(points=motion.space.wrapped(belief.points))
        weights = np.zeros((1000, 1))
        weights[:500] = 1.0 / 500
        with np.errstate(divide="ignore"):
            belief = belief._replace(weights=Weights.of_logs(np.log(weights)))
        after = experiment.filter.predict(motion, belief, np.zeros((2, 1)), 1e-9)
        spread.append(np.sqrt(experiment.filter.moments(after, motion).cov[2, 2, 0]))
    np.testing.assert_allclose(spread[0], spread[1], rtol=1e-6)


@pytest.mark.parametrize("name", ["ukf", "pf", "ckf", "enkf", "srukf"])
def test_a_noise_that_is_off_is_no_trouble(name):
    still = replace(linear.MOTION, noise_cov=lambda control, dt: np.zeros((2, 2)))
    found = estimate(settings(f"filter={name}").filter, still, linear.SENSOR, linear.record(range(2), steps=5))
    assert np.isfinite(found.mean).all()


@pytest.mark.parametrize("name", options("filter"))
def test_a_filter_says_of_itself_what_it_does(name):
    """What is declared is held to what is done with a reading, a gate and a smoother."""
    wanted = settings("scenario=epuck", "runs=2", f"filter={name}")
    filter, traits = wanted.filter, wanted.filter.traits
    record = wanted.scenario.simulate(Streams(1, "test"), range(2), wanted.noise.truth)
    loop = Loop(
        filter,
        wanted.scenario.motion(wanted.noise.filter),
        wanted.scenario.sensor(wanted.noise.filter, record.landmarks),
    )
    found = loop.estimate(record.first(6), Streams(1, "test").generators("filter", range(2)))
    assert traits.reads == bool(np.isfinite(found.whitened).any())
    assert bool(traits.sampled_by) == (found.sample is not None)
    assert traits.points == (getattr(filter, traits.sampled_by) if traits.sampled_by else 1)
    assert found.gate == traits.gate
    if traits.smooths:
        loop.check_smoother()
        loop.estimate_and_smooth(record.first(6), Streams(1, "test").generators("filter", range(2)))
    else:
        with pytest.raises(ValueError, match="this filter has no smoother; use one of the Gaussian family"):
            loop.check_smoother()
        belief = filter.start(record.prior, Streams(1, "test").generators("filter", range(2)))
        with pytest.raises(TypeError, match="does not smooth"):
            filter.propagate(loop.motion, belief, record.control[:, 0], 0.1)


@pytest.mark.parametrize(
    ("declared", "line"),
    [
        ({"points": 1}, "traits is a dict; must be a Traits"),
        (Traits(points=0.5), "traits.points is 0.5; must be a whole number >= 1"),
        (Traits(smooths=True), "traits.smooths is true, so the filter must define propagate"),
    ],
)
def test_what_a_filter_says_of_itself_is_checked_before_it_runs(declared, line):
    class Own(ParticleFilter):
        traits = declared

    own = Own(10, "systematic", 0.5, 0.0, 0.0, 0.0, "bootstrap", "flatten")
    with pytest.raises(ValueError, match=f"^{re.escape(line)}$"):
        Loop(own, linear.MOTION, linear.SENSOR).check()
