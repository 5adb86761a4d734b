"""Particles in compiled code: a run is that run alone, at any width and among any others, to the last bit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from estlab.compiled import cache
from estlab.errors import UserError
from estlab.filters.compiled_particles import CompiledParticleFilter
from estlab.filters.loop import Loop
from estlab.filters.particle_code import CompiledGenerators, ParticleCode
from estlab.filters.particle_engine import ParticleLoop
from estlab.maths import cloud
from estlab.maths.resampling import SCHEMES
from estlab.maths.streams import Streams
from estlab.models.contract import Motion
from tests import pendulum
from tests.conftest import settings
from tests.laws.test_alone import only
from tests.laws.test_particles import awkward_weights

FIELDS = ("mean", "cov", "whitened", "log_scale", "sample")
MODELS = pendulum.MOTION, pendulum.SENSOR


def estimated(loop, record, runs=None, **options):
    """The runs' own streams, whichever they stand beside."""
    return loop.estimate(record, Streams(1, "test").generators("filter", runs or range(record.runs)), **options)


def assert_same_bits(found, expected, runs=slice(None)):
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name)[..., runs], err_msg=name)
    for name, noted in expected.notes.items():
        np.testing.assert_array_equal(found.notes[name], noted[:, runs], err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("scenario=sonar", "filter=pf"),
        ("scenario=sonar", "filter=pf", "filter.particles=4001", "filter.resampling=stratified"),
        ("scenario=landmark", "filter=pf", "scenario.dropped=0.5", "filter.resampling=multinomial"),
        ("scenario=landmark", "filter=apf", "scenario.update=interleaved"),
        ("scenario=field", "filter=rpf", "filter.resampling=residual"),
    ],
    ids=" ".join,
)
def test_vectors_of_any_width_and_runs_of_any_number_give_the_same_bits(words):
    particles = () if any("particles" in word for word in words) else ("filter.particles=109",)
    experiment = settings(*words, *particles)
    problem, noise = experiment.scenario, experiment.noise.filter
    record = problem.simulate(Streams(2, "test"), range(5), noise).first(12)
    record.readings.values[np.random.default_rng(1).random(record.readings.values.shape) < 0.2] = np.nan
    parts = experiment.filter, problem.motion(noise), problem.sensor(noise, record.landmarks), *problem.scheme
    expected = estimated(ParticleLoop(*parts, lanes=8), record)
    assert np.isfinite(expected.mean).all()
    for lanes in (2, 4):
        assert_same_bits(estimated(ParticleLoop(*parts, lanes=lanes), record), expected)
    loop = ParticleLoop(*parts)
    for run in (0, 4):
        assert_same_bits(estimated(loop, only(record, run), [run]), expected, slice(run, run + 1))
    assert_same_bits(estimated(loop, record), expected)


def test_a_run_that_is_left_to_numpy_is_numpys_and_its_neighbours_are_as_they_were():
    wanted, record = settings("filter=pf", "filter.particles=60").filter, pendulum.record(runs=3)
    expected = estimated(ParticleLoop(wanted, *MODELS), record, watched=2)
    far = record.prior.mean.copy()
    far[0, 1] = 3e6
    record = replace(record, prior=record.prior._replace(mean=far))
    steps = []
    found = estimated(ParticleLoop(wanted, *MODELS), record, watched=2, on_step=lambda: steps.append(1))
    numpy = estimated(Loop(wanted, *MODELS), record, watched=2)
    assert len(steps) == record.time.size
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(found, name)[..., [0, 2]], getattr(expected, name)[..., [0, 2]])
        np.testing.assert_array_equal(getattr(found, name)[..., 1], getattr(numpy, name)[..., 1])
    np.testing.assert_array_equal(found.notes["ess"][:, 1], numpy.notes["ess"][:, 1])
    for name in ("points", "weights"):
        np.testing.assert_array_equal(found.cloud[name][..., 0], expected.cloud[name][..., 0])
        np.testing.assert_array_equal(found.cloud[name][..., 1], numpy.cloud[name][..., 1])


def test_runs_that_share_a_belief_share_what_is_left_to_numpy():
    wanted, record = settings("filter=pf", "filter.particles=60").filter, pendulum.record(runs=3)
    record.readings.values[:] = np.nan
    mean = record.prior.mean[:, :1]
    for angle, same in ((0.3, False), (3e6, True)):
        shared = replace(record, prior=record.prior._replace(mean=np.array([[angle], mean[1]])))
        numpy, compiled = (estimated(kind(wanted, *MODELS), shared, range(1)) for kind in (Loop, ParticleLoop))
        np.testing.assert_allclose(compiled.mean, numpy.mean, rtol=1e-9)
        assert np.array_equal(compiled.cov, numpy.cov) == same


@pytest.mark.parametrize("first", [0, 30])
def test_preparing_draws_nothing_and_leaves_nothing_to_compile(first, monkeypatch):
    """By a step in which a run has a reading, wherever that is."""
    wanted, record = settings("filter=pf", "filter.particles=60").filter, pendulum.record(runs=3)
    record.readings.values[:, :first] = np.nan
    record.readings.values[:, first, :2] = np.nan
    loop, generators = ParticleLoop(wanted, *MODELS), Streams(1, "test").generators("filter", range(3))
    loop.prepare(record, generators)
    expected = estimated(ParticleLoop(wanted, *MODELS), record)
    monkeypatch.setattr(cache, "program", None)
    assert_same_bits(loop.estimate(record, generators), expected)


def test_models_that_cannot_be_traced_are_named_or_run_on_numpy(caplog):
    models = replace(pendulum.MOTION, move=pendulum.branching), pendulum.SENSOR
    wanted, record = settings("filter=pf", "filter.particles=20").filter, pendulum.record(runs=1)
    line = (
        r"^engine=compiled cannot trace branching \(tests/pendulum\.py:\d+\): it branches on a value: take np\.where; "
        r"set engine=numpy$"
    )
    with pytest.raises(UserError, match=line):
        estimated(ParticleLoop(wanted, *models), record)
    caplog.set_level("INFO", "estlab")
    loop = ParticleLoop(wanted, *models, insist=False)
    loop.prepare(record, Streams(1, "test").generators("filter", range(1)))
    np.testing.assert_array_equal(estimated(loop, record).mean, estimated(Loop(wanted, *models), record).mean)
    assert caplog.text.count("engine=numpy, because the models cannot be traced: branching (tests/pendulum.py:") == 1


def test_without_llvm_auto_runs_on_numpy_and_compiled_says_so(monkeypatch, caplog):
    def missing():
        raise OSError("libllvmlite.so: cannot open shared object file")

    monkeypatch.setattr(cache, "lanes", missing)
    wanted, record = settings("filter=pf", "filter.particles=20").filter, pendulum.record(runs=1)
    with pytest.raises(UserError, match=r"^engine=compiled: llvmlite cannot be loaded \(libllvmlite\.so: cannot open"):
        estimated(ParticleLoop(wanted, *MODELS), record)
    found = estimated(ParticleLoop(wanted, *MODELS, insist=False), record)
    assert "engine=numpy, because llvmlite cannot be loaded" in caplog.text
    np.testing.assert_array_equal(found.mean, estimated(Loop(wanted, *MODELS), record).mean)


def test_noise_whose_entries_come_and_go_is_all_taken():
    """A factor that has other entries at some steps is another program, not another answer."""

    def noise_cov(control, dt):
        mixed = 0.02 * float(dt > 0.07)
        return np.array([[0.04, mixed], [mixed, 0.09]])

    def move(state, control, noise, dt):
        angle, rate = pendulum.swing(state, control, noise[:1], dt)
        return angle, rate + noise[1] * dt

    motion = Motion(pendulum.STATE, move, noise_cov, 2)
    wanted, record = settings("filter=pf", "filter.particles=40").filter, pendulum.record(steps=20)
    time = record.time.copy()
    time[10:] += np.arange(1, 11) * 0.05
    record = replace(record, time=time)
    numpy, compiled = (estimated(kind(wanted, motion, pendulum.SENSOR), record) for kind in (Loop, ParticleLoop))
    np.testing.assert_allclose(compiled.mean, numpy.mean, rtol=1e-9, atol=1e-12)


class Fixed(CompiledGenerators):
    """Given uniform numbers (N, runs) in the place of drawn ones."""

    def __init__(self, code, numbers):
        super().__init__(code, np.zeros((numbers.shape[1], 4), dtype=np.uint64), np.zeros((numbers.shape[1], 8)),
                         np.arange(numbers.shape[1]))  # fmt: skip
        self.numbers = numbers

    def uniforms(self, shape):
        return self.numbers[: shape[0]]


def both(scheme, count, lanes=None):
    """A filter in NumPy, and the same one compiled."""
    wanted = settings("filter=pf", f"filter.particles={count}", f"filter.resampling={scheme}").filter
    return wanted, CompiledParticleFilter.of(wanted, ParticleCode(*MODELS, lanes or cache.lanes()))


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("count", [2, 8, 1000])
def test_particles_are_chosen_as_numpy_chooses_them(scheme, count):
    rng, weights = awkward_weights(count)
    numpy, compiled = both(scheme, count)
    for u in (rng.random((count, 6)), np.zeros((count, 6)), np.full((count, 6), 1.0 - 2.0**-53)):
        expected, found = (f._chosen(weights, Fixed(compiled.code, u)) for f in (numpy, compiled))
        np.testing.assert_array_equal(found, expected)


@given(
    hnp.arrays(
        float,
        st.tuples(st.integers(2, 40), st.integers(1, 3)),
        elements=st.one_of(st.floats(-800.0, 800.0), st.sampled_from([np.nan, -np.inf, np.inf, -0.0])),
    ),
    st.sampled_from([2, 4, 8]),
)
def test_weights_of_any_logarithms_are_numpys(logs, lanes):
    """NaN is none; where there are none, all are alike; whatever the number of particles and the width."""
    numpy, compiled = both("systematic", len(logs), lanes)
    expected, found = (f._weights(cloud.laid_out(logs[None])[0]) for f in (numpy, compiled))
    np.testing.assert_array_equal(found.vanished, expected.vanished)
    np.testing.assert_allclose(found.linear, expected.linear, rtol=1e-12, atol=1e-300)
    np.testing.assert_allclose(found.size, expected.size, rtol=1e-12)
    with np.errstate(invalid="ignore"):
        np.testing.assert_allclose(np.exp(found.log), found.linear, rtol=1e-12, atol=1e-300)
