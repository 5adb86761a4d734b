"""The compiled filter loop against the one in NumPy, number by number."""

import numpy as np
import pytest

from estlab.filters.compiled.engine import noises
from estlab.models.contract import Motion
from tests.compiled import assert_same, by_both, with_readings
from tests.linear import STATE

pytest.importorskip("numba", reason="numba is not installed: pip install estlab[fast]")

LANDMARK = ("scenario=landmark", "steps=60", "runs=3")
CAR = ("scenario=car", "steps=60", "runs=2", "filter.noise=additive")
FIELD = ("scenario=field", "steps=60", "runs=3")


@pytest.mark.parametrize(
    "words",
    [
        (*LANDMARK, "filter=ekf"),
        (*LANDMARK, "filter=ekf", "filter.gate=0.5"),
        (*LANDMARK, "filter=ekf", "runs=1", "filter.noise=augmented"),
        (*LANDMARK, "filter=ekf", "scenario.update=interleaved"),
        (*LANDMARK, "filter=dead_reckoning", "scenario.update=interleaved"),
        (*CAR, "filter=ukf"),
        (*CAR, "filter=ukf", "filter.points=simplex"),
        (*CAR, "filter=ghkf", "filter.order=2"),
        (*FIELD, "filter=ukf"),
        (*FIELD, "filter=ukf", "filter.points=julier", "filter.kappa=1", "filter.gate=0.7"),
        (*FIELD, "filter=ckf"),
        ("scenario=epuck", "steps=60", "runs=2", "filter=ekf", "filter.gate=0.9"),
        ("scenario=radar", "runs=4", "filter=ekf"),
    ],
    ids=" ".join,
)
def test_compiled_and_numpy_give_the_same_numbers(words):
    numpy, compiled = by_both(*words)
    assert np.isfinite(numpy.mean).all()
    assert_same(numpy, compiled, within=1e-9)


def test_slopes_by_differences_are_the_same_but_for_rounding_over_the_step():
    # A rounding of 1e-16 in the model is one of 1e-16 / 6e-6 in its slope.
    assert_same(*by_both("scenario=car", "steps=30", "runs=2", "filter=ekf"), within=1e-7)


def with_holes(values):
    """Two of five numbers missing, and a fifth of the readings whole."""
    rng = np.random.default_rng(3)
    values[rng.random(values.shape) < 0.4] = np.nan
    values[:, rng.random(values.shape[1:]) < 0.2] = np.nan
    return values


def gone_wild(values):
    """Readings of the second run beyond all bounds, of the third infinite."""
    values[:, 5:8, 1] *= 1e200
    values[0, 10:12, 2] = np.inf
    return values


@pytest.mark.parametrize("words", [(*LANDMARK, "filter=ekf", "filter.gate=0.9"), (*FIELD, "filter=ukf")], ids=" ".join)
def test_readings_missing_in_part_or_whole_are_missed_alike(words):
    assert_same(*by_both(*words, change=with_readings(with_holes)), within=1e-9)


@pytest.mark.parametrize("words", [(*LANDMARK, "filter=ekf"), (*FIELD, "filter=ukf")], ids=" ".join)
def test_runs_that_diverge_become_nan_alike_and_their_neighbours_go_on(words):
    numpy, compiled = by_both(*words, change=with_readings(gone_wild))
    lost = np.isnan(numpy.mean).any(axis=(0, 1))
    assert list(lost)[0] is np.False_
    assert lost.any()
    assert np.array_equal(np.isnan(numpy.mean), np.isnan(compiled.mean))
    assert_same(*(estimates.first() for estimates in (numpy, compiled)), within=1e-9)


def test_a_run_alone_is_that_run_among_others_to_the_last_bit():
    among, alone = by_both(*LANDMARK, "filter=ekf")[1], by_both(*LANDMARK, "filter=ekf", "runs=1")[1]
    assert np.array_equal(among.mean[..., :1], alone.mean)
    assert np.array_equal(among.cov[..., :1], alone.cov)


def test_each_step_has_the_noise_of_its_own_command_and_length():
    motion = Motion(STATE, None, lambda control, dt: dt * np.eye(1)[..., None] * control[0], 1)
    control = np.arange(1.0, 13.0).reshape(1, 6, 2)
    lapse = np.array([0.5, 0.0, 2.0, 0.5, 2.0, 0.25])
    table, which = noises(motion, control, lapse, 0.0)
    for k in np.flatnonzero(lapse):
        assert np.array_equal(table[0, 0, which[k]], lapse[k] * control[0, k])
