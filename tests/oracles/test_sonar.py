"""The particle filter against a Bayes filter on a fine grid, and the resampling schemes against their theory."""

import numpy as np
import pytest

from estlab.filters.particle import ParticleFilter
from estlab.maths.resampling import SCHEMES, resample
from estlab.maths.space import Space
from estlab.maths.streams import Streams
from estlab.maths.uniform import Uniform
from estlab.models import sonar_beams
from estlab.models.contract import Motion, Sensor
from estlab.record import Readings, Record
from tests.conftest import estimate

# A robot kidnapped to a corridor, so that its belief is a curve: it hears the same sorted ranges.
LINE = Space(("along",), ("m",))
MARKS = np.array([[-2.0, 3.0, 9.0, 16.0], [1.0, -2.0, 3.0, -1.0]])
STEP_SD, RANGE_SD, STEPS = 0.3, 1.0, 6
MOTION = Motion(LINE, lambda x, u, w, dt: (x[0] + u[0] + w[0],), lambda u, dt: np.array([[STEP_SD**2]]), 1)


def ranges(state, landmark):
    return sonar_beams.nearest_ranges(np.stack([state[0], np.zeros_like(state[0]), np.zeros_like(state[0])]), MARKS)


SENSOR = Sensor(sonar_beams.READING, LINE, ranges, RANGE_SD**2 * np.eye(3), np.empty((0, 1)))


def corridor(runs):
    """The same truth and readings for every run: the runs differ in the filter's own draws alone."""
    rng = np.random.default_rng(8)
    control = rng.normal(0.8, 0.1, (1, STEPS))
    truth = 2.0 + np.cumsum(control + rng.normal(0.0, STEP_SD, (1, STEPS)), axis=1)
    values = np.stack(ranges(truth, None)) + rng.normal(0.0, RANGE_SD, (3, STEPS))
    readings = Readings(
        np.arange(STEPS), np.repeat(values[:, :, None], runs, axis=2), np.zeros((STEPS, runs), dtype=int)
    )
    prior = Uniform(np.array([-5.0]), np.array([20.0]), runs)
    time = 0.1 * np.arange(1, STEPS + 1)
    return Record(0.0, time, np.repeat(truth[:, :, None], runs, axis=2), control[:, :, None], readings, prior)


def on_a_grid(record):
    """Mean and variance after each step by the Bayes filter on a grid of 2 cm."""
    x = np.arange(-8.0, 30.0, 0.02)
    belief = ((x >= -5.0) & (x <= 20.0)).astype(float)
    means, variances = [], []
    for k in range(STEPS):
        shift = x[:, None] - x[None] - record.control[0, k, 0]
        belief = np.exp(-0.5 * (shift / STEP_SD) ** 2) @ belief
        residual = record.readings.values[:, k, :1] - np.stack(ranges(x[None], None))
        belief = belief * np.exp(-0.5 * (residual**2).sum(axis=0) / RANGE_SD**2)
        belief /= belief.sum()
        means.append(belief @ x)
        variances.append(belief @ x**2 - means[-1] ** 2)
    return np.array(means), np.array(variances)


def bootstrap(particles, scheme="systematic"):
    return ParticleFilter(particles, scheme, 0.5, 0.0, 0.0, 0.0, "bootstrap", "flatten")


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_error_against_the_grid_falls_like_one_over_the_root_of_the_particles(scheme):
    record = corridor(120)
    mean, variance = on_a_grid(record)
    counts, errors, of_variance = np.array([125, 500, 2000]), [], []
    for count in counts:
        found = estimate(bootstrap(count, scheme), MOTION, SENSOR, record)
        errors.append(np.sqrt(((found.mean[0] - mean[:, None]) ** 2).mean()))
        of_variance.append(np.sqrt(((found.cov[0, 0] - variance[:, None]) ** 2).mean()))
    for rms in (errors, of_variance):
        slope = np.polyfit(np.log(counts), np.log(rms), 1)[0]
        assert -0.6 < slope < -0.4
    # And it is the right mean, not one beside it: the bias is within the error of the mean of the runs.
    bias = found.mean[0].mean(axis=1) - mean
    assert (np.abs(bias) < 4.5 * found.mean[0].std(axis=1) / np.sqrt(120)).all()


WEIGHTS = np.array([0.02, 0.31, 0.07, 0.005, 0.16, 0.11, 0.245, 0.08])


def copies(scheme, times=4000):
    """How often each is chosen (8, times)."""
    generators = Streams(5, "resampling").generators(scheme, range(times))
    chosen = resample(scheme, np.repeat(WEIGHTS[:, None], times, axis=1), generators)
    return (chosen[:, None] == np.arange(WEIGHTS.size)[:, None]).sum(axis=0)


def test_every_scheme_chooses_each_n_times_its_weight_in_the_mean():
    for scheme in SCHEMES:
        count = copies(scheme)
        off = count.mean(axis=1) - WEIGHTS.size * WEIGHTS
        assert (np.abs(off) < 4.5 * count.std(axis=1) / np.sqrt(count.shape[1]) + 1e-12).all(), scheme
        assert (count.sum(axis=0) == WEIGHTS.size).all()


def test_the_variances_of_the_schemes_are_ordered():
    variance = {scheme: copies(scheme).var(axis=1) for scheme in SCHEMES}
    expected = WEIGHTS.size * WEIGHTS
    np.testing.assert_allclose(variance["multinomial"], expected * (1.0 - WEIGHTS), rtol=0.1)
    # Systematic: each as often as N w rounded down or up, a coin whose variance is known.
    part = expected - np.floor(expected)
    np.testing.assert_allclose(variance["systematic"], part * (1.0 - part), atol=0.02)
    total = {scheme: values.sum() for scheme, values in variance.items()}
    for between in ("residual", "stratified"):
        assert total["multinomial"] > 1.2 * total[between] > 1.2 * total["systematic"]
