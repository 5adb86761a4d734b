"""Readings with holes, in every filter: a run alone is that run among others, on a linear problem the Kalman filter.

Its readings have two numbers with correlated noises.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtri

from estlab.filters.gaussian import GaussianFilter
from estlab.filters.loop import Loop
from estlab.filters.square_root import SquareRootFilter
from estlab.maths.streams import Streams
from estlab.record import Readings
from tests import linear
from tests.conftest import estimate, options, settings
from tests.laws.test_alone import only

STEPS, RUNS = 6, 3
HOLES = ["none", "some numbers", "one number always", "whole readings", "all readings", "each its own"]
GATED = ["ekf", "iekf", "second_order", "ukf", "ckf", "ghkf", "srukf", "srckf"]


def _record(holes, several):
    """Two readings a step, or one; some of their numbers missing."""
    record = linear.record(range(RUNS), steps=STEPS * (1 + several))
    values = record.readings.values.copy()
    rng = np.random.default_rng(7)
    if holes == "some numbers":
        values[rng.random(values.shape) < 0.4] = np.nan
    elif holes == "one number always":
        values[1] = np.nan
    elif holes == "whole readings":
        values[:, rng.random(values.shape[1]) < 0.4] = np.nan
    elif holes == "all readings":
        values[:] = np.nan
    elif holes == "each its own":
        values[0, ::2, 0] = values[1, 1::3, 1] = np.nan
        values[:, 2:5, 2] = np.nan
    step = np.arange(values.shape[1]) // (1 + several)
    readings = Readings(step, values, record.readings.landmark_number)
    return replace(
        record, time=record.time[:STEPS], truth=record.truth[:, :STEPS], control=record.control[:, :STEPS],
        readings=readings,
    )  # fmt: skip


def _kalman(record, run, gate, updating):
    """Mean (n, T) and covariance (n, n, T), the rows of missing numbers left out."""
    x, p = record.prior.mean[:, run], linear.P0
    means, covs = [], []
    for k in range(STEPS):
        x, p = linear.A @ x, linear.A @ p @ linear.A.T + linear.G @ linear.Q @ linear.G.T
        for i in np.flatnonzero(record.readings.step == k):
            z = record.readings.values[:, i, run]
            known = np.isfinite(z)
            h, r = linear.H[known], linear.R[np.ix_(known, known)]
            s = h @ p @ h.T + r
            off = z[known] - h @ x
            passes = gate is None or off @ np.linalg.solve(s, off) <= chdtri(known.sum(), 1.0 - gate)
            if known.any() and updating and passes:
                kalman_gain = p @ h.T @ np.linalg.inv(s)
                x, p = x + kalman_gain @ off, p - kalman_gain @ s @ kalman_gain.T
        means.append(x)
        covs.append(p)
    return np.stack(means, axis=1), np.stack(covs, axis=2)


def _settings(name, gate):
    """Of the filter, small where it draws."""
    small = {"enkf": ["filter.members=8"]} | {key: ["filter.particles=30"] for key in ("pf", "apf", "rpf")}
    gated = [] if gate is None else [f"filter.gate={gate}"]
    return settings(f"filter={name}", *small.get(name, []), *gated).filter


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "gate"), [(name, None) for name in options("filter")] + [(name, 0.8) for name in GATED]
)
def test_a_run_with_holes_is_alone_what_it_is_among_others_and_what_a_kalman_filter_finds(name, gate):
    filter, refused = _settings(name, gate), 0
    for holes in HOLES:
        # Stacked with a gate is refused: it would refuse all of a time's readings for one.
        for several, scheme in ((False, "sequential"), (True, "stacked" if gate is None else "sequential")):
            record = _record(holes, several)
            together = estimate(filter, linear.MOTION, linear.SENSOR, record, scheme)
            assert np.isfinite(together.mean).all(), holes
            for run in range(RUNS):
                alone = estimate(filter, linear.MOTION, linear.SENSOR, only(record, run), scheme, numbers=[run])
                for part in ("mean", "cov", "whitened", "log_scale"):
                    found, expected = getattr(alone, part)[..., 0], getattr(together, part)[..., run]
                    np.testing.assert_array_equal(found, expected, err_msg=f"{part}, {holes}")
                np.testing.assert_array_equal(alone.notes["gated"][:, 0], together.notes["gated"][:, run])
                if isinstance(filter, GaussianFilter | SquareRootFilter):
                    mean, cov = _kalman(record, run, gate, name != "dead_reckoning")
                    np.testing.assert_allclose(together.mean[..., run], mean, atol=1e-8, err_msg=holes)
                    np.testing.assert_allclose(together.cov[..., run], cov, atol=1e-8, err_msg=holes)
            refused += together.notes["gated"].sum()
    assert (refused > 0) == (gate is not None)


@pytest.mark.parametrize("holes", HOLES)
@pytest.mark.parametrize("name", ["ekf", "ukf", "ckf", "ghkf", "second_order", "iekf", "dead_reckoning"])
def test_what_is_smoothed_with_holes_is_alone_what_it_is_among_others(name, holes):
    record = _record(holes, True)
    loop = Loop(_settings(name, None), linear.MOTION, linear.SENSOR)
    _, together = loop.estimate_and_smooth(record, Streams(1, "test").generators("filter", range(RUNS)))
    assert np.isfinite(together.mean).all()
    for run in (0, 2):
        _, alone = loop.estimate_and_smooth(only(record, run), Streams(1, "test").generators("filter", [run]))
        np.testing.assert_array_equal(alone.mean[..., 0], together.mean[..., run])
        np.testing.assert_array_equal(alone.cov[..., 0], together.cov[..., run])
