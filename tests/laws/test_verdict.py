"""What the tests and the verdict say, and that they do not contradict themselves."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from benchmarks.calibration import MOTION, SENSOR, STATE, Fault, ensembles, filtered, records
from estlab.filters.gaussian import extended
from estlab.filters.loop import Loop
from estlab.maths.streams import Streams
from estlab.metrics import tabulated as tables
from estlab.metrics.consistency import BIAS, INSIDE, LEAST_INSIDE, NEES, NIS, WHITENESS, consistency_tests
from estlab.metrics.laws import nis_mean
from estlab.metrics.tally import Tally
from estlab.metrics.verdict import (
    BIASED,
    CONSISTENT,
    CORRELATED,
    LOST,
    OVERCONFIDENT,
    STARVED,
    UNDECIDED,
    Tolerance,
    judge,
)
from estlab.record import Estimates, Record
from estlab.report import terminal
from estlab.report.findings import Findings

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


@pytest.mark.parametrize("seed", range(60))
def test_no_sentence_contradicts_an_interval_beside_it(seed, monkeypatch):
    random = np.random.default_rng(seed)
    tally = any_tally(random)
    tests, tolerance = consistency_tests(tally), Tolerance(float(random.choice([0.0, 0.05])), 0.01)
    said = judge(tally, tests, tolerance, "filter.particles" if tally.sampled else "")
    rows = {(row.metric, row.component): row for row in tables.metric_rows(tally, tests, said)}
    rejected = {test.name for test in tests if test.rejected}
    for row in tables.test_rows(tests):
        off = row["expected"] < row["ci_low"] or row["expected"] > row["ci_high"]
        assert (row["outcome"] == "rejected") == off == (row["p"] < row["level"]) == (row["p_holm"] < 0.05)
        assert np.isnan(row["p"]) == np.isnan(row["ci_low"]) == row["outcome"].startswith("not available: ")
    # The table of figures has the same numbers, and of each component an interval that says no more than the test.
    by = {test.name: test for test in tests}
    assert rows["anees", "all"].value == pytest.approx(by[NEES].found.value, nan_ok=True)
    assert ("anis", "all") not in rows or rows["anis", "all"].value == pytest.approx(by[NIS].found.value)
    judged = {"anees": (NEES, 1.0), "anis": (NIS, 1.0), "normalised_bias": (BIAS, 0.0)}
    judged["innovation_correlation"] = (WHITENESS, 0.0)
    if not tally.repeated:
        for metric, (name, expected) in judged.items():
            mine = [row for row in rows.values() if row.metric == metric and np.isfinite(by[name].p)]
            off = [row for row in mine if row.ci_low > expected or row.ci_high < expected]
            assert bool(off) == (name in rejected and np.isfinite([row.ci_low for row in mine]).any()), metric
    # What the terminal prints, rounded as it is, lies on the same side of what should be.
    monkeypatch.setenv("COLUMNS", "200")
    table = terminal._tests(Findings(list(rows.values()), tests, said))
    cells = list(zip(*table.lines, strict=True))
    for test, interval, mark in zip(tests, cells[2], cells[4], strict=True):
        ends = [float(end) for end in interval.split(" to ")] if interval else []
        assert bool(ends) == np.isfinite(test.p)
        assert not ends or (test.expected < ends[0] or test.expected > ends[1]) == test.rejected == mark.endswith("✗")
    # And so does the sentence.
    assert re.match(r"[a-z ,]+: \S", said.sentence)
    told = re.findall(
        r"(?:(NEES|NIS) / \w+ =|(off by|correlated|within 3 sigma for)) (\S+) \[(\S+), (\S+)\]", said.sentence
    )
    for metric, how, _, low, high in told:
        expected = 1.0 if metric else LEAST_INSIDE if how == "within 3 sigma for" else 0.0
        off = not float(low) <= expected <= float(high)
        if not (metric == "NEES" and np.isnan(by[NEES].p)):
            assert off == (
                {"NEES": NEES, "NIS": NIS, "off by": BIAS, "correlated": WHITENESS}.get(metric or how, INSIDE)
                in rejected
            )
        assert said.word in (CONSISTENT, UNDECIDED) or off or metric == "NEES"
    if "no bias" in said.sentence or "white innovations" in said.sentence:
        assert said.word in (CONSISTENT, UNDECIDED)
        assert "no bias" not in said.sentence or BIAS not in rejected
        assert "white" not in said.sentence or WHITENESS not in rejected
    slight = said.word == CONSISTENT and bool(rejected)
    assert ("too slight to matter" in said.sentence) == slight
    assert said.word != UNDECIDED or (np.isnan(by[NEES].p) and not rejected - {BIAS, WHITENESS, NIS})
    if said.word == UNDECIDED and np.isfinite([test.p for test in tests]).any():
        assert "effective particles on average, and a test of NEES needs 100: raise filter.particles" in said.sentence


def any_tally(random: np.random.Generator) -> Tally:
    """Of runs few or many, faulty or not, of a sample or none, behind a gate or not, of one recording or several."""
    fault = Fault(*random.choice([1.0, 1.0, 0.8, 0.3, 3.0], 2), *random.choice([0.0, 0.0, 0.15, 0.6], 2))
    runs, steps = int(random.choice([1, 2, 3, 5, 6, 9, 20, 60])), int(random.choice([1, 12, 30, 80]))
    record = records(
        fault, runs, steps, int(random.integers(10_000)), float(random.choice([0.0, 0.3, 1.0], p=[0.5, 0.4, 0.1]))
    )
    gate = random.choice([None, 0.95])
    found = Loop(extended("additive", gate), MOTION, SENSOR).estimate(record, Streams(1, "none").generators("none", ()))
    if random.random() < 0.3:
        size = random.choice([4.0, 12.0, 80.0, 300.0]) * random.uniform(0.9, 2.0, (steps, runs))
        found = replace(found, sample=np.stack([size, 1.0 - 1.0 / size]), cov=found.cov * random.choice([1.0, 0.02]))
    if random.random() < 0.1:
        found = replace(found, whitened=np.full_like(found.whitened, np.nan))
    return told(record, found, repeated=bool(random.random() < 0.1))


def test_a_nees_as_large_as_what_is_said_to_be_seen_is_seen():
    seen = 0
    for seed in range(40):
        record = records(Fault(), 6, 30, seed)
        found = filtered(record)
        said = verdict(told(record, found)).sentence
        if match := re.search(r"; (\d+) runs would show a NEES / n beyond (\S+) or below (\S+)$", said):
            seen += 1
            assert match[1] == "6"
            mean = answers(told(record, found))[NEES].found.value
            for wanted, rejected in ((float(match[2]), True), (float(match[3]), True), (float(match[2]) * 0.9, False)):
                scaled = told(record, replace(found, cov=found.cov * mean / wanted))
                assert answers(scaled)[NEES].rejected == rejected
    assert seen > 10


def test_few_runs_say_what_more_would_show_and_nothing_ends_in_a_colon():
    for runs, repeated in ((1, False), (3, False), (1, True), (20, True)):
        record = records(Fault(), runs, 40, 1)
        nothing = np.full((1, 40, runs), np.nan)
        said = verdict(told(record, filtered(record), nothing, repeated))
        assert said.word == UNDECIDED
        assert "there are no innovations; 5 " in said.sentence
        assert float(re.search("beyond (\\S+)", said.sentence)[1]) > 2.0
    unknown = replace(record, truth=np.full_like(record.truth, np.nan))
    said = verdict(told(unknown, filtered(record), nothing))
    assert said.sentence == "undecided: the truth is unknown and there are no innovations"


def test_a_cloud_that_lost_its_states_is_starved_and_a_small_one_whose_errors_leave_it_overconfident():
    record = records(Fault(), 30, 60, 1)
    found = filtered(record)

    def of(sizes, factor: float) -> Tally:
        size = np.broadcast_to(np.asarray(sizes)[:, None], (60, 30)).copy()
        sample = np.stack([size, 1.0 - 1.0 / size])
        return told(record, replace(found, sample=sample, cov=found.cov * factor))

    collapsed = np.where(np.arange(60) == 3, 9.0, 700.0)
    starved = verdict(of(collapsed, 0.1), "filter.particles")
    assert (starved.word, starved.key) == (STARVED, "filter.particles")
    assert "fell to 9 effective particles" in starved.sentence
    # As large throughout, it is the filter that is wrong; and one that has come through is not starved.
    assert verdict(of(np.full(60, 700.0), 0.1), "filter.particles")[0:3:2] == (OVERCONFIDENT, "")
    assert verdict(of(collapsed, 1.0), "filter.particles").word == CONSISTENT
    small = verdict(of(np.full(60, 9.0), 0.1), "filter.particles")
    assert (small.word, small.key) == (OVERCONFIDENT, "filter.particles")
    assert small.sentence.startswith("overconfident: ")
    assert "within 3 sigma" in small.sentence
    # As small and as right as it can be: too small to be judged, and nothing more. Of fewer it says nothing at all.
    right = verdict(of(np.full(60, 9.0), 1.0), "filter.particles")
    assert (right.word, right.key) == (UNDECIDED, "filter.particles")
    assert right.sentence.endswith(
        "; the cloud fell to 9 effective particles on average, and a test of NEES needs 100: "
        "raise filter.particles by a factor of 12"
    )
    assert verdict(of(np.full(60, 5.0), 1.0), "filter.particles").word == STARVED
    assert verdict(of(np.full(60, 20.0), 0.5), "filter.particles").word == STARVED


def test_a_cloud_that_is_small_because_readings_are_worse_than_the_filter_has_them_is_not_to_blame():
    record = records(Fault(), 30, 60, 1)
    found = filtered(record)
    size = np.where(np.arange(60) == 3, 9.0, 700.0)[:, None].repeat(30, axis=1)
    sampled = replace(found, sample=np.stack([size, 1.0 - 1.0 / size]), cov=found.cov * 0.1)
    white = verdict(told(record, sampled, 2.0 * innovations(30, 60)), "filter.particles")
    assert (white.word, white.key) == (OVERCONFIDENT, "")
    few = replace(sampled, sample=np.stack([np.full((60, 30), 5.0), np.full((60, 30), 0.8)]))
    fewer = verdict(told(record, few, 2.0 * innovations(30, 60)), "filter.particles")
    assert fewer.key == ""
    assert "raise" not in fewer.sentence
    stuck = verdict(told(record, sampled, 2.0 * innovations(30, 60, 1, 0.6)), "filter.particles")
    assert (stuck.word, stuck.key) == (STARVED, "filter.particles")


@pytest.mark.parametrize("runs", [1, 30])
def test_nothing_is_advised_where_nothing_is_known(runs):
    record = records(Fault(process=30.0, measurement=30.0), runs, 80, 1)
    found = filtered(record)
    lost = told(record, found)
    lost.diverged["lost"] = runs
    assert verdict(lost).word == LOST
    assert verdict(lost).sentence.endswith(
        f" run{'s' * (runs > 1)} diverged (" + f"{runs} still too far off at the end)"
    )
    without = told(record, found, np.full((1, 80, runs), np.nan))
    # One recording with innovations too small and correlated, as on real ones: its errors are unknown.
    coloured = told(record, replace(found, cov=found.cov * 100.0), 0.3 * innovations(runs, 80, 1, 0.5))
    for tally in (lost, without, coloured):
        assert verdict(tally).key == ""
        assert "noise." not in verdict(tally).sentence


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
            record.readings,
            values=record.readings.values[..., part],
            landmark_number=record.readings.landmark_number[:, part],
        )
        sample = np.stack([np.full((60, runs), size), np.full((60, runs), 1.0 - 1.0 / size)])
        fit = found.whitened[..., part], found.log_scale[..., part]
        mine = Estimates(found.mean[..., part], found.cov[..., part], *fit, sample, {})
        return told(replace(record, truth=record.truth[..., part], readings=readings), mine)

    small = verdict(sampled(20.0, 30), "filter.particles")
    assert (small.word, small.key) == (UNDECIDED, "filter.particles")
    assert re.match(r"undecided: NEES / n = \S+ \[\S+, \S+\] \(not judged\), NIS / m", small.sentence)
    assert small.sentence.endswith(
        "; the cloud fell to 20 effective particles on average, and a test of NEES needs 100: "
        "raise filter.particles by a factor of 5"
    )
    one = verdict(sampled(20.0, 1), "filter.particles")
    assert one.sentence.startswith("consistent as far as its innovations tell: ")
    assert one.sentence.endswith(": raise filter.particles by a factor of 5")
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


def test_a_bias_is_not_what_is_wrong_where_innovations_are_and_nees_cannot_be_judged():
    record = records(Fault(bias=0.3), 30, 60, 1)
    found = filtered(record)
    sample = np.stack([np.full((60, 30), 20.0), np.full((60, 30), 0.95)])
    tally = told(record, replace(found, sample=sample), 0.3 * innovations(30, 60))
    assert answers(tally)[BIAS].rejected
    assert verdict(tally, "filter.particles").sentence.startswith(
        "conservative as far as its innovations tell: NIS / m"
    )


def test_a_gate_does_not_make_a_right_filter_conservative():
    record = records(Fault(), 200, 100, 1)
    found = Loop(extended("additive", 0.99), MOTION, SENSOR).estimate(record, Streams(1, "none").generators("none", ()))
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
