"""The tests of consistency reject as often as they say where nothing is wrong, and find what is planted."""

import numpy as np
import pytest
from scipy import stats

from benchmarks.calibration import FAULTS, Fault, comparisons, ensembles, rejections, sampled_ensembles, verdicts
from estlab.metrics.consistency import BIAS, NEES, NIS, WHITENESS, consistency_tests, single_correlations
from estlab.metrics.credibility import credibility
from estlab.metrics.intervals import (
    chi_square_test,
    holm,
    judged_at,
    mean_interval,
    positive_interval,
    positive_test,
    share_interval,
    t_test,
    time_share_interval,
    time_share_test,
)
from estlab.metrics.laws import nees_law, within
from estlab.metrics.moments import SampleMoments
from estlab.metrics.verdict import BIASED, CONSERVATIVE, MEASUREMENT, OVERCONFIDENT, PROCESS, Tolerance, judge

# Of 400 replications at 5 %, a share of 2.5 to 8 % is passed with probability 0.99.
FEWEST, MOST = 0.025, 0.08


@pytest.mark.slow
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
        ("Q doubled", NEES, CONSERVATIVE, PROCESS),
        ("R halved", NIS, OVERCONFIDENT, MEASUREMENT),
        ("R doubled", NIS, CONSERVATIVE, MEASUREMENT),
        ("bias of half a sigma", BIAS, BIASED, ""),
        ("correlated noise (0.5)", WHITENESS, OVERCONFIDENT, ""),
    ],
)
def test_a_planted_fault_is_found_and_its_key_is_named_where_it_has_one(name, test, word, key):
    assert rejections(ensembles(FAULTS[name], 30, 100, 100))[test].mean() >= 0.9
    said = verdicts(ensembles(FAULTS[name], 30, 100, 100))
    # Twice too much process noise hardly shows in the innovations: now and then nothing is said.
    assert said.get(f"{word} {key}".strip(), 0.0) >= (0.5 if name == "Q doubled" else 0.8), said
    assert not [one for one in said if "noise" in one and not one.endswith(key or "none")], said


def test_readings_whose_errors_are_correlated_are_not_said_to_be_better_than_they_are_taken_for():
    for measurement in (0.5, 0.2, 0.05):
        said = verdicts(ensembles(Fault(measurement=measurement, correlation=0.5), 20, 100, 100))
        assert not [one for one in said if "noise" in one], said


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


def test_students_test_and_interval_are_scipys():
    values = np.random.default_rng(3).standard_normal((2, 12)) + 0.4
    one = SampleMoments.of(values[:1])
    assert t_test(one, 0.1) == pytest.approx(stats.ttest_1samp(values[0], 0.1).pvalue, rel=1e-10)
    low, high = stats.t.interval(0.95, 11, values[0].mean(), stats.sem(values[0]))
    assert mean_interval(one)[1:3] == pytest.approx((low, high), rel=1e-10)
    low, high = stats.t.interval(0.99, 11, values[0].mean(), stats.sem(values[0]))
    assert mean_interval(one, 0.01)[1:3] == pytest.approx((low, high), rel=1e-10)


@pytest.mark.parametrize("level", [0.05, 0.0125, 0.002])
def test_a_test_rejects_just_where_its_interval_leaves_out_what_should_be(level):
    random = np.random.default_rng(4)
    rejected = []
    for _ in range(150):
        moments = SampleMoments.of(random.gamma(2.0, 0.5, (1, 15)) * 1.3)
        found = positive_interval(moments, level)
        assert (positive_test(moments, 1.0) < level) == (not found.low <= 1.0 <= found.high)
        shares = SampleMoments.of(random.beta(2.0, 0.6, (1, 12)))
        found = time_share_interval(shares, level)
        assert (time_share_test(shares, 0.85) < level) == (not found.low <= 0.85 <= found.high)
        rejected.append(time_share_test(shares, 0.85) < level)
    assert level < 0.01 or 0 < sum(rejected) < 150
    same = SampleMoments.of(np.full((1, 30), 0.7))
    found = time_share_interval(same, level)
    assert (time_share_test(same, 0.889) < level) == (found.high < 0.889)


def test_holm_judges_each_p_value_at_a_level_that_rejects_just_those_that_he_rejects():
    random = np.random.default_rng(5)
    for _ in range(300):
        p = random.uniform(0.0, 0.06, 5) ** random.choice([0.5, 1.0, 2.0])
        p[random.random(5) < 0.2] = np.nan
        np.testing.assert_array_equal(p < judged_at(p), holm(p) < 0.05)
    np.testing.assert_allclose(judged_at(np.array([0.2, 0.01, np.nan, 0.03])), [0.025, 0.05 / 3, np.nan, 0.025])


@pytest.mark.parametrize("runs", [3, 5, 10])
def test_intervals_of_shares_of_time_hold_for_few_runs(runs):
    random = np.random.default_rng(6)
    errors = random.standard_normal((50, 600, runs))
    for k in range(1, 50):
        errors[k] = 0.9 * errors[k - 1] + np.sqrt(0.19) * errors[k]
    for sigmas in (1, 2, 3):
        shares = (np.abs(errors) <= sigmas).mean(axis=0)
        found = [time_share_interval(SampleMoments.of(each[None])) for each in shares]
        assert np.mean([not f.low <= within(sigmas) <= f.high for f in found]) <= 0.09


def test_correlations_of_one_run_deviate_as_their_law_says():
    u = np.random.default_rng(5).standard_normal((4000, 2, 40))
    found = [single_correlations(one, 6) for one in u]
    each = np.array([values for values, _ in found])
    np.testing.assert_allclose((each**2).mean(axis=0), found[0][1] ** 2, rtol=0.1)
    # Of one component it is what Ljung and Box take for the variance.
    np.testing.assert_allclose(single_correlations(u[0, :1], 3)[1] ** 2 * 40 * 42, [39.0, 38.0, 37.0])
    lagged = (u[0, :, 2:] * u[0, :, :-2]).sum() / (u[0] ** 2).sum()
    assert found[0][0][1] == pytest.approx(lagged, rel=1e-12)


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
    same = time_share_interval(SampleMoments.of(np.full((1, 30), 0.5)))
    assert same == pytest.approx(share_interval(0.5, 30))
    spread = time_share_interval(SampleMoments.of(np.array([[0.0, 1.0] * 15])))
    # Of 29 independent trials, and fewer since their variance is estimated.
    fewer = 29 * (stats.norm.ppf(0.975) / stats.t.ppf(0.975, 29)) ** 2
    assert spread == pytest.approx((*share_interval(0.5, fewer)[:3], 30))
    steady = time_share_interval(SampleMoments.of(np.array([[0.45, 0.55] * 15])))
    assert steady.high - steady.low < 0.15 * (same.high - same.low)
    low, high = stats.binomtest(15, 30).proportion_ci(method="wilson")
    assert same[1:3] == pytest.approx((low, high), rel=1e-9)
