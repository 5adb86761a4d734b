"""Frames of many runs measured by compiled code against the same by NumPy, to the last bit; and the fold beneath."""

import numpy as np
import pytest

from estlab.compiled.fold import Fold
from estlab.maths.streams import Streams
from estlab.models import lidar_runs
from tests.conftest import settings

STEPS, RUNS = 40, 12


def _ends_and_sum(number, given, looked_up, kept, parameters):
    inside = number < given[0]
    value = looked_up[0] * parameters[0]
    return (
        np.where(number == 0.0, value, kept[0]),
        np.where(inside, kept[1] + value, kept[1]),
        np.where(inside, np.sin(given[1] + number), kept[2]),
    )


@pytest.mark.parametrize("lanes", [1, 2, 4, 8])
def test_a_fold_is_the_loop_over_each_members_numbers(lanes):
    rng = np.random.default_rng(3)
    count = np.array([5, 0, 1, 7, 2, 2, 9, 3, 0, 4, 6])
    first, table = np.cumsum(count) - count, rng.standard_normal(count.sum() + count.max())
    given = np.stack([count, rng.uniform(-9.0, 9.0, count.size)])
    given[1, 4] = 2e6  # beyond what the sine is right for
    fold = Fold(_ends_and_sum, given=2, looked_up=1, kept=3, parameters=1, lanes=lanes)
    kept, right = fold(count, given, table, first[None], (0.5, 0.0, -1.0), (3.0,))
    assert right.tolist() == [k != 4 for k in range(count.size)]
    for k in np.flatnonzero(right):
        own = 3.0 * table[first[k] : first[k] + count[k]]
        total = 0.0
        for value in own:
            total += value
        assert kept[1, k] == total
        last = np.sin(given[1, k] + count[k] - 1) if count[k] else -1.0
        assert kept[2, k] == pytest.approx(last, abs=1e-15)


def _drives():
    """Cars that pass far and near, over the sensor, beside it with an edge along the first ray, and out of sight."""
    rng = np.random.default_rng(5)
    time = np.linspace(-1.0, 1.0, STEPS)[:, None]
    x, y = 40.0 * time * np.ones(RUNS), rng.uniform(-6.0, 6.0, RUNS) * np.ones((STEPS, 1))
    heading = rng.uniform(-3.1, 3.1, RUNS) * np.ones((STEPS, 1))
    y[:, 0], heading[:, 0] = 0.9, 0.0  # half its width: the right edge's own bearing is a ray's
    x[:, 1] = 0.5 * time[:, 0]  # the sensor is within
    x[:, 2], y[:, 2] = 9e4, 300.0
    shape = np.ones((STEPS, RUNS))
    return np.stack([x, y, shape, heading, 4.7 * shape, 1.8 * shape])


@pytest.mark.parametrize("sds", [(0.3, 0.005), (0.0, 0.0), (1e-9, 1e-9)])
def test_frames_measured_by_compiled_code_are_those_by_numpy_to_the_last_bit(monkeypatch, sds):
    states, runs = _drives(), range(RUNS)

    def measured(least):
        monkeypatch.setattr(lidar_runs, "_MANY", least)
        return lidar_runs.measure_runs(states, Streams(2, "test"), runs, sds)

    compiled, by_numpy = measured(0), measured(STEPS * RUNS + 1)
    np.testing.assert_array_equal(compiled, by_numpy)
    assert np.isnan(by_numpy[:, :, 2]).all()
    assert np.isfinite(by_numpy).mean() > 0.8


def test_a_run_scanned_alone_is_that_run_among_all(monkeypatch):
    states = _drives()
    monkeypatch.setattr(lidar_runs, "_MANY", 0)
    streams = Streams(2, "test")
    together = lidar_runs.measure_runs(states, streams, range(RUNS), (0.3, 0.005))
    for run in (0, 5):
        alone = lidar_runs.measure_runs(states[:, :, [run]], streams, [run], (0.3, 0.005))
        np.testing.assert_array_equal(alone[:, :, 0], together[:, :, run])


def test_an_ensemble_is_scanned_by_compiled_code_where_that_pays(monkeypatch):
    scanned, by_rays = [], lidar_runs._by_rays

    def spied(scan, states, *rest):
        scanned.append(states.shape[2])
        return by_rays(scan, states, *rest)

    monkeypatch.setattr(lidar_runs, "_by_rays", spied)
    experiment = settings("scenario=car", "scenario.duration=1")
    for least, runs in ((200, 20), (201, 0)):
        monkeypatch.setattr(lidar_runs, "_MANY", least)
        scanned.clear()
        experiment.scenario.simulate(Streams(1, "car"), range(20), experiment.noise.truth)
        assert sum(scanned) == runs
