"""What is kept of a particle filter's cloud: a sample that stands for it, and changes nothing else."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estlab import rundir
from estlab.comparison.reproducibility import _of_estimates
from estlab.experiment.histories import histories_of
from estlab.experiment.monte_carlo import estimated, loop_of, record_of, workers
from estlab.filters.loop import cloud_steps
from estlab.maths import cloud
from estlab.maths.streams import Streams
from tests.conftest import settings

SONAR = ("scenario=sonar", "filter=pf", "filter.particles=400", "runs=6", "steps=30", "plots=false")


@given(st.integers(2, 1500), st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_a_sample_has_the_weight_of_all_and_points_of_the_cloud(count, runs, seed):
    random = np.random.default_rng(seed)
    points = cloud.laid_out(random.standard_normal((2, count, runs)))
    weights = random.random((count, runs)) ** 8
    weights[:, 0] = np.eye(count)[count // 3]  # a collapsed one
    weights /= weights.sum(axis=0)
    few, heavy = cloud.sampled(points, weights, 200)
    assert few.shape == (2, min(count, 200), runs)
    assert heavy.shape == few.shape[1:]
    np.testing.assert_allclose(heavy.sum(axis=0), 1.0, rtol=1e-12)
    for run in range(runs):
        assert {*map(tuple, few[:, :, run].T)} <= {*map(tuple, points[:, :, run].T)}
    only = np.flatnonzero(heavy[:, 0] > 0.5)
    np.testing.assert_array_equal(few[:, only[0], 0], points[:, count // 3, 0])


def test_a_sample_has_the_mean_of_its_cloud_nearly():
    random = np.random.default_rng(1)
    points = cloud.laid_out(np.sort(random.standard_normal((1, 20_000, 1)), axis=1))
    weights = np.full((20_000, 1), 1.0 / 20_000)
    few, heavy = cloud.sampled(points, weights, 200)
    assert float((few[0] * heavy).sum() - points.mean()) == pytest.approx(0.0, abs=0.01)
    assert float((few[0] ** 2 * heavy).sum()) == pytest.approx(float((points**2).mean()), rel=0.03)


@pytest.mark.parametrize("steps", [1, 2, 5, 7, 300, 11_524])
def test_moments_are_six_where_there_are_steps_enough_from_first_to_last(steps):
    kept = cloud_steps(steps)
    assert (kept[0], kept[-1]) == (0, steps - 1)
    assert len(kept) == (6 if steps > 6 else len(set(kept)))
    assert sorted(set(kept)) == kept


def test_keeping_clouds_changes_no_estimate():
    chosen = settings(*SONAR)
    record = record_of(chosen, range(6))
    loop = loop_of(chosen, chosen.filter, record.landmarks)
    plain, watched = (
        loop.estimate(record, Streams(1, "sonar").generators("filter/pf", range(6)), watched=kept) for kept in (0, 4)
    )
    np.testing.assert_array_equal(plain.mean, watched.mean)
    np.testing.assert_array_equal(plain.cov, watched.cov)
    assert plain.cloud == {}
    assert watched.cloud["points"].shape == (3, 6, 200, 4)
    # The estimate is the weighted cloud's mean, which the sample has nearly.
    last = (watched.cloud["points"][:2, -1] * watched.cloud["weights"][-1]).sum(axis=1)
    spread = np.sqrt(np.einsum("iir->ir", watched.cov[:2, :2, -1, :4]))
    assert np.all(np.abs(last - watched.mean[:2, -1, :4]) < spread)


def test_clouds_are_the_same_whatever_the_block_and_of_the_kept_runs_alone():
    found = []
    for words in ("keep_runs=3", "keep_runs=3 block_runs=2 cores=1", "keep_runs=2"):
        chosen = settings(*SONAR, *words.split())
        with workers(chosen) as pool:
            first = record_of(chosen, range(max(chosen.block_runs or 6, chosen.keep_runs)))
            arrays = histories_of(estimated(chosen, first, pool, lambda total: lambda steps: None), 0)
        found.append(arrays)
    assert found[0]["cloud.points"].shape == (3, 6, 200, 3)
    assert found[0]["cloud.weights"].shape == (6, 200, 3)
    for key in ("cloud.step", "cloud.points", "cloud.weights"):
        np.testing.assert_array_equal(found[0][key], found[1][key])
    np.testing.assert_array_equal(found[0]["cloud.points"][..., :2], found[2]["cloud.points"])


def test_a_filter_without_particles_has_no_cloud():
    chosen = settings("scenario=sonar", "filter=ekf", "runs=2", "steps=5")
    with workers(chosen) as pool:
        first = record_of(chosen, range(2))
        arrays = histories_of(estimated(chosen, first, pool, lambda total: lambda steps: None), 0)
    assert not any(key.startswith("cloud") for key in arrays)


def test_a_run_of_before_there_were_clouds_is_compared_by_what_both_have(tmp_path):
    arrays = {"mean": np.ones((2, 3)), "pf.cloud.points": np.zeros((2, 6)), "time": np.arange(3.0)}
    older = {name: array for name, array in arrays.items() if "cloud" not in name}
    for name, held in (("now", arrays), ("before", older), ("other", older | {"time": np.arange(3.0) + 1.0})):
        (tmp_path / name).mkdir()
        np.savez(tmp_path / name / rundir.ESTIMATES, **held)
    assert list(_of_estimates(tmp_path / "before", tmp_path / "now")) == []
    assert {off.what for off in _of_estimates(tmp_path / "other", tmp_path / "now")} == {"time"}
