"""Noises and starts of less than full rank, as a white acceleration's: in simulation, filters, smoother and bound."""

import numpy as np
import pytest

from estlab.filters.gaussian import GaussianFilter
from estlab.filters.loop import Loop
from estlab.filters.square_root import SquareRootFilter
from estlab.maths.linalg import cholesky
from estlab.maths.streams import Streams
from estlab.metrics.bound import posterior_bound
from estlab.metrics.scores import Limits, score
from estlab.scenarios.scenario import Scales
from tests.conftest import estimate, options, settings, tallied
from tests.laws.test_alone import only
from tests.plugins.constant_velocity import Cart

MANY, RUNS, NOISE = 300, 4, Scales(1.0, 1.0)


def _of_rank(n, rank, scaled):
    """Covariances (n, n, MANY) of this rank, in units of any size."""
    rng = np.random.default_rng(n + 10 * rank)
    g = rng.standard_normal((n, rank, MANY)) * (10.0 ** rng.integers(-6, 7, (n, 1, MANY)) if scaled else 1.0)
    return np.einsum("ikb,jkb->ijb", g, g)


@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize(("n", "rank"), [(n, rank) for n in (1, 2, 3, 6) for rank in range(n + 1)])
def test_a_covariance_of_any_rank_has_a_factor_alone_as_among_many(n, rank, scaled):
    p = _of_rank(n, rank, scaled)
    factor = cholesky(p)
    size = np.sqrt(np.einsum("iib->ib", p))
    off = np.abs(np.einsum("ikb,jkb->ijb", factor, factor) - p)
    assert (off <= 1e-13 * size[:, None] * size).all()
    np.testing.assert_array_equal(np.triu(np.moveaxis(factor, 2, 0), 1), 0.0)
    for i in range(0, MANY, 20):
        np.testing.assert_array_equal(cholesky(p[..., i].copy()), factor[..., i])


@pytest.mark.parametrize("short", [1e-10, 1e-6, 1.0])
def test_what_is_no_covariance_by_more_than_rounding_has_no_factor(short):
    for n, rank in ((2, 1), (3, 2), (6, 3)):
        p = _of_rank(n, rank, scaled=True)
        p[n - 1, n - 1] *= 1.0 - short
        size = np.sqrt(np.einsum("iib->ib", _of_rank(n, rank, scaled=True)))
        lowest = np.linalg.eigvalsh(np.moveaxis(p / size / size[:, None], 2, 0))[:, 0]
        indefinite = lowest < -1e-13
        assert indefinite.mean() > 0.9
        assert np.isnan(cholesky(p))[..., indefinite].all()


@pytest.fixture(scope="module", params=[False, True], ids=["unknown start", "known start"])
def cart(request):
    """The scenario, its models and a record: a process noise of rank one, and a start of rank two or none."""
    problem = Cart(acceleration_sd=0.5, reading_sd=1.0, steps=12, known=request.param)
    record = problem.simulate(Streams(1, "cart"), range(RUNS), NOISE)
    return problem, (problem.motion(NOISE), problem.sensor(NOISE, record.landmarks)), record


def _kalman(cart, run):
    """Filtered and smoothed means and covariances by the textbook, with a pseudo-inverse for the smoother."""
    _, (motion, sensor), record = cart
    dt = record.time[0]
    a, q, h = np.array([[1.0, dt], [0.0, 1.0]]), motion.noise_cov(np.empty(0), dt), np.array([[1.0, 0.0]])
    x, p = record.prior.mean[:, run], record.prior.cov
    forward = []
    for z in record.readings.values[:, :, run].T:
        x_, p_ = a @ x, a @ p @ a.T + q
        kalman_gain = p_ @ h.T / (h @ p_ @ h.T + sensor.noise_cov)
        forward.append((x, p, x_, p_))
        x, p = x_ + kalman_gain @ (z - h @ x_), p_ - kalman_gain @ h @ p_
    filtered = [(x, p) for x, p, _, _ in forward[1:]] + [(x, p)]
    smoothed = [(x, p)]
    for x, p, x_, p_ in reversed(forward[1:]):
        kalman_gain = p @ a.T @ np.linalg.pinv(p_, hermitian=True)
        later, spread = smoothed[0]
        smoothed.insert(0, (x + kalman_gain @ (later - x_), p + kalman_gain @ (spread - p_) @ kalman_gain.T))
    return [[np.stack(part, axis=-1) for part in zip(*beliefs, strict=True)] for beliefs in (filtered, smoothed)]


def test_what_is_simulated_has_such_noise(cart):
    """Position and velocity are pushed by one number at each step."""
    _, _, record = cart
    truth, dt = record.truth, record.time[0]
    push = np.diff(truth[1], axis=0)
    np.testing.assert_allclose(np.diff(truth[0], axis=0) - dt * truth[1, :-1], 0.5 * dt * push, atol=1e-12)
    assert np.abs(push).min() > 0.0


@pytest.mark.parametrize("name", options("filter"))
def test_every_filter_takes_it_alone_as_among_others(cart, name):
    problem, models, record = cart
    small = {"enkf": ["filter.members=12"]} | {key: ["filter.particles=300"] for key in ("pf", "apf", "rpf")}
    filter = settings(f"filter={name}", *small.get(name, [])).filter
    found = estimate(filter, *models, record)
    for run in range(RUNS):
        alone = estimate(filter, *models, only(record, run), numbers=[run])
        np.testing.assert_array_equal(alone.mean[..., 0], found.mean[..., run])
        np.testing.assert_array_equal(alone.cov[..., 0], found.cov[..., run])
        if isinstance(filter, GaussianFilter | SquareRootFilter) and name != "dead_reckoning":
            (mean, cov), _ = _kalman(cart, run)
            np.testing.assert_allclose(found.mean[..., run], mean, atol=1e-7)
            np.testing.assert_allclose(found.cov[..., run], cov, atol=1e-7)
    assert sum(tallied(problem, record, found).diverged.values()) == 0


@pytest.mark.parametrize("noise", ["additive", "augmented"])
@pytest.mark.parametrize("name", ["ekf", "ukf", "ckf", "ghkf", "second_order"])
def test_the_smoother_takes_it(cart, name, noise):
    _, models, record = cart
    loop = Loop(settings(f"filter={name}", f"filter.noise={noise}").filter, *models)
    _, found = loop.estimate_and_smooth(record, Streams(1, "test").generators("filter", range(RUNS)))
    for run in range(RUNS):
        _, (mean, cov) = _kalman(cart, run)
        np.testing.assert_allclose(found.mean[..., run], mean, atol=1e-6)
        np.testing.assert_allclose(found.cov[..., run], cov, atol=1e-6)


def test_the_bound_takes_it(cart):
    _, models, record = cart
    (_, cov), _ = _kalman(cart, 0)
    np.testing.assert_allclose(posterior_bound(record, *models), cov, atol=1e-8)


def test_a_covariance_without_an_inverse_is_none_that_broke_and_has_no_nees():
    problem = Cart(acceleration_sd=0.5, reading_sd=1.0, steps=12, known=True)
    record = problem.simulate(Streams(1, "cart"), range(RUNS), NOISE)
    models = problem.motion(NOISE), problem.sensor(NOISE, record.landmarks)
    scores = score(problem.space, Limits(), record, estimate(settings("filter=ekf").filter, *models, record))
    # After one step position and velocity vary together, after two each on its own.
    assert not scores.diverged.any()
    np.testing.assert_array_equal(np.isfinite(scores.nees).T, [np.arange(12) > 0] * RUNS)
