"""A run by compiled code is that run alone, at any width and among any others, to the last bit."""

from dataclasses import replace

import numpy as np
import pytest

from estlab.filters.engine import CompiledLoop
from estlab.maths.streams import Streams
from estlab.record import Readings
from tests.conftest import settings
from tests.laws.test_alone import only

FIELDS = ("mean", "cov", "whitened", "log_scale")


def set_up(runs, *words):
    """A compiled loop of any width, and a record with holes in it, of which each run has its own."""
    experiment = settings(*words)
    problem, noise = experiment.scenario, experiment.noise.filter
    record = problem.simulate(Streams(2, "test"), range(runs), noise).first(30)
    values = record.readings.values.copy()
    values[np.random.default_rng(1).random(values.shape) < 0.2] = np.nan
    record = replace(record, readings=Readings(record.readings.step, values, record.readings.landmark_number))
    models = problem.motion(noise), problem.sensor(noise, record.landmarks)
    return lambda lanes: CompiledLoop(experiment.filter, *models, *problem.scheme, lanes=lanes), record


def estimated(loop, record):
    return loop.estimate(record, Streams(1, "test").generators("filter", range(record.runs)))


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("scenario=landmark", "filter=ekf", "filter.gate=0.9", "scenario.dropped=0.5"),
        ("scenario=landmark", "filter=ukf", "scenario.update=interleaved"),
        ("scenario=field", "filter=srukf"),
        ("scenario=sonar", "filter=iekf"),
        ("scenario=car", "filter=ukf", "filter.noise=additive"),
    ],
    ids=" ".join,
)
def test_vectors_of_any_width_and_runs_of_any_number_give_the_same_bits(words):
    loop, record = set_up(11, *words)
    expected = estimated(loop(8), record)
    assert np.isfinite(expected.mean).all()
    others = [(estimated(loop(lanes), record), slice(None)) for lanes in (2, 4)]
    others += [(estimated(loop(8), only(record, run)), slice(run, run + 1)) for run in (0, 10)]
    for found, runs in others:
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name)[..., runs], err_msg=name)
        np.testing.assert_array_equal(found.notes["gated"], expected.notes["gated"][:, runs])


@pytest.mark.parametrize(
    "words", [("scenario=landmark", "filter=ekf"), ("scenario=field", "filter=srukf")], ids=" ".join
)
@pytest.mark.parametrize("lanes", [2, 4, 8])
def test_what_goes_past_the_caches_is_what_goes_through_them(monkeypatch, words, lanes):
    loop, record = set_up(24, *words)
    expected = estimated(loop(lanes), record)
    monkeypatch.setattr("estlab.filters.given._BEYOND_CACHES", 0)
    streamed = loop(lanes)
    found = estimated(streamed, record)
    (program,) = streamed._programs.values()
    assert "nontemporal !0" in program.text
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    # Rows of other lengths do not begin with a line of the caches.
    estimated(odd := loop(2), only(record, 3))
    assert all(not shape.streamed for shape, _ in odd._programs)


def test_arrays_of_any_strides_give_the_same_bits():
    loop, record = set_up(6, "scenario=landmark", "filter=ekf")
    expected = estimated(loop(2), record)
    readings = record.readings
    wide = np.repeat(readings.values, 2, axis=1)[:, : readings.step.size]
    wide[...] = readings.values
    turned = np.asfortranarray(readings.values)
    control = np.concatenate([record.control, record.control], axis=1)[:, : record.time.size]
    for values in (wide, turned):
        found = estimated(loop(2), replace(record, control=control, readings=replace(readings, values=values)))
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)


def test_runs_that_are_left_to_numpy_leave_the_others_as_they_are():
    loop, record = set_up(6, "scenario=field", "filter=ukf")
    expected = estimated(loop(2), record)
    record.readings.values[:, 12, 2] = np.inf
    found = estimated(loop(2), record)
    others = [0, 1, 3, 4, 5]
    assert np.isnan(found.mean[..., 2]).any()
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(found, name)[..., others], getattr(expected, name)[..., others])


def test_what_comes_in_several_stretches_is_what_comes_in_one(monkeypatch):
    loop, record = set_up(3, "scenario=field", "filter=ekf")
    expected = estimated(loop(2), record)
    monkeypatch.setattr("estlab.filters.engine._AT_ONCE", 20)
    ticks = []
    generators = Streams(1, "test").generators("filter", range(record.runs))
    found = loop(2).estimate(record, generators, lambda: ticks.append(1))
    assert len(ticks) == record.time.size
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
