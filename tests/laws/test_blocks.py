"""How runs are cut into blocks: each run in one, by the configuration alone."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from estlab.experiment.blocks import block, block_count
from tests.conftest import settings

UKF, PARTICLES = settings("scenario=field"), settings("scenario=field", "filter=pf", "filter.particles=1000")


def sizes(experiment):
    return [len(block(experiment, number)) for number in range(block_count(experiment))]


@given(
    st.sampled_from([UKF, PARTICLES]), st.integers(1, 3000), st.none() | st.integers(1, 700), st.integers(1, 700),
    st.none() | st.integers(0, 10_000),
)  # fmt: skip
def test_every_run_is_in_one_block_in_order_and_those_kept_in_the_first(experiment, runs, size, kept, index):
    experiment = replace(experiment, runs=runs, block_runs=size, keep_runs=kept, run_index=index)
    cut = [block(experiment, number) for number in range(block_count(experiment))]
    assert [run for part in cut for run in part] == list(experiment.run_numbers)
    assert all(cut)
    assert len(cut[0]) >= min(kept, len(experiment.run_numbers))


@pytest.mark.parametrize(
    ("runs", "expected"),
    [
        (100, [100]),
        (199, [199]),
        (200, [100, 100]),
        (600, [300, 300]),
        (1000, [500, 500]),
        (1001, [251, 251, 251, 248]),
    ],
)
def test_blocks_are_even_in_size_and_number_unless_their_size_is_given(runs, expected):
    assert sizes(replace(UKF, runs=runs)) == expected
    assert sizes(replace(UKF, runs=7, block_runs=3, keep_runs=1)) == [3, 3, 1]


def test_a_hundred_runs_of_a_thousand_particles_are_work_for_two():
    assert sizes(replace(PARTICLES, runs=100)) == [50, 50]
    many = replace(PARTICLES.filter, particles=100_000)
    assert max(sizes(replace(PARTICLES, runs=1000, filters={"pf": many}))) == 20, "what is in memory at once is bounded"
