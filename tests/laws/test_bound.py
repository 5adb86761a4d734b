"""Laws of the posterior Cramer-Rao bound, and of the records that have one."""

from dataclasses import replace

import numpy as np
import pytest

from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.linalg import sandwich
from estlab.maths.streams import Streams
from estlab.metrics.bound import posterior_bound
from estlab.record import Readings
from tests.conftest import settings

LANDMARK = ("scenario=landmark", "scenario.duration=6")
SMALL = "scenario.initial_sd=[2,5,1,.78,.8,.25]"


def _problem(*overrides, runs=12):
    experiment = settings(*overrides)
    scenario, noise = experiment.scenario, experiment.noise.truth
    record = scenario.simulate(Streams(1, "bound"), range(runs), noise)
    return record, scenario.motion(noise), scenario.sensor(noise, record.landmarks)


def _runs(record, order):
    readings = Readings(
        record.readings.step, record.readings.values[:, :, order], record.readings.landmark_number[:, order]
    )
    return replace(
        record,
        truth=record.truth[:, :, order],
        control=record.control[:, :, order],
        readings=readings,
        prior=Gaussian(record.prior.mean[:, order], record.prior.cov),
        origin=record.origin[:, order],
    )


def test_the_order_of_the_runs_does_not_matter():
    record, motion, sensor = _problem(*LANDMARK)
    backward = posterior_bound(_runs(record, np.arange(12)[::-1]), motion, sensor)
    bound = posterior_bound(record, motion, sensor)
    np.testing.assert_allclose(backward, bound, rtol=1e-9, atol=1e-9 * bound.max())


def test_runs_that_are_there_twice_change_nothing():
    record, motion, sensor = _problem(*LANDMARK)
    twice = posterior_bound(_runs(record, np.arange(24) % 12), motion, sensor)
    bound = posterior_bound(record, motion, sensor)
    np.testing.assert_allclose(twice, bound, rtol=1e-9, atol=1e-9 * bound.max())


def test_readings_that_no_run_has_are_none_and_more_readings_never_raise_it():
    record, motion, sensor = _problem(*LANDMARK)
    values, landmark_number, step = record.readings.values.copy(), record.readings.landmark_number, record.readings.step
    values[:, ::2] = np.nan
    holes = replace(record, readings=Readings(step, values, landmark_number))
    fewer = replace(record, readings=Readings(step[1::2], values[:, 1::2], landmark_number[1::2]))
    bound, without, left = (posterior_bound(r, motion, sensor) for r in (record, holes, fewer))
    np.testing.assert_array_equal(without, left)
    size = np.sqrt(np.einsum("iit->it", without))
    gained = ((without - bound) / size / size[:, None]).transpose(2, 0, 1)
    assert np.linalg.eigvalsh(gained).min() > -1e-3
    assert np.linalg.eigvalsh(gained)[-1].max() > 0.1


def test_models_without_stated_derivatives_have_the_same_bound():
    record, motion, sensor = _problem(*LANDMARK)
    by_differences = posterior_bound(record, replace(motion, jacobians=None), replace(sensor, jacobian=None))
    bound = posterior_bound(record, motion, sensor)
    np.testing.assert_allclose(by_differences, bound, rtol=1e-6, atol=1e-6 * bound.max())


def test_a_shorter_record_has_the_beginning_of_the_bound():
    record, motion, sensor = _problem(*LANDMARK)
    short = posterior_bound(record.first(25), motion, sensor)
    np.testing.assert_array_equal(short, posterior_bound(record, motion, sensor)[:, :, :25])


@pytest.mark.parametrize(
    ("overrides", "known"),
    [
        (("scenario=field",), True),
        (("scenario=landmark",), False),
        (("scenario=landmark", "scenario.initial=truth"), True),
        (("scenario=car", "scenario.truth=model", "scenario.initial=drawn", SMALL), False),
    ],
)
def test_prior_and_first_step_are_about_the_origin_with_the_models_noises(overrides, known):
    record, motion, _ = _problem(*overrides, runs=400)
    error = motion.space.minus(record.prior.mean, record.origin)
    if known:
        np.testing.assert_array_equal(error, 0.0)
    else:
        ratio = (error**2).mean(axis=1) / np.diag(record.prior.cov)
        np.testing.assert_allclose(ratio, 1.0, atol=0.3)  # over 400 runs its standard deviation is .07
    control, lapse = record.control[:, 0], record.time[0] - record.start
    off = motion.space.minus(record.truth[:, 0], motion.function(control, lapse).evaluate(record.origin))
    cov = sandwich(motion.noise_jacobian(record.origin, control, lapse), motion.noise_cov(control, lapse))
    ratio = (off**2).mean(axis=1) / np.einsum("iir->ir", cov).mean(axis=1)
    np.testing.assert_allclose(ratio, 1.0, atol=0.3)
    assert record.first(1).origin is record.origin


def test_the_robot_on_video_has_a_bound_where_the_first_fix_is_what_the_filter_assumes():
    model = ("scenario=epuck", "scenario.truth=model")
    record, _, _ = _problem(*model)
    off = record.extra["fixes"][:, 0] - record.origin[:2, 0]
    assert (np.abs(off) < 4.0 * 0.3786).all()
    for other in (("scenario.led_sd=.5",), ("scenario.truth=drive",), ("noise.truth.measurement_scale=.5",)):
        assert _problem(*model, *other)[0].origin is None


@pytest.mark.parametrize(
    "overrides",
    [
        ("scenario=field", "scenario.prior=uniform"),
        ("scenario=sonar",),
        ("scenario=radar",),
        ("scenario=generator", "scenario.samples=10"),
        ("scenario=car",),
        ("scenario=car", "scenario.initial=drawn"),
        ("scenario=car", "scenario.truth=model"),
        ("scenario=car", "scenario.truth=model", "scenario.initial=drawn"),
        ("scenario=epuck",),
    ],
)
def test_what_is_not_drawn_from_its_own_gaussian_model_has_no_bound(overrides):
    record, motion, sensor = _problem(*overrides, runs=2)
    assert record.origin is None
    with pytest.raises(ValueError, match="no origin"):
        posterior_bound(record, motion, sensor)
