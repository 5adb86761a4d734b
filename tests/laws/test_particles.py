"""Clouds: sums that do not depend on the batch, and choosing without searching."""

import numpy as np
import pytest

from estlab.maths import cloud
from estlab.maths.resampling import Weights, resample
from estlab.maths.streams import Generators, Streams
from tests.conftest import estimate, settings
from tests.laws.test_alone import only

LARGE = cloud.CHUNK + 2345


@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("pf", ["filter.particles=700"]),
        ("pf", [f"filter.particles={LARGE}"]),
        ("pf", ["filter.particles=60", "filter.resampling=stratified", "filter.bandwidth=0.5"]),
        ("apf", ["filter.particles=300"]),
        ("enkf", ["filter.members=90"]),
    ],
)
def test_a_cloud_alone_is_to_the_last_bit_what_it_is_among_others(name, more):
    experiment = settings("scenario=sonar", f"filter={name}", *more)
    problem, noise = experiment.scenario, experiment.noise.filter
    record = problem.simulate(Streams(2, "sonar"), range(5), noise).first(8)
    motion, sensor = problem.motion(noise), problem.sensor(noise, record.landmarks)
    together = estimate(experiment.filter, motion, sensor, record)
    for run in (0, 3):
        alone = estimate(experiment.filter, motion, sensor, only(record, run), numbers=[run])
        np.testing.assert_array_equal(together.mean[..., run], alone.mean[..., 0])
        np.testing.assert_array_equal(together.cov[..., run], alone.cov[..., 0])
        np.testing.assert_allclose(together.whitened[..., run], alone.whitened[..., 0], rtol=1e-12)


class Chosen(Generators):
    """Given numbers in the place of drawn ones."""

    def __init__(self, numbers):
        self.numbers = numbers

    def uniforms(self, shape):
        return self.numbers[: shape[0]]


def awkward_weights(count):
    """Ties, points of no weight, one that has it all, and edges that fall on the positions themselves."""
    rng = np.random.default_rng(4)
    weights = rng.random((count, 6)) ** 8
    weights[:, 1] = 1.0
    weights[count // 2 :, 2] = 0.0
    weights[:, 3] = np.eye(count)[count // 3]
    weights[:, 4] = rng.integers(0, 3, count)
    weights[0, 4] = 1.0
    weights /= weights.sum(axis=0)
    return rng, weights


@pytest.mark.parametrize("scheme", ["systematic", "stratified"])
@pytest.mark.parametrize("count", [2, 8, 1000])
def test_systematic_and_stratified_choices_are_those_of_a_search(scheme, count):
    rng, weights = awkward_weights(count)
    for u in (
        rng.random((count, 6)),
        np.zeros((count, 6)),
        np.full((count, 6), 1.0 - 2.0**-53),
        rng.random((count, 6)),
    ):
        found = resample(scheme, weights, Chosen(u))
        for run in range(6):
            edges = np.cumsum(weights[:, run])
            positions = (np.arange(count) + (u[0, run] if scheme == "systematic" else u[:, run])) / count * edges[-1]
            expected = np.minimum(np.searchsorted(edges, positions, side="right"), count - 1)
            np.testing.assert_array_equal(found[:, run], expected)


def test_weights_sum_to_one_and_a_run_that_has_none_gets_equal_ones():
    logs = cloud.laid_out(np.random.default_rng(1).normal(-900.0, 3.0, (1, 50, 4)))[0]
    logs[:, 1] = -np.inf
    logs[7, 2] = np.nan
    expected = np.exp(logs + 900.0)
    weights = Weights.of_logs(logs)
    np.testing.assert_array_equal(weights.vanished, [False, True, False, False])
    np.testing.assert_allclose(weights.linear.sum(axis=0), 1.0, rtol=1e-14)
    np.testing.assert_allclose(weights.linear[:, 1], 1.0 / 50, rtol=1e-14)
    assert weights.linear[7, 2] == 0.0
    for run in (0, 2, 3):
        share = np.nan_to_num(expected[:, run])
        np.testing.assert_allclose(weights.linear[:, run], share / share.sum(), rtol=1e-12)
    np.testing.assert_allclose(np.exp(weights.log), weights.linear, rtol=1e-13)
    np.testing.assert_allclose(weights.size, 1.0 / (weights.linear**2).sum(axis=0), rtol=1e-13)
