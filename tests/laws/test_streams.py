import numpy as np
import pytest

from estlab.maths.seeding import seeded
from estlab.maths.streams import Streams
from tests.conftest import options, settings


def test_a_run_draws_the_same_alone_as_in_any_block():
    streams = Streams(7, "car")
    together = streams.normals("truth", range(6), (3, 2))
    np.testing.assert_array_equal(streams.normals("truth", [4], (3, 2))[..., 0], together[..., 4])


def test_streams_of_other_names_seeds_and_runs_differ():
    def first(seed, owner, purpose, run):
        return Streams(seed, owner).generator(purpose, run).random()

    drawn = {
        first(*key)
        for key in [(1, "a", "b", 0), (2, "a", "b", 0), (1, "c", "b", 0), (1, "a", "d", 0), (1, "a", "b", 1)]
    }
    assert len(drawn) == 5


@pytest.mark.parametrize("seed", [0, 1, 2**31, 2**32, 2**127, 2**128, 2**200])
@pytest.mark.parametrize("key", [(), (5,), (0, 1, 2, 2**32 - 1)])
def test_streams_of_many_runs_are_those_that_numpy_seeds(seed, key):
    runs = [0, 1, 3, 12345, 2**32 - 1]
    for some in (runs, [*runs, 2**32], runs[:1]):
        for run, stream in zip(some, seeded(seed, key, some), strict=True):
            own = np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(*key, run)))
            assert stream.bit_generator.state == own.state


@pytest.mark.parametrize("scenario", options("scenario"))
def test_run_k_of_a_scenario_can_be_made_again_alone(scenario):
    experiment = settings(f"scenario={scenario}")
    make = experiment.scenario.simulate
    together, alone = (make(Streams(3, scenario), runs, experiment.noise.truth) for runs in (range(4), [2]))
    np.testing.assert_array_equal(together.truth[:, :, 2], alone.truth[:, :, 0])
    own = 2 if together.each_its_own else 0  # one prior may stand for all runs
    np.testing.assert_array_equal(together.prior.fitted().mean[:, own], alone.prior.fitted().mean[:, 0])

    def taken(record, run):
        seen = np.isfinite(record.readings.values[:1, :, run]).any(axis=0)
        return (
            record.readings.step[seen],
            record.readings.values[:, seen, run],
            record.readings.landmark_number[seen, run],
        )

    for a, b in zip(taken(together, 2), taken(alone, 0), strict=True):
        np.testing.assert_array_equal(a, b)
