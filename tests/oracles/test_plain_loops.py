"""The Gaussian filters against the plain loops that their speed is measured by: the same answers."""

import numpy as np
import pytest

from benchmarks.speed import reference
from estlab.maths.streams import Streams
from tests.conftest import estimate, settings

RUNS, STEPS = 2, 30


def _estimated(*words):
    """Scenario, the filter's noises, record and estimates."""
    chosen = settings(*words)
    scenario, noise = chosen.scenario, chosen.noise.filter
    record = scenario.simulate(Streams(1, "plain"), range(RUNS), noise).first(STEPS)
    models = scenario.motion(noise), scenario.sensor(noise, record.landmarks)
    return models, record, estimate(chosen.filter, *models, record, *scenario.scheme)


def _assert_same(found, expected):
    """To 1e-9 of each component's largest value over the run."""
    gap = np.abs(found - expected).max(axis=0)
    assert (gap <= 1e-9 * np.abs(expected).max(axis=0)).all(), f"off by {gap / np.abs(expected).max(axis=0)}"


@pytest.mark.parametrize("transform", [reference.unscented, reference.unscented_by_matrices])
def test_the_cars_ukf_finds_what_a_plain_loop_finds(transform):
    (motion, sensor), record, found = _estimated("scenario=car", "filter=ukf", "filter.noise=additive")
    dt = float(np.diff(record.time)[0])
    for run in range(RUNS):
        mean, cov, nis = reference.car_ukf(
            record.prior.mean[:, run],
            record.prior.cov,
            record.readings.values[:, :, run].T,
            motion.noise_cov(record.control[:, 0], dt),
            sensor.noise_cov,
            dt,
            transform,
        )
        _assert_same(found.mean[..., run].T, mean)
        _assert_same(np.moveaxis(found.cov[..., run], 2, 0), cov)
        _assert_same((found.whitened[..., run] ** 2).sum(axis=0), nis)


@pytest.mark.parametrize("name", ["ekf", "ukf"])
def test_the_robots_filters_find_what_a_plain_loop_finds(name):
    (motion, sensor), record, found = _estimated("scenario=landmark", f"filter={name}", "filter.noise=additive")
    dt = float(np.diff(record.time)[0])
    for run in range(RUNS):
        mean, cov = reference.landmark_filter(
            name == "ekf",
            record.prior.mean[:, run],
            record.prior.cov,
            record.control[:, :, run].T,
            _in_turn(record, run),
            motion.noise_cov(record.control[:, 0], dt),
            sensor.noise_cov,
            dt,
        )
        _assert_same(found.mean[..., run].T, mean)
        _assert_same(np.moveaxis(found.cov[..., run], 2, 0), cov)


def _in_turn(record, run):
    """For each step, a run's (reading, landmark) one after another."""
    values, landmark_numbers = record.readings.values[:, :, run].T, record.readings.landmark_number[:, run]
    taken = [[] for _ in record.time]
    for step, value, landmark_number in zip(record.readings.step, values, landmark_numbers, strict=True):
        if np.isfinite(value).all():
            taken[step].append((value, record.landmarks[:, landmark_number]))
    assert max(map(len, taken)) > 1, "several readings at a time were to be taken"
    return taken
