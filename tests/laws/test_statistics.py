"""What holds of the statistics whatever the data: blocks, gaps, missing readings, order."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estlab.config.settings import Settings
from estlab.experiment.blocks import block
from estlab.experiment.monte_carlo import Ensemble, estimated, record_of, workers
from estlab.filters.gaussian import extended
from estlab.maths.space import Space
from estlab.metrics import series
from estlab.metrics.digits import bracketed, figure, interval
from estlab.metrics.intervals import Estimate, holm
from estlab.metrics.moments import Histogram, SampleMoments
from estlab.metrics.paired import Comparison
from estlab.metrics.pairwise import Pairwise
from estlab.metrics.scores import Limits, score
from estlab.metrics.tabulated import coverage_rows
from estlab.metrics.tally import Tally
from estlab.record import Estimates, Readings
from tests import linear
from tests.conftest import estimate, metrics, settings, tallied

KALMAN = extended("additive", None)


def ensemble_of(experiment: Settings) -> Ensemble:
    """All runs of all filters."""
    with workers(experiment) as pool:
        first = record_of(experiment, block(experiment, 0))
        return estimated(experiment, first, pool, lambda total: lambda steps: None)


def figures(experiment: Settings) -> dict[str, dict]:
    """Every figure of every filter of a run."""
    return {label: metrics(tally) for label, tally in ensemble_of(experiment).total.tallies.items()}


@given(st.lists(st.integers(1, 9), min_size=1, max_size=6), st.integers(0, 10_000))
def test_moments_added_in_any_blocks_are_those_of_all_at_once(sizes, seed):
    random = np.random.default_rng(seed)
    values = 1e4 + random.standard_normal((2, 3, sum(sizes)))
    values[random.random(values.shape) < 0.2] = np.nan
    parts = [SampleMoments.of(block) for block in np.split(values, np.cumsum(sizes)[:-1], axis=-1)]
    added = parts[0]
    for part in parts[1:]:
        added = added.plus(part)
    for i in range(3):
        known = values[:, i, np.isfinite(values[:, i]).all(axis=0)]
        assert added.at(i).count == known.shape[1]
        if known.shape[1] > 1:
            np.testing.assert_allclose(added.at(i).mean, known.mean(axis=1), rtol=1e-12)
            np.testing.assert_allclose(added.at(i).cov, np.cov(known), rtol=1e-8, atol=1e-10)


def test_a_histogram_counts_every_run_once_and_nan_never():
    histogram = Histogram((2,))
    histogram.add(np.array([[0.0, 1.0, 1.05, 1e30, 1e-13], [np.nan, 10.0, 10.0, np.inf, 9e11]]))
    assert histogram.counts.sum(axis=1).tolist() == [5, 4]
    edges = histogram.edges()
    assert edges.size == histogram.counts.shape[1] + 1
    # What lies beyond the bins is in bins of its own, which say so by their edges.
    assert edges[[0, -1]].tolist() == [0.0, np.inf]
    assert edges[[1, -2]] == pytest.approx([1e-12, 1e12])
    assert histogram.counts[:, 0].tolist() == [2, 0]
    assert histogram.counts[:, -1].tolist() == [1, 1]
    at, last = np.flatnonzero(histogram.counts[1, 1:-1]) + 1
    assert edges[at] <= 10.0 < edges[at + 1]
    assert edges[last + 1] == edges[-2]


@pytest.mark.slow
@pytest.mark.parametrize("filter", ["ukf", "pf"])
@pytest.mark.parametrize("scenario", ["landmark", "field", "car", "epuck", "sonar"])
def test_figures_do_not_depend_on_the_size_of_the_blocks(scenario, filter):
    common = [f"scenario={scenario}", f"filter={filter}", "runs=11", "steps=25", "keep_runs=1"]
    common += ["filter.particles=60"] if filter == "pf" else []
    one, *others = (figures(settings(*common, f"block_runs={size}"))[filter] for size in (100, 1, 5))
    for many in others:
        assert one.keys() == many.keys()
        for key, row in one.items():
            for a, b in zip(row[3:6], many[key][3:6], strict=True):
                assert a == pytest.approx(b, rel=1e-12, abs=1e-12, nan_ok=True), key


@pytest.mark.parametrize("scenario", ["landmark", "field", "car", "sonar"])
def test_a_run_alone_is_that_run_among_all(scenario):
    kept = {}
    for which in ("run_index=null", "run_index=7"):
        experiment = settings(f"scenario={scenario}", "runs=9", "steps=20", which)
        kept[which] = ensemble_of(experiment).kept["ukf"]
    among, alone = kept.values()
    for name in ("truth", "mean", "cov"):
        np.testing.assert_allclose(alone[name][..., 0], among[name][..., 7], rtol=1e-12, atol=1e-12)


def test_the_order_of_filters_changes_no_figure_and_no_comparison():
    results = []
    for order in (("ekf", "ukf"), ("ukf", "ekf")):
        plugs = [f"+filter@filters.{name}={name}" for name in order]
        experiment = settings("scenario=field", "runs=12", "steps=20", *plugs)
        ensemble = ensemble_of(experiment)
        results.append(({n: metrics(t) for n, t in ensemble.total.tallies.items()}, ensemble.total.comparison.rows({})))
    (one, compared), (other, compared_too) = results
    for name in ("ekf", "ukf"):
        np.testing.assert_equal(one[name], other[name])
    np.testing.assert_equal(compared, compared_too)


def test_wins_count_smaller_errors_whole_and_ties_half():
    ours, theirs = np.array([1.0, 2.0, 3.0, 5.0]), np.array([2.0, 3.0, 3.0, 4.0])
    for a, b, share in ((ours, theirs, 0.625), (theirs, ours, 0.375), (ours, ours + 1.0, 1.0)):
        comparison = Comparison(Space(("x",), ("m",)))
        comparison.add({"a": {"mean_square": a[None]}, "b": {"mean_square": b[None]}})
        assert comparison.rows({})[0]["wins"] == share


def gappy(runs: int = 40):
    """A record with gaps in the truth, readings missing whole and in part, and what a Kalman filter makes of it."""
    record = linear.record(range(runs))
    random = np.random.default_rng(5)
    truth = record.truth.copy()
    truth[:, 10:14] = np.nan
    truth[2, 20:25] = np.nan
    truth[:, :, 1] = np.nan
    values = record.readings.values.copy()
    values[0][random.random(values.shape[1:]) < 0.3] = np.nan
    values[1][random.random(values.shape[1:]) < 0.3] = np.nan
    readings = Readings(record.readings.step, values, record.readings.landmark_number)
    record = replace(record, truth=truth, readings=readings)
    return record, estimate(KALMAN, linear.MOTION, linear.SENSOR, record)


def test_gaps_and_missing_readings_are_carried_through_every_statistic():
    """Against plain loops over runs, times and components."""
    record, found = gappy()
    tally = tallied(linear, record, found)
    n, steps, runs = record.truth.shape
    error = record.truth - found.mean
    nees, per_run, inside, normalised = np.full((steps, runs), np.nan), [], [], []
    for run in range(runs):
        for k in range(steps):
            e = -error[:, k, run]
            if np.isfinite(e).all():
                nees[k, run] = e @ np.linalg.solve(found.cov[:, :, k, run], e)
        known = nees[np.isfinite(nees[:, run]), run]
        if known.size:
            per_run.append(known.mean() / n)
        sigma = np.sqrt(np.einsum("iit->it", found.cov[..., run]))
        scaled = -error[..., run] / sigma
        if np.isfinite(scaled).any():
            inside.append((np.abs(scaled[2][np.isfinite(scaled[2])]) <= 1.0).mean())
            normalised.append(np.nanmean(scaled, axis=1))
    rows = metrics(tally)
    assert rows["anees", "all"].value == pytest.approx(np.mean(per_run), rel=1e-9)
    assert rows["anees", "all"].n == len(per_run) == runs - 1
    coverage = {(r["when"], r["component"], r["sigmas"]): r for r in coverage_rows(tally)}
    third = linear.STATE.names[2]
    assert coverage["all steps", third, 1]["share"] == pytest.approx(np.mean(inside))
    assert coverage["last step", third, 1]["n"] == runs - 1
    for i, name in enumerate(linear.STATE.names):
        assert rows["normalised_bias", name].value == pytest.approx(np.mean(normalised, axis=0)[i], rel=1e-9)
    table = series.nees(tally)
    with np.errstate(invalid="ignore"):
        by_time = np.array([np.nanmean(row) if np.isfinite(row).any() else np.nan for row in nees]) / n
    np.testing.assert_allclose(table["anees"], by_time, rtol=1e-9)
    assert (table["runs_scored"][10:14] == 0).all()
    assert np.isnan(table["lower"][10:14]).all()


def test_nis_counts_the_numbers_that_were_measured():
    record, found = gappy()
    tally = tallied(linear, record, found)
    measured = np.isfinite(record.readings.values).sum(axis=(0, 2))
    table = series.nis(tally)
    assert table["degrees_of_freedom"].tolist() == measured[measured > 0].tolist()
    total = np.nansum(found.whitened**2)
    assert (table["anis"] * table["degrees_of_freedom"]).sum() == pytest.approx(total, rel=1e-12)
    # Each run's own NIS is over its own count.
    each = np.nansum(found.whitened**2, axis=(0, 1)) / np.isfinite(found.whitened).sum(axis=(0, 1))
    assert metrics(tally)["anis", "all"].value == pytest.approx(each.mean(), rel=1e-12)


def test_innovations_are_correlated_over_the_readings_that_a_run_has():
    record, found = gappy(3)
    tally = tallied(linear, record, found)
    expected = []
    for run in range(3):
        kept = [u for u in found.whitened[:, :, run].T if np.isfinite(u).any()]
        kept = [np.nan_to_num(u) for u in kept]
        expected.append(sum(a @ b for a, b in zip(kept[1:], kept[:-1], strict=True)) / sum(u @ u for u in kept))
    assert metrics(tally)["innovation_correlation", "lag 1"].value == pytest.approx(np.mean(expected), rel=1e-12)


def test_a_run_that_breaks_is_counted_by_what_broke_it_first():
    record, found = gappy(5)
    mean, cov = found.mean.copy(), found.cov.copy()
    mean[:, 7:, 0] = np.nan
    cov[:, :, 5, 1], cov[:, :, 6:, 1] = -np.eye(3)[:, :], np.nan
    scores = score(linear.STATE, Limits(), record, replace(found, mean=mean, cov=cov))
    assert scores.not_finite.tolist() == [True, False, False, False, False]
    assert scores.not_definite.tolist() == [False, True, False, False, False]


def test_a_run_is_lost_if_it_stays_beyond_the_limit_to_the_end_and_not_if_it_comes_back():
    problem = settings("scenario=field").scenario
    record = record_of(settings("scenario=field"), range(4))
    off = np.zeros((3, 200, 4))
    off[0, 100:, 1] = 150.0  # leaves for good
    off[0, 100:190, 2] = 150.0  # comes back
    off[0, 195:, 3] = 150.0  # leaves too late to tell
    cov = np.broadcast_to(np.eye(3)[:, :, None, None], (3, 3, 200, 4))
    found = Estimates(record.truth + off, cov, *np.full((2, *record.readings.values.shape), np.nan), None, {})
    tally = tallied(problem, record, found, range(10, 14))
    assert tally.diverged == {"not_finite": 0, "not_definite": 0, "lost": 1}
    assert tally.diverged_first["lost"] == [11]
    rows = metrics(tally)
    assert rows["rmse", "x"].n == 4
    assert rows["rmse_converged", "x"].n == 3
    assert rows["rmse_converged", "x"].value < rows["rmse", "x"].value
    assert rows["diverged", "all"].value == 1


def test_what_is_kept_does_not_grow_with_the_runs():
    def size(tally: Tally) -> int:
        arrays = [*tally.sums.values(), *(p for m in tally.moments.values() for p in (m.count, m.mean, m.scatter))]
        arrays += [h.counts for h in tally.histograms.values()]
        return sum(np.asarray(a).nbytes for a in arrays) + sum(a.nbytes for a in tally.first)

    record = linear.record(range(600))
    found = estimate(KALMAN, linear.MOTION, linear.SENSOR, record)
    tally = tallied(linear, record, found)
    after_one = size(tally)
    both = tally.plus(tallied(linear, record, found, range(600, 1200)))
    assert size(both) == after_one
    assert both.runs == 1200


@given(st.integers(1, 40), st.randoms(use_true_random=False))
def test_blocks_added_in_any_order_and_by_anyone_are_added_alike(count, random):
    """Strings tell how they were put together."""

    class Text(str):
        def plus(self, other):
            return Text(f"({self}{other})")

    whole, parts = Pairwise(), Pairwise()
    for number in range(count):
        whole.add(0, number, Text(number))
    cuts = sorted({0, count, *(random.randrange(count) for _ in range(3))})
    pieces = list(itertools.pairwise(cuts))
    random.shuffle(pieces)
    for begin, end in pieces:
        part = Pairwise()
        for number in range(begin, end):
            part.add(0, number, Text(number))
        for (level, number), value in part.nodes.items():
            parts.add(level, number, value)
    assert parts.total() == whole.total()
    assert len(whole.nodes) == count.bit_count()


def test_holms_p_values_are_those_of_his_example():
    np.testing.assert_allclose(holm(np.array([0.01, 0.04, 0.03, np.nan, 0.005])), [0.03, 0.06, 0.06, np.nan, 0.02])


@pytest.mark.parametrize(
    ("found", "shown"),
    [
        (Estimate(0.38123, 0.34621, 0.42119, 100), "0.381 [0.346, 0.421]"),
        (Estimate(12345.6, 12000.0, 12700.0, 9), "12350 [12000, 12700]"),
        (Estimate(1.00004, 0.99991, 1.00017, 9), "1.00004 [0.99991, 1.00017]"),
        (Estimate(3.21e-7, 3.0e-7, 3.4e-7, 9), "3.21e-07 [3.00e-07, 3.40e-07]"),
        (Estimate(0.123456, np.nan, np.nan, 1), "0.123"),
        (Estimate(0.0, 0.0, 0.0, 5), "0 [0, 0]"),
        (Estimate(1.43, 0.002, 1022.0, 2), "1 [0.002, 1020]"),
        (Estimate(0.001, -4.0, 4.1, 2), "0.0 [-4.0, 4.1]"),
        (Estimate(0.0141311648841, 0.0141311648840, 0.0141311648842, 5), "0.01413116 [0.01413116, 0.01413116]"),
    ],
)
def test_digits_follow_the_interval(found, shown):
    assert bracketed(found) == shown


def test_what_is_not_known_is_not_shown():
    nothing = Estimate(np.nan, np.nan, np.nan, 0)
    assert (figure(nothing), interval(nothing)) == ("", "")
