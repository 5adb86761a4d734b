"""A run alone is that run among others, to the last bit, whatever the filter, its settings and the other runs."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest

from estlab.filters.loop import Loop
from estlab.maths.streams import Streams
from estlab.record import Readings
from tests.conftest import estimate, options, settings


def only(record, run):
    one = slice(run, run + 1)
    control = record.control if record.control.shape[2] == 1 else record.control[:, :, one]
    readings = Readings(
        record.readings.step, record.readings.values[:, :, one], record.readings.landmark_number[:, one]
    )
    prior = record.prior.take(np.array([run])) if record.each_its_own else record.prior
    return replace(record, truth=record.truth[:, :, one], control=control, readings=readings, prior=prior)


def _set_up(scenario, runs, steps, *words):
    """The experiment of these words, its record, and its models."""
    experiment = settings(f"scenario={scenario}", *words)
    problem, noise = experiment.scenario, experiment.noise.filter
    record = problem.simulate(Streams(2, scenario), runs, noise).first(steps)
    return experiment, record, (problem.motion(noise), problem.sensor(noise, record.landmarks))


def _assert_alone_as_among_others(filter, models, record, scheme, runs):
    """Each of these runs bit for bit, NaN where it is NaN; what all found is given back."""
    together = estimate(filter, *models, record, *scheme)
    for run in runs:
        own = run if record.each_its_own else 0  # the stream of the belief
        alone = estimate(filter, *models, only(record, run), *scheme, numbers=[own])
        for name in ("mean", "cov", "whitened", "log_scale"):
            found, expected = getattr(alone, name)[..., 0], getattr(together, name)[..., run]
            np.testing.assert_array_equal(found, expected, err_msg=name)
        for name, noted in together.notes.items():
            np.testing.assert_array_equal(alone.notes[name][:, 0], noted[:, run], err_msg=name)
    return together


@cache
def _with_every_filter(scenario):
    return _set_up(scenario, range(5), 40, *(f"+filter@filters.{name}={name}" for name in options("filter")))


@pytest.mark.slow
@pytest.mark.parametrize("name", options("filter"))
@pytest.mark.parametrize("scenario", options("scenario"))
def test_runs_in_a_batch_do_not_see_each_other(scenario, name):
    experiment, record, models = _with_every_filter(scenario)
    _assert_alone_as_among_others(experiment.filters[name], models, record, experiment.scenario.scheme, (0, 3))


@pytest.mark.parametrize(
    ("scenario", "words"),
    [
        ("car", ["filter=ukf", "filter.noise=additive"]),
        ("car", ["filter=ukf", "filter.alpha=0.001"]),
        ("car", ["filter=ukf", "filter.points=simplex"]),
        ("car", ["filter=ekf", "filter.noise=augmented"]),
        ("field", ["filter=second_order", "filter.form=modified"]),
        ("field", ["filter=second_order", "filter.noise=augmented"]),
        ("epuck", ["filter=ghkf", "filter.order=2", "filter.noise=augmented"]),
        ("radar", ["filter=iekf", "filter.gate=0.8"]),
    ],
)
def test_however_the_filter_is_set_a_run_alone_is_that_run_among_others(scenario, words):
    experiment, record, models = _set_up(scenario, range(4), 40, *words)
    _assert_alone_as_among_others(experiment.filter, models, record, experiment.scenario.scheme, (2,))


def test_runs_that_lose_their_covariance_do_so_at_the_same_step_alone_as_among_others():
    """Points of such negative weight break down in the course of time, where the last bit of a number decides when."""
    fragile = ["filter=ukf", "filter.points=julier", "filter.kappa=-4", "filter.noise=additive"]
    experiment, record, models = _set_up("car", range(8), 60, *fragile)
    found = _assert_alone_as_among_others(experiment.filter, models, record, experiment.scenario.scheme, range(8))
    broken = np.isnan(found.mean).any(axis=0)
    assert 0 < broken[-1].sum() < 8, "some were to break down, and some not"
    assert np.unique(broken.argmax(axis=0)).size > 3, "and not all at once"
    np.testing.assert_array_equal(np.maximum.accumulate(broken, axis=0), broken, err_msg="what is lost stays lost")


@pytest.mark.parametrize("words", ["ekf", "ukf", "ukf filter.noise=additive", "ghkf", "second_order"])
@pytest.mark.parametrize("runs", [1, 3])
def test_what_is_smoothed_was_filtered_to_the_same_numbers(words, runs):
    """With the cross-covariance that a smoother needs, and a single run with an axis of runs."""
    experiment, record, models = _set_up("landmark", range(runs), 40, *f"filter={words}".split())
    generators = Streams(1, "test").generators("filter", range(runs))
    loop = Loop(experiment.filter, *models, *experiment.scenario.scheme)
    (found, _), expected = loop.estimate_and_smooth(record, generators), loop.estimate(record, generators)
    for name in ("mean", "cov", "whitened", "log_scale"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("name", ["ekf", "ukf", "ghkf", "second_order", "srukf"])
def test_a_run_with_an_infinite_reading_is_nan_alone_as_among_others(name):
    experiment, record, models = _set_up("landmark", range(4), 40, f"filter={name}")
    record.readings.values[0, 5, 1] = np.inf
    found = _assert_alone_as_among_others(experiment.filter, models, record, experiment.scenario.scheme, (1, 2))
    np.testing.assert_array_equal(np.isnan(found.mean[:, -1]).any(axis=0), [False, True, False, False])


def test_runs_that_begin_again_from_the_prior_do_not_draw_for_their_neighbours():
    filter = ["filter=pf", "filter.particles=40", "filter.injection=0.2", "filter.recovery=redraw"]
    experiment = settings("scenario=sonar", *filter)
    problem, noise = experiment.scenario, experiment.noise.filter
    record = problem.simulate(Streams(2, "sonar"), range(5), noise).first(40)
    # Out of all bounds in two runs, so that every weight vanishes there and nowhere else.
    record.readings.values[:, 12, [1, 3]] = np.inf
    motion, sensor = problem.motion(noise), problem.sensor(noise, record.landmarks)
    together = estimate(experiment.filter, motion, sensor, record)
    np.testing.assert_array_equal(together.notes["vanished"][12], [0, 1, 0, 1, 0])
    for run in (0, 3):
        alone = estimate(experiment.filter, motion, sensor, only(record, run), numbers=[run])
        np.testing.assert_array_equal(together.mean[:, :, run], alone.mean[:, :, 0])


_GATED = [("sequential", "ekf filter.gate=0.9"), ("interleaved", "ukf filter.gate=0.9")]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scheme", "words"),
    [*product(["sequential", "stacked", "interleaved"], ["ukf", "ekf", "pf", "apf", "enkf", "srukf"]), *_GATED],
)
def test_runs_with_different_readings_do_not_see_each_other(scheme, words):
    """In the landmark room each run has its own number of readings at a time; no other run's may matter."""
    words = f"filter={words} scenario.dropped=0.5".split()
    experiment, record, models = _set_up("landmark", range(6), 60, *words)
    together = estimate(experiment.filter, *models, record, scheme, 0.02)
    assert getattr(experiment.filter, "gate", None) is None or together.notes["gated"].sum() > 0
    for run in (1, 4):
        own = experiment.scenario.simulate(Streams(2, "landmark"), [run], experiment.noise.filter).first(60)
        alone = estimate(experiment.filter, *models, own, scheme, 0.02, numbers=[run])
        np.testing.assert_array_equal(together.mean[:, :, run], alone.mean[:, :, 0])
        np.testing.assert_array_equal(together.cov[..., run], alone.cov[..., 0])
        np.testing.assert_array_equal(together.notes["gated"][:, run], alone.notes["gated"][:, 0])
        # A step has as many places for readings as its busiest run: what was measured is the same, in the same order.
        for fits in ((together.whitened, alone.whitened), (together.log_scale, alone.log_scale)):
            found, expected = (each[np.isfinite(each)] for each in (fits[0][..., run], fits[1][..., 0]))
            np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    "options", ["injection=0.1", "roughening=0.05", "bandwidth=1", "resampling=residual", "threshold=0.9"]
)
def test_a_particle_run_does_not_see_another_resample(options):
    experiment = settings("scenario=landmark", "filter=pf", "filter.particles=50", f"filter.{options}")
    problem, noise = experiment.scenario, experiment.noise.filter
    record = problem.simulate(Streams(2, "landmark"), range(6), noise).first(60)
    motion, sensor = problem.motion(noise), problem.sensor(noise, record.landmarks)
    together = estimate(experiment.filter, motion, sensor, record)
    alone = estimate(experiment.filter, motion, sensor, only(record, 3), numbers=[3])
    np.testing.assert_array_equal(together.mean[:, :, 3], alone.mean[:, :, 0])
