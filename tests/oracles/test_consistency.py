"""The tests of consistency reject as often as they say where nothing is wrong, and find what is planted."""

import numpy as np
import pytest
from scipy import stats

from benchmarks.calibration import FAULTS, Fault, comparisons, ensembles, rejections, sampled_ensembles, verdicts
from estlab.metrics.consistency import BIAS, NEES, NIS, WHITENESS, consistency_tests, ljung_box
from estlab.metrics.credibility import credibility
from estlab.metrics.intervals import (
    chi_square_test,
    hotelling_test,
    mean_interval,
    positive_interval,
    positive_test,
    share_interval,
    t_test,
    time_share_interval,
)
from estlab.metrics.laws import nees_law, within
from estlab.metrics.moments import Moments
from estlab.metrics.verdict import BIASED, MEASUREMENT, OVERCONFIDENT, PROCESS, Tolerance, judge

# Of 400 replications at 5 %, a share of 2.5 to 8 % is passed with probability 0.99.
FEWEST, MOST = 0.025, 0.08


@pytest.mark.parametrize(
    ("runs", "steps", "missing"), [(20, 60, 0.0), (5, 60, 0.0), (50, 2, 0.0), (20, 60, 0.3), (1, 120, 0.0)]
)
def test_matched_filters_are_rejected_in_a_twentieth_of_the_cases(runs, steps, missing):
    found = rejections(ensembles(Fault(), 400, runs, steps, missing))
    for name, hits in found.items():
        answered = hits[~np.isnan(hits.astype(float))]
        if answered.size:
            assert FEWEST <= answered.mean() <= MOST, name
    assert (found[NIS].size, found["verdict"].size) == (400, 400)
    unanswered = {name for name, hits in found.items() if np.isnan(hits.astype(float)).any()}
    assert unanswered == ({NEES, BIAS} if runs == 1 else {WHITENESS} if steps == 2 else set())


@pytest.mark.parametrize(("size", "weighted"), [(8, False), (400, True)])
def test_the_nees_of_samples_follows_the_f_law(size, weighted):
    hits = rejections(sampled_ensembles(200, 20, size, weighted))[NEES]
    assert 0.01 <= hits.mean() <= 0.1


@pytest.mark.parametrize(
    ("name", "test", "word", "key"),
    [
        ("Q halved", NEES, OVERCONFIDENT, PROCESS),
        ("R doubled", NIS, "conservative", MEASUREMENT),
        ("bias of half a sigma", BIAS, BIASED, "scenario"),
        ("correlated noise (0.5)", WHITENESS, OVERCONFIDENT, MEASUREMENT),
    ],
)
def test_a_planted_fault_is_found_and_named_with_its_key(name, test, word, key):
    assert rejections(ensembles(FAULTS[name], 30, 100, 100))[test].mean() >= 0.9
    said = verdicts(ensembles(FAULTS[name], 30, 100, 100))
    assert said.get(f"{word} {key}", 0.0) >= 0.8, said


def test_a_difference_between_equal_filters_is_real_in_a_twentieth_of_the_cases():
    p = np.array(list(comparisons(300, 20, 0.0)))
    assert 0.02 <= (p < 0.05).mean() <= 0.09
    assert np.mean(np.array(list(comparisons(20, 100, 0.02))) < 0.05) >= 0.9


def test_a_fault_too_slight_to_matter_is_not_called_one():
    (tally,) = ensembles(Fault(process=1.03), 1, 20_000, 40)
    tests = consistency_tests(tally)
    assert any(test.rejected for test in tests)
    assert judge(tally, tests, Tolerance(0.05, 0.01)).word == "consistent"
    assert "too slight to matter" in judge(tally, tests, Tolerance(0.05, 0.01)).sentence
    assert judge(tally, tests, Tolerance(0.0, 0.01)).word == OVERCONFIDENT


def test_the_inclination_of_a_covariance_of_half_the_size_is_three_decibels():
    (tally,) = ensembles(Fault(), 1, 400, 50)
    error, nees = tally.first
    for factor, expected in ((1.0, 0.0), (0.5, 10.0 * np.log10(2.0)), (2.0, -10.0 * np.log10(2.0))):
        index, inclination = credibility(error, nees / factor)
        assert inclination.low <= expected <= inclination.high
        assert inclination.high - inclination.low < 1.0
        assert index.value >= abs(inclination.value) - 1e-12


def test_hotelling_in_one_dimension_is_students_test_and_both_are_scipys():
    values = np.random.default_rng(3).standard_normal((2, 12)) + 0.4
    one = Moments.of(values[:1])
    assert hotelling_test(one) == pytest.approx(t_test(one, 0.0), rel=1e-10)
    assert t_test(one, 0.1) == pytest.approx(stats.ttest_1samp(values[0], 0.1).pvalue, rel=1e-10)
    low, high = stats.t.interval(0.95, 11, values[0].mean(), stats.sem(values[0]))
    assert mean_interval(one)[1:3] == pytest.approx((low, high), rel=1e-10)
    # Two dimensions, from the definition.
    mean, cov = values.mean(axis=1), np.cov(values)
    square = 12 * mean @ np.linalg.inv(cov) @ mean
    assert hotelling_test(Moments.of(values)) == pytest.approx(stats.f(2, 10).sf(square * 10 / 22), rel=1e-10)


def test_a_test_rejects_just_where_its_interval_leaves_out_what_should_be():
    random = np.random.default_rng(4)
    for _ in range(200):
        moments = Moments.of(random.gamma(2.0, 0.5, (1, 15)) * 1.3)
        found = positive_interval(moments)
        assert (positive_test(moments, 1.0) < 0.05) == (not found.low <= 1.0 <= found.high)


@pytest.mark.parametrize("runs", [3, 5, 10])
def test_intervals_of_shares_of_time_hold_for_few_runs(runs):
    random = np.random.default_rng(6)
    errors = random.standard_normal((50, 600, runs))
    for k in range(1, 50):
        errors[k] = 0.9 * errors[k - 1] + np.sqrt(0.19) * errors[k]
    for sigmas in (1, 2, 3):
        shares = (np.abs(errors) <= sigmas).mean(axis=0)
        found = [time_share_interval(Moments.of(each[None])) for each in shares]
        assert np.mean([not f.low <= within(sigmas) <= f.high for f in found]) <= 0.09


def test_ljung_box_is_its_formula():
    u = np.random.default_rng(5).standard_normal((2, 80))
    statistic = 0.0
    for series in u:
        for lag in range(1, 6):
            r = np.dot(series[lag:], series[:-lag]) / np.dot(series, series)
            statistic += 80 * 82 * r**2 / (80 - lag)
    assert ljung_box(u, 5)[1] == pytest.approx(stats.chi2(10).sf(statistic), rel=1e-10)


def test_the_chi_square_test_is_two_sided():
    law = stats.chi2(7)
    assert chi_square_test(law.ppf(0.025), 7) == pytest.approx(0.05)
    assert chi_square_test(law.ppf(0.975), 7) == pytest.approx(0.05)
    assert np.isnan(chi_square_test(0.0, 0.0))


def test_the_laws_of_nees_are_those_of_scipy():
    nees = np.geomspace(0.1, 100.0, 40)[None]
    shares = stats.chi2(1).cdf([[[1.0]], [[4.0]], [[9.0]]])
    plain = nees_law(nees, 3, None)
    assert (float(plain.mean), float(plain.variance)) == (3.0, 6.0)
    np.testing.assert_array_equal(plain.inside, stats.chi2(3).cdf(nees) <= shares)
    size = 12.0
    sampled = nees_law(nees, 3, np.stack([np.full((1, 40), size), np.ones((1, 40))]))
    unit = (1 + 1 / size) * 3 * (size - 1) / (size - 3)
    law = stats.f(3, size - 3)
    np.testing.assert_allclose(sampled.mean, unit * law.mean())
    np.testing.assert_allclose(sampled.variance, unit**2 * law.var())
    np.testing.assert_array_equal(sampled.inside, law.cdf(nees / unit) <= shares)
    assert np.isnan(nees_law(nees, 3, np.full((2, 1, 40), 7.0)).mean).all(), (
        "seven states have no law in three dimensions"
    )
    assert within(3) == pytest.approx(0.9973002)


def test_a_share_of_time_that_all_runs_agree_on_is_that_of_one_trial_a_run():
    same = time_share_interval(Moments.of(np.full((1, 30), 0.5)))
    assert same == pytest.approx(share_interval(0.5, 30))
    spread = time_share_interval(Moments.of(np.array([[0.0, 1.0] * 15])))
    # Of 29 independent trials, and fewer since their variance is estimated.
    fewer = 29 * (stats.norm.ppf(0.975) / stats.t.ppf(0.975, 29)) ** 2
    assert spread == pytest.approx((*share_interval(0.5, fewer)[:3], 30))
    steady = time_share_interval(Moments.of(np.array([[0.45, 0.55] * 15])))
    assert steady.high - steady.low < 0.15 * (same.high - same.low)
    low, high = stats.binomtest(15, 30).proportion_ci(method="wilson")
    assert same[1:3] == pytest.approx((low, high), rel=1e-9)
