"""The compiled filter loop against the one in NumPy, number by number."""

from dataclasses import replace

import numpy as np
import pytest

from estlab.compiled import cache
from estlab.config.settings import Names
from estlab.errors import UserError
from estlab.experiment.monte_carlo import loop_of, record_of
from estlab.filters.engine import CompiledLoop
from estlab.filters.gaussian import extended
from estlab.filters.loop import Loop
from estlab.filters.step_tables import noises
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.streams import Streams
from estlab.models.contract import Motion
from estlab.scenarios.scenario import Scales
from tests import linear, pendulum
from tests.compiled import assert_same, by_both, estimated, with_readings
from tests.conftest import options, settings
from tests.plugins.constant_velocity import Cart

pytestmark = pytest.mark.slow

LANDMARK = ("scenario=landmark", "steps=40", "runs=3")
CAR = ("scenario=car", "steps=12", "runs=2")
FIELD = ("scenario=field", "steps=40", "runs=3")
EKF = extended("additive", None)
COMPILED = ("dead_reckoning", "ekf", "iekf", "second_order", "ukf", "ckf", "ghkf", "srukf", "srckf")
BEYOND = {("car", "ghkf")}  # 729 points


@pytest.mark.parametrize("scenario", options("scenario"))
@pytest.mark.parametrize("name", COMPILED)
def test_every_scenario_by_every_filter_is_what_numpy_finds(scenario, name):
    if (scenario, name) in BEYOND:
        pytest.skip("more points than are unrolled: NumPy alone")
    # NumPy itself parts by 1e-9 in 25 steps of the car if readings move by one unit in the last place.
    steps = 12 if scenario == "car" else 25
    numpy, compiled = by_both(f"scenario={scenario}", f"filter={name}", f"steps={steps}", "runs=2")
    assert np.isfinite(numpy.mean).all()
    assert_same(numpy, compiled, within=1e-9)


@pytest.mark.parametrize(
    "words",
    [
        (*LANDMARK, "filter=ekf", "filter.gate=0.5"),
        (*LANDMARK, "filter=ekf", "filter.noise=augmented", "runs=1"),
        (*LANDMARK, "filter=ekf", "scenario.update=interleaved", "filter.gate=0.9", "scenario.dropped=0.5"),
        (*LANDMARK, "filter=ukf", "scenario.update=interleaved", "scenario.dropped=0.5"),
        (*LANDMARK, "filter=srckf", "scenario.update=interleaved", "scenario.dropped=0.5"),
        (*LANDMARK, "filter=ekf", "scenario.update=stacked", "scenario.dropped=0.5"),
        (*LANDMARK, "filter=ckf", "filter.noise=additive", "scenario.update=stacked", "scenario.dropped=0.5"),
        (*LANDMARK, "filter=iekf", "filter.gate=0.5"),
        (*LANDMARK, "filter=dead_reckoning", "scenario.update=interleaved"),
        (*LANDMARK, "filter=second_order", "filter.noise=augmented", "filter.form=modified"),
        (*CAR, "filter=ukf", "filter.noise=additive", "filter.points=simplex"),
        (*FIELD, "filter=ukf", "filter.points=julier", "filter.kappa=1", "filter.gate=0.7"),
        (*FIELD, "filter=ukf", "filter.points=simplex", "filter.noise=additive"),
        (*FIELD, "filter=srukf", "filter.gate=0.7"),
        ("scenario=epuck", "steps=40", "runs=2", "filter=ghkf", "filter.order=2", "filter.noise=augmented"),
    ],
    ids=" ".join,
)
def test_however_the_filter_is_set_it_finds_what_numpy_finds(words):
    numpy, compiled = by_both(*words)
    assert np.isfinite(numpy.mean).all()
    assert_same(numpy, compiled, within=1e-9)
    assert ("gate" in " ".join(words)) == bool(compiled.notes["gated"].any())


@pytest.mark.parametrize(
    "words", [(*LANDMARK, "filter=ekf"), (*FIELD, "filter=ukf"), (*LANDMARK, "filter=second_order")], ids=" ".join
)
def test_what_is_smoothed_is_what_numpy_smooths_and_what_was_filtered(words):
    wanted = settings(*words, names=Names("test", "test"))
    record = record_of(wanted, wanted.run_numbers)
    generators = Streams(1, "test").generators("filter", range(record.runs))
    numpy, compiled = (
        loop_of(replace(wanted, engine=engine), wanted.filter, record.landmarks).estimate_and_smooth(record, generators)
        for engine in ("numpy", "compiled")
    )
    for expected, found in zip(numpy, compiled, strict=True):
        assert_same(expected, found, within=1e-9)
    alone = loop_of(replace(wanted, engine="compiled"), wanted.filter, record.landmarks).estimate(record, generators)
    assert np.array_equal(alone.mean, compiled[0].mean)


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
        (*LANDMARK, "filter=srukf"),
        (*LANDMARK, "filter=iekf", "scenario.update=stacked"),
        (*FIELD, "filter=ukf"),
        (*FIELD, "filter=ukf", "runs=1"),
    ],
    ids=" ".join,
)
def test_readings_missing_in_part_or_whole_are_missed_alike(words):
    assert_same(*by_both(*words, change=with_readings(with_holes)), within=1e-9)


@pytest.mark.parametrize(
    "words",
    [(*LANDMARK, "filter=ekf"), (*FIELD, "filter=ukf"), (*LANDMARK, "filter=srukf", "scenario.update=interleaved")],
    ids=" ".join,
)
def test_runs_that_diverge_are_what_they_are_in_numpy_and_their_neighbours_go_on(words):
    numpy, compiled = by_both(*words, change=with_readings(gone_wild))
    lost = np.isnan(numpy.mean).any(axis=(0, 1))
    assert lost.any()
    assert not lost[0]
    assert_same(numpy, compiled, within=1e-9)
    for name in ("mean", "cov", "whitened", "log_scale"):  # by NumPy itself, to the last bit
        np.testing.assert_array_equal(getattr(compiled, name)[..., lost], getattr(numpy, name)[..., lost])


def test_runs_without_readings_may_share_a_belief():
    def shared(record):
        record = with_readings(lambda values: np.full_like(values, np.nan))(record)
        return replace(record, prior=record.prior.take(np.zeros(1, dtype=int)), control=record.control[..., :1])

    numpy, compiled = by_both(*LANDMARK, "filter=ekf", change=shared)
    assert compiled.mean.shape[-1] == 3
    assert_same(numpy, compiled, within=1e-9)


def test_lengths_of_time_may_differ_and_be_nothing():
    def uneven(record):
        time = record.time.copy()
        time[5], time[9:] = time[4], time[9:] + 0.37
        return replace(record, time=time)

    assert_same(*by_both(*LANDMARK, "filter=ukf", change=uneven), within=1e-9)


def test_each_step_has_the_noise_of_its_own_command_and_length():
    motion = Motion(linear.STATE, linear.move, lambda control, dt: dt * np.eye(1)[..., None] * control[0], 1)
    control = np.arange(1.0, 13.0).reshape(1, 6, 2)
    lapse = np.array([0.5, 0.0, 2.0, 0.5, 2.0, 0.25])
    table, which = noises(motion, control, lapse, 0.0)
    for k in np.flatnonzero(lapse):
        assert np.array_equal(table[0, 0, which[k]], lapse[k] * control[0, k])


def test_correlated_noises_go_through_alike():
    record = linear.record(range(3))
    for words in ("filter=ekf", "filter=ukf", "filter=srukf", "filter=ghkf"):
        filter = settings(words).filter
        numpy, compiled = (
            estimated(kind(filter, linear.MOTION, linear.SENSOR), record) for kind in (Loop, CompiledLoop)
        )
        assert_same(numpy, compiled, within=1e-11)


def test_models_that_state_no_jacobians_have_exact_ones_and_where_code_cannot_be_kept_it_is_compiled(
    tmp_path, monkeypatch, capsys
):
    (tmp_path / "file").touch()
    monkeypatch.setenv("ESTLAB_CACHE", str(tmp_path / "file"))
    cache._warn.cache_clear()
    loops = [kind(EKF, pendulum.MOTION, pendulum.SENSOR) for kind in (Loop, CompiledLoop)]
    numpy, compiled = (estimated(loop, pendulum.record()) for loop in loops)
    assert_same(numpy, compiled, within=1e-11)
    said = capsys.readouterr().err
    assert said.startswith(f"estlab: warning: {tmp_path / 'file' / 'compiled'}: compiled code cannot be kept here (")
    assert said.count("\n") == 1


def test_a_model_that_cannot_be_traced_is_named_or_runs_on_numpy(caplog):
    models = replace(pendulum.MOTION, move=pendulum.branching), pendulum.SENSOR
    line = (
        r"^engine=compiled cannot trace branching \(tests/pendulum\.py:\d+\): it branches on a value: take np\.where; "
        r"set engine=numpy$"
    )
    record = pendulum.record(runs=1)
    with pytest.raises(UserError, match=line):
        estimated(CompiledLoop(EKF, *models), record)
    caplog.set_level("INFO", "estlab")
    found = estimated(CompiledLoop(EKF, *models, insist=False), record)
    assert "engine=numpy, because the models cannot be traced: branching (tests/pendulum.py:" in caplog.text
    assert np.array_equal(found.mean, estimated(Loop(EKF, *models), record).mean)


def test_noises_and_starts_of_less_than_full_rank_are_left_to_numpy():
    scales = Scales(1.0, 1.0)
    problem = Cart(acceleration_sd=0.5, reading_sd=1.0, steps=12, known=True)
    record = problem.simulate(Streams(1, "cart"), range(2), scales)
    models = problem.motion(scales), problem.sensor(scales, record.landmarks)
    numpy, compiled = (estimated(kind(settings("filter=ukf").filter, *models), record) for kind in (Loop, CompiledLoop))
    assert np.isfinite(numpy.cov).all()
    assert_same(numpy, compiled, within=1e-7)


def test_where_nothing_is_known_to_be_wrong_nothing_is_left_to_numpy(monkeypatch):
    def unwanted(*_):
        raise AssertionError("NumPy went through a run that is sound")

    monkeypatch.setattr(Loop, "estimate", unwanted)
    wanted = settings(*CAR, "filter=ukf", "engine=compiled", names=Names("test", "test"))
    record = record_of(wanted, wanted.run_numbers)
    assert np.isfinite(estimated(loop_of(wanted, wanted.filter, record.landmarks), record).cov).all()


def test_a_prior_of_each_run_may_be_its_own():
    record = linear.record(range(3))
    own = Gaussian(record.prior.mean, np.stack([linear.P0, 2.0 * linear.P0, 3.0 * linear.P0], axis=2))
    record = replace(record, prior=own)
    numpy, compiled = (estimated(kind(EKF, linear.MOTION, linear.SENSOR), record) for kind in (Loop, CompiledLoop))
    assert_same(numpy, compiled, within=1e-11)


def test_without_llvm_auto_runs_on_numpy_and_compiled_says_so(monkeypatch, caplog):
    def missing():
        raise OSError("libllvmlite.so: cannot open shared object file")

    monkeypatch.setattr(cache, "lanes", missing)
    models, record = (pendulum.MOTION, pendulum.SENSOR), pendulum.record()
    line = r"^engine=compiled: llvmlite cannot be loaded \(libllvmlite\.so: cannot open .+\); reinstall it, or set"
    with pytest.raises(UserError, match=line):
        estimated(CompiledLoop(EKF, *models), record)
    found = estimated(CompiledLoop(EKF, *models, insist=False), record)
    assert "engine=numpy, because llvmlite cannot be loaded" in caplog.text
    assert np.array_equal(found.mean, estimated(Loop(EKF, *models), record).mean)
