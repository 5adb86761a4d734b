"""Particle filters in compiled code against those in NumPy, number by number; and NumPy's random numbers themselves."""

import numpy as np
import pytest

from estlab.compiled import cache, numpy_streams
from estlab.errors import UserError
from estlab.filters.loop import Loop
from estlab.filters.particle_code import CompiledGenerators, ParticleCode
from estlab.filters.particle_engine import ParticleLoop
from estlab.maths.streams import Streams
from tests import pendulum
from tests.compiled import assert_same, by_both, estimated, with_readings
from tests.conftest import options, settings
from tests.oracles.test_compiled import gone_wild, with_holes

pytestmark = pytest.mark.slow

SONAR = ("scenario=sonar", "filter.particles=203", "runs=3", "steps=30")
LANDMARK = ("scenario=landmark", "filter.particles=100", "runs=3", "steps=30", "scenario.dropped=0.5")
FIELD = ("scenario=field", "filter.particles=64", "runs=3", "steps=30")


def streams(count):
    """Generators of some runs, as NumPy draws from them and as compiled code does."""
    models = pendulum.MOTION, pendulum.SENSOR
    generators = [Streams(3, "test").generators("any", range(count)) for _ in range(2)]
    return generators[0], CompiledGenerators.at_start(ParticleCode(*models, cache.lanes()), generators[1])


def test_random_numbers_are_those_of_numpy_to_the_last_bit_whatever_is_drawn_between():
    """A million of a run have each way in which a normal number comes about: layers, their edges, the tail."""
    numpy, compiled = streams(3)
    for shape in ((5,), (2, 7), (1,), (400_000,)):
        np.testing.assert_array_equal(compiled.uniforms(shape), numpy.uniforms(shape))
        np.testing.assert_allclose(compiled.normals(shape), numpy.normals(shape), rtol=1e-15, atol=0)
    some = np.array([2, 0])
    np.testing.assert_array_equal(compiled.take(some).normals((9,)), numpy.take(some).normals((9,)))
    np.testing.assert_array_equal(compiled.normals((4,)), numpy.normals((4,)))


def test_the_tail_of_normal_numbers_has_its_share():
    _, compiled = streams(1)
    z = compiled.normals((2_000_000,))
    beyond = 2_000_000 * 2.58e-4  # of 3.654 in both directions
    assert np.count_nonzero(np.abs(z) > 3.6541528853610088) == pytest.approx(beyond, abs=4.0 * beyond**0.5)


def test_another_numpy_is_known_by_its_numbers_and_taken_itself(monkeypatch, caplog):
    monkeypatch.setattr(numpy_streams, "agrees", lambda draw: False)
    wanted, record = settings("filter=pf", "filter.particles=50").filter, pendulum.record()
    models = pendulum.MOTION, pendulum.SENSOR
    with pytest.raises(
        UserError, match=r"^engine=compiled: NumPy .+ draws different normal numbers .+; set engine=numpy$"
    ):
        estimated(ParticleLoop(wanted, *models), record)
    caplog.set_level("INFO", "estlab")
    found = estimated(ParticleLoop(wanted, *models, insist=False), record)
    assert "engine=numpy, because NumPy" in caplog.text
    np.testing.assert_array_equal(found.mean, estimated(Loop(wanted, *models), record).mean)


@pytest.mark.parametrize("scenario", options("scenario"))
@pytest.mark.parametrize("name", ["pf", "rpf", "apf"])
def test_every_scenario_by_every_filter_is_what_numpy_finds(scenario, name):
    words = f"scenario={scenario}", f"filter={name}", "filter.particles=300", "filter.threshold=1"
    numpy, compiled = by_both(*words, "steps=12", "runs=2")
    assert np.isfinite(numpy.mean).all()
    same(numpy, compiled)


@pytest.mark.parametrize(
    "words",
    [
        (*SONAR, "filter=pf", "filter.resampling=multinomial"),
        (*SONAR, "filter=pf", "filter.resampling=residual"),
        (*SONAR, "filter=pf", "filter.resampling=stratified"),
        (*SONAR, "filter=pf", "filter.particles=1003", "filter.threshold=1"),
        (*SONAR, "filter=pf", "filter.particles=5"),
        (*SONAR, "filter=pf", "filter.threshold=0", "steps=10"),
        (*SONAR, "filter=pf", "filter.roughening=0.1"),
        (*SONAR, "filter=pf", "filter.injection=0.05"),
        (*SONAR, "filter=rpf", "filter.resampling=multinomial", "runs=1"),
        (*SONAR, "filter=apf", "filter.resampling=stratified", "runs=1"),
        (*SONAR, "filter=apf", "filter.resampling=multinomial", "filter.recovery=redraw"),
        (*LANDMARK, "filter=pf"),
        (*LANDMARK, "filter=apf"),
        (*LANDMARK, "filter=pf", "scenario.update=stacked"),
        (*LANDMARK, "filter=pf", "scenario.update=interleaved"),
        (*LANDMARK, "filter=apf", "scenario.update=interleaved"),
        (*FIELD, "filter=pf", "filter.recovery=redraw"),
    ],
    ids=" ".join,
)
def test_however_the_filter_is_set_it_finds_what_numpy_finds(words):
    same(*by_both(*words))


@pytest.mark.parametrize(
    "words", [(*SONAR, "filter=pf"), (*LANDMARK, "filter=apf"), (*FIELD, "filter=rpf")], ids=" ".join
)
def test_readings_missing_in_part_or_whole_are_missed_alike(words):
    same(*by_both(*words, change=with_readings(with_holes)))


@pytest.mark.parametrize("recovery", ["flatten", "redraw"])
@pytest.mark.parametrize(
    "words", [(*SONAR, "filter=pf"), (*LANDMARK, "filter=pf"), (*FIELD, "filter=apf")], ids=" ".join
)
def test_where_all_weights_vanish_both_go_on_alike(words, recovery):
    numpy, compiled = by_both(*words, f"filter.recovery={recovery}", change=with_readings(gone_wild))
    assert numpy.notes["vanished"].any()
    same(numpy, compiled)


def same(numpy, compiled):
    """All that is found, and the particle filter's own figures."""
    assert_same(numpy, compiled, within=1e-9)
    np.testing.assert_allclose(compiled.notes["ess"], numpy.notes["ess"], rtol=1e-8)
    np.testing.assert_array_equal(compiled.notes["vanished"], numpy.notes["vanished"])
    np.testing.assert_allclose(compiled.sample, numpy.sample, rtol=1e-8)
