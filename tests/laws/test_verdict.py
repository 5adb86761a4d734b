"""What the tests and the verdict say, and that they do not contradict themselves."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from benchmarks.calibration import MOTION, SENSOR, STATE, Fault, ensembles, filtered, records
from estlab.filters.gaussian import extended
from estlab.filters.loop import Loop
from estlab.maths.streams import Streams
from estlab.metrics.consistency import BIAS, NEES, NIS, WHITENESS, consistency_tests
from estlab.metrics.laws import nis_mean
from estlab.metrics.tally import Tally
from estlab.metrics.verdict import BIASED, CONSISTENT, CORRELATED, OVERCONFIDENT, UNDECIDED, Tolerance, judge
from estlab.record import Estimates, Record

TOLERANCE = Tolerance(0.05, 0.01)


def innovations(runs: int, count: int, lag: int = 1, correlation: float = 0.0):
    """White numbers (1, count, runs), or such as correlate with those so many before."""
    noise = np.random.default_rng(7).standard_normal((1, count, runs))
    for k in range(lag, count):
        noise[:, k] = correlation * noise[:, k - lag] + np.sqrt(1.0 - correlation**2) * noise[:, k]
    return noise


def told(record: Record, estimates: Estimates, whitened=None, repeated: bool = False) -> Tally:
    tally = Tally(STATE, record.time, repeated=repeated)
    tally.add(
        record, replace(estimates, whitened=estimates.whitened if whitened is None else whitened), range(record.runs)
    )
    return tally


def answers(tally: Tally) -> dict:
    return {test.name: test for test in consistency_tests(tally)}


def verdict(tally: Tally, key: str = ""):
    return judge(tally, consistency_tests(tally), TOLERANCE, key)


@pytest.mark.parametrize(("runs", "steps"), [(40, 60), (1, 200)])
def test_innovations_that_correlate_at_a_later_lag_alone_are_not_called_white(runs, steps):
    record = records(Fault(), runs, steps, 1)
    tally = told(record, filtered(record), innovations(runs, steps, 2, 0.6))
    test = answers(tally)[WHITENESS]
    assert test.of == "lag 2"
    assert test.found.low > 0.2
    assert verdict(tally).word == CORRELATED
    assert "at lag 2" in verdict(tally).sentence


def test_the_nis_of_few_runs_weighs_innovations_and_not_runs():
    record = records(Fault(), 2, 100, 1)
    whitened = innovations(2, 100)
    whitened[:, 3:, 1] = np.nan
    test = answers(told(record, filtered(record), whitened))[NIS]
    assert test.found.value == pytest.approx(np.nanmean(whitened**2), rel=1e-12)
    twice = replace(record, readings=replace(record.readings, values=np.where(np.isnan(whitened), np.nan, 0.0)))
    repeated = answers(told(twice, filtered(record), whitened, repeated=True))[NIS]
    assert (repeated.found.n, test.found.n) == (1, 2)
    # A recording told twice is no more innovations than told once.
    assert repeated.found.high - repeated.found.low > 1.2 * (test.found.high - test.found.low)


def test_why_a_test_has_no_answer_is_told_as_it_is():
    record = records(Fault(), 30, 10, 1)
    assert answers(told(record, filtered(record)))[WHITENESS].why == "needs 5 runs of 20 readings"
    few = records(Fault(), 3, 10, 1)
    by = answers(told(few, filtered(few)))
    assert by[WHITENESS].why == "needs 5 runs, or 60 readings in one"
    assert by[NEES].why == by[BIAS].why == "needs 5 runs"
    smoothed = answers(told(record, filtered(record), np.full((1, 10, 30), np.nan)))
    assert smoothed[NIS].why == smoothed[WHITENESS].why == "there are no innovations"


def test_more_particles_are_advised_where_they_are_too_few_and_not_where_runs_are():
    record = records(Fault(), 30, 60, 1)
    found = filtered(record)

    def sampled(size: float, runs: int) -> Tally:
        part = slice(0, runs)
        readings = replace(
            record.readings, values=record.readings.values[..., part], target=record.readings.target[:, part]
        )
        sample = np.stack([np.full((60, runs), size), np.full((60, runs), 1.0 - 1.0 / size)])
        fit = found.whitened[..., part], found.log_scale[..., part]
        mine = Estimates(found.mean[..., part], found.cov[..., part], *fit, sample, {})
        return told(replace(record, truth=record.truth[..., part], readings=readings), mine)

    small = verdict(sampled(20.0, 30), "filter.particles")
    assert (small.word, small.key) == (UNDECIDED, "filter.particles")
    assert "too small at 100% of the steps" in small.sentence
    alone = verdict(sampled(800.0, 1), "filter.particles")
    assert (alone.word, alone.key) == (CONSISTENT, "")
    assert answers(sampled(800.0, 1))[NEES].of == "expected"


def test_a_bias_is_what_is_wrong_only_where_it_explains_most_of_the_nees():
    (biased,) = ensembles(Fault(bias=0.5), 1, 100, 60)
    assert verdict(biased).word == BIASED
    # A bias of as much in a position whose process noise is four times what the filter takes it for.
    (both,) = ensembles(Fault(bias=0.4, process=4.0), 1, 100, 60)
    assert answers(both)[BIAS].rejected
    assert verdict(both).word == OVERCONFIDENT


def test_a_gate_does_not_make_a_right_filter_conservative():
    record = records(Fault(), 200, 100, 1)
    found = Loop(extended("additive", 0.99), MOTION, SENSOR).estimate(record, Streams(1, "none").draws("none", ()))
    test = answers(told(record, found))[NIS]
    assert test.of == "expected"
    assert abs(test.found.value - 1.0) < 0.04
    assert "conservative" not in verdict(told(record, found)).sentence


def test_the_mean_nis_behind_a_gate_is_that_of_a_truncated_chi_square():
    for m in (1, 2, 5):
        law = stats.chi2(m)
        expected = law.expect(lambda x: x, ub=law.ppf(0.9), conditional=True)
        assert nis_mean(np.array(m), 0.9) == pytest.approx(expected, rel=1e-6)
    assert nis_mean(np.array([0, 3]), None).tolist() == [0.0, 3.0]
    assert nis_mean(np.array([0]), 0.9).tolist() == [0.0]


def test_the_component_shown_is_the_one_that_is_furthest_off():
    record = records(Fault(), 50, 60, 1)
    found = filtered(record)
    sigma = np.sqrt(found.cov[range(2), range(2)])
    off = np.array([0.4, 1.5])[:, None, None] * sigma
    # The first varies little over the runs, so that it is further off in standard errors.
    error = np.array([0.1, 1.0])[:, None, None] * (found.mean - record.truth)
    for runs in (50, 1):
        mean = (record.truth + error + off)[..., :runs]
        readings = replace(record.readings, values=record.readings.values[..., :runs])
        part = replace(record, truth=record.truth[..., :runs], readings=readings)
        fit = found.whitened[..., :runs], found.log_scale[..., :runs]
        mine = Estimates(mean, found.cov[..., :runs], *fit, None, {})
        assert answers(told(part, mine))[BIAS].of == "velocity"


def test_a_slight_fault_is_not_said_to_be_none():
    (tally,) = ensembles(Fault(bias=0.02), 1, 20_000, 20)
    said = verdict(tally)
    assert answers(tally)[BIAS].rejected
    assert said.word == CONSISTENT
    assert "too slight to matter" in said.sentence
    assert "no bias" not in said.sentence


def test_the_interval_of_the_bias_that_is_furthest_from_zero_holds_for_having_been_chosen():
    outside = []
    for tally in ensembles(Fault(), 600, 10, 10):
        found = answers(tally)[BIAS].found
        outside.append(not found.low <= 0.0 <= found.high)
    assert 0.02 <= np.mean(outside) <= 0.075
