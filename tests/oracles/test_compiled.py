"""The compiled filter loop against the one in NumPy, number by number."""

from dataclasses import replace

import numpy as np
import pytest

from estlab.errors import UserError
from estlab.filters.compiled.engine import CompiledLoop, noises
from estlab.filters.gaussian import extended
from estlab.filters.loop import Loop
from estlab.maths.streams import Streams
from estlab.models.contract import Motion
from estlab.scenarios.contract import Scales
from tests import linear, pendulum
from tests.compiled import assert_same, by_both, estimated, with_readings
from tests.conftest import settings
from tests.plugins.constant_velocity import Cart

pytest.importorskip("numba", reason="numba is not installed: pip install estlab[fast]")

LANDMARK = ("scenario=landmark", "steps=60", "runs=3")
CAR = ("scenario=car", "steps=60", "runs=2", "filter.noise=additive")
FIELD = ("scenario=field", "steps=60", "runs=3")
EKF = extended("additive", None)


@pytest.mark.parametrize(
    "words",
    [
        (*LANDMARK, "filter=ekf"),
        (*LANDMARK, "filter=ekf", "filter.gate=0.5"),
        (*LANDMARK, "filter=ekf", "filter.noise=augmented", "runs=1"),
        (*LANDMARK, "filter=ekf", "scenario.update=interleaved"),
        (*LANDMARK, "filter=dead_reckoning", "scenario.update=interleaved"),
        (*CAR, "filter=ukf"),
        (*CAR, "filter=ukf", "filter.points=simplex"),
        (*CAR, "filter=ghkf", "filter.order=2"),
        (*FIELD, "filter=ukf"),
        (*FIELD, "filter=ukf", "filter.points=julier", "filter.kappa=1", "filter.gate=0.7"),
        (*FIELD, "filter=ckf"),
        ("scenario=epuck", "steps=60", "runs=2", "filter=ekf", "filter.gate=0.9"),
    ],
    ids=" ".join,
)
def test_compiled_and_numpy_give_the_same_numbers(words):
    numpy, compiled = by_both(*words)
    assert np.isfinite(numpy.mean).all()
    assert_same(numpy, compiled, within=1e-9)
    assert ("gate" in " ".join(words)) == bool(compiled.notes["gated"].any())


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


@pytest.mark.parametrize(
    "words",
    [
        (*LANDMARK, "filter=ekf", "filter.gate=0.9"),
        (*LANDMARK, "filter=ekf", "runs=1"),
        (*FIELD, "filter=ukf"),
        (*FIELD, "filter=ukf", "runs=1"),
    ],
    ids=" ".join,
)
def test_readings_missing_in_part_or_whole_are_missed_alike(words):
    assert_same(*by_both(*words, change=with_readings(with_holes)), within=1e-9)


@pytest.mark.parametrize("words", [(*LANDMARK, "filter=ekf"), (*FIELD, "filter=ukf")], ids=" ".join)
def test_runs_that_diverge_become_nan_alike_and_their_neighbours_go_on(words):
    numpy, compiled = by_both(*words, change=with_readings(gone_wild))
    lost = np.isnan(numpy.mean).any(axis=(0, 1))
    assert lost.any()
    assert not lost[0]
    assert np.array_equal(np.isnan(numpy.mean), np.isnan(compiled.mean))
    assert_same(numpy, compiled, within=1e-9, runs=slice(1))


def test_a_run_alone_is_that_run_among_others_to_the_last_bit():
    among, alone = by_both(*LANDMARK, "filter=ekf")[1], by_both(*LANDMARK, "filter=ekf", "runs=1")[1]
    assert np.array_equal(among.mean[..., :1], alone.mean)
    assert np.array_equal(among.cov[..., :1], alone.cov)


def test_runs_without_readings_may_share_a_belief():
    def shared(record):
        record = with_readings(lambda values: np.full_like(values, np.nan))(record)
        return replace(record, prior=record.prior.of(np.zeros(1, dtype=int)), control=record.control[..., :1])

    numpy, compiled = by_both(*LANDMARK, "filter=ekf", change=shared)
    assert compiled.mean.shape[-1] == 3
    assert_same(numpy, compiled, within=1e-9)


def test_each_step_has_the_noise_of_its_own_command_and_length():
    motion = Motion(linear.STATE, linear.move, lambda control, dt: dt * np.eye(1)[..., None] * control[0], 1)
    control = np.arange(1.0, 13.0).reshape(1, 6, 2)
    lapse = np.array([0.5, 0.0, 2.0, 0.5, 2.0, 0.25])
    table, which = noises(motion, control, lapse, 0.0)
    for k in np.flatnonzero(lapse):
        assert np.array_equal(table[0, 0, which[k]], lapse[k] * control[0, k])


def test_slopes_by_differences_are_the_same_but_for_rounding_over_the_step(tmp_path, monkeypatch, capsys):
    """And where compiled code cannot be kept, it is compiled all the same."""
    (tmp_path / "file").touch()
    monkeypatch.setenv("ESTLAB_CACHE", str(tmp_path / "file"))
    loops = [kind(EKF, pendulum.MOTION, pendulum.SENSOR) for kind in (Loop, CompiledLoop)]
    numpy, compiled = (estimated(loop, pendulum.record()) for loop in loops)
    # A rounding of 1e-16 in the model is one of 1e-16 / 6e-6 in its slope.
    assert_same(numpy, compiled, within=1e-8)
    said = capsys.readouterr().err
    assert said.startswith(f"estlab: warning: {tmp_path / 'file' / 'compiled'}: compiled code cannot be kept here (")
    assert said.count("\n") == 1


def test_a_model_that_cannot_be_compiled_is_named():
    loop = CompiledLoop(EKF, replace(pendulum.MOTION, move=pendulum.pile), pendulum.SENSOR)
    loop.check_engine()
    with pytest.raises(
        UserError, match=r"^engine=numba cannot compile tests\.pendulum\.pile \(.+\); take engine=numpy$"
    ):
        estimated(loop, pendulum.record())


def test_noises_and_starts_of_less_than_full_rank_go_through_points_alike():
    scales = Scales(1.0, 1.0)
    problem = Cart(acceleration_sd=0.5, reading_sd=1.0, steps=12, known=True)
    record = problem.simulate(Streams(1, "cart"), range(2), scales)
    models = problem.motion(scales), problem.sensor(scales, record.places)
    numpy, compiled = (estimated(kind(settings("filter=ukf").filter, *models), record) for kind in (Loop, CompiledLoop))
    assert np.isfinite(numpy.cov).all()
    assert_same(numpy, compiled, within=1e-7)
