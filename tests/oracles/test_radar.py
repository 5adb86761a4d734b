"""The radar's table through the scenario and its filters, and the convergence of the Gaussian vector generator."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2, norm

import estlab
from estlab.cli.main import main
from estlab.config.build import build
from estlab.errors import UserError
from estlab.maths.finite_differences import hessian
from estlab.maths.streams import Streams
from estlab.models import polar
from tests.conftest import composed, estimate, metrics, settings, tallied

CASES = {"i": np.radians(1.0), "ii": np.radians(15.0)}
EXACT = {
    "i": (75.8842859234, -3.9769269077, 1.0020430717, 0.0396829511, 1.7571591895),
    "ii": (73.3389961821, -3.8435339248, 14.5850415677, 18.6270351811, 369.0338443966),
}
LINEARISED = {
    "i": (75.8958446413, -3.9775326745, 1.0020802287, 0.0396931273, 1.757389988),
    "ii": (75.8958446413, -3.9775326745, 2.0815991663, 20.6381415339, 394.7991995885),
}
UNSCENTED = {
    "i": (75.8842850, -3.9769269, 1.0023475, 0.0396791, 1.7573907),
    "ii": (73.29493507, -3.84122478, 15.6110671, 19.9290912, 394.8363413),
}
UNSCENTED_WIDE = (73.3245102152, -3.8427747474, 21.8682318589, 18.6703306768, 377.140892939)


def predicted(case, *overrides, runs=1):
    """The scenario, its record and the estimates of a filter."""
    experiment = settings("scenario=radar", f"scenario.case={case}", *overrides)
    problem, noise = experiment.scenario, experiment.noise.filter
    record = problem.simulate(Streams(4, "radar"), range(runs), noise)
    motion, sensor = problem.motion(noise), problem.sensor(noise, record.landmarks)
    return problem, record, estimate(experiment.filter, motion, sensor, record)


def five(mean, cov):
    """Mean x, mean y, Pxx, Pxy, Pyy."""
    return np.array([mean[0], mean[1], cov[0, 0], cov[0, 1], cov[1, 1]])


def moments(*arguments):
    _, _, found = predicted(*arguments)
    return five(found.mean[:, 0, 0], found.cov[:, :, 0, 0])


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("name", ["ekf", "iekf", "dead_reckoning"])
def test_linearised_moments_are_those_of_the_table(case, name):
    np.testing.assert_allclose(moments(case, f"filter={name}"), LINEARISED[case], atol=1e-9)


@pytest.mark.parametrize("case", CASES)
def test_unscented_moments_are_those_of_the_table(case):
    np.testing.assert_allclose(moments(case, "filter=ukf", "filter.alpha=1e-3"), UNSCENTED[case], atol=1e-6)


@pytest.mark.parametrize("name", ["ukf", "srukf"])
def test_wide_unscented_moments_are_those_of_the_table(name):
    np.testing.assert_allclose(moments("ii", f"filter={name}"), UNSCENTED_WIDE, atol=1e-9)


@pytest.mark.parametrize("case", CASES)
def test_exact_moments_are_those_of_the_table_and_of_a_quadrature_that_has_converged(case):
    exact = five(*settings("scenario=radar", f"scenario.case={case}").scenario.exact)
    np.testing.assert_allclose(exact, EXACT[case], atol=1e-9)
    np.testing.assert_allclose(moments(case, "filter=ghkf", "filter.order=20"), exact, atol=1e-8)


@pytest.mark.parametrize("case", CASES)
def test_a_million_particles_come_within_five_standard_errors_of_the_exact_moments(case):
    assert composed("scenario=radar", "filter=pf")["filter"]["particles"] == 1_000_000
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    weights = np.outer(weights, weights) / weights.sum() ** 2
    distance, bearing = 76.0 + nodes[:, None], np.radians(-3.0) + CASES[case] * nodes
    x, y = distance * np.cos(bearing) - EXACT[case][0], distance * np.sin(bearing) - EXACT[case][1]
    # The variance of each of the five in one sample: E[q^2] - E[q]^2 for q = x, y, x^2, x y, y^2 about the mean.
    quantities = np.stack([x, y, x * x, x * y, y * y])
    spread = np.einsum("qij,ij->q", quantities**2, weights) - np.einsum("qij,ij->q", quantities, weights) ** 2
    off = moments(case, "filter=pf") - EXACT[case]
    assert (np.abs(off) <= 5.0 * np.sqrt(spread / 1e6)).all(), off / np.sqrt(spread / 1e6)


@pytest.mark.parametrize("case", CASES)
def test_second_order_moments_are_those_of_the_quadratic_that_touches_the_function(case):
    """The Taylor polynomial written out, and its moments by a quadrature exact for its squares."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(6)
    weights = np.outer(weights, weights) / weights.sum() ** 2
    dr, dth = np.meshgrid(nodes, CASES[case] * nodes, indexing="ij")
    cos, sin = np.cos(np.radians(-3.0)), np.sin(np.radians(-3.0))
    x = 76.0 * cos + cos * dr - 76.0 * sin * dth - sin * dr * dth - 0.5 * 76.0 * cos * dth**2
    y = 76.0 * sin + sin * dr + 76.0 * cos * dth + cos * dr * dth - 0.5 * 76.0 * sin * dth**2
    mean = np.array([(weights * x).sum(), (weights * y).sum()])
    cov = np.cov(np.stack([x.ravel(), y.ravel()]), aweights=weights.ravel(), ddof=0)
    np.testing.assert_allclose(moments(case, "filter=second_order"), five(mean, cov), atol=1e-9)
    modified = moments(case, "filter=second_order", "filter.form=modified")
    np.testing.assert_allclose(modified, [*mean, *LINEARISED[case][2:]], atol=1e-9)


def test_stated_hessians_are_the_finite_differences():
    motion = settings("scenario=radar").scenario.motion(settings().noise.filter)
    function = motion.function(np.empty((0, 1)), 1.0)
    seen = np.array([[76.0, 10.0, 3.0], [-0.05, 2.0, -3.0]])
    stated = function.hessians(seen)
    np.testing.assert_allclose(stated, hessian(function.evaluate, seen, polar.PLACE), atol=1e-4)


@pytest.mark.parametrize(("case", "name"), [("i", "ekf"), ("ii", "ekf"), ("ii", "ukf"), ("ii", "pf")])
def test_the_share_inside_three_sigma_is_the_probability_that_the_belief_leaves(case, name):
    runs = 20_000
    problem, record, found = predicted(case, f"filter={name}", runs=runs)
    rows = metrics(tallied(problem, record, found))
    shares = {component: row.value for (metric, component), row in rows.items() if metric == "inside_3sigma"}
    # Given the bearing, x is Gaussian in the range; the bearing by a fine sum over its density.
    z = np.linspace(-8.0, 8.0, 40_000)  # of an even number, so that none of them lies at bearing 0
    density = norm.pdf(z) / norm.pdf(z).sum()
    bearing = np.radians(-3.0) + CASES[case] * z
    for i, (component, slope) in enumerate((("x", np.cos(bearing)), ("y", np.sin(bearing)))):
        mean, sigma = found.mean[i, 0, 0], np.sqrt(found.cov[i, i, 0, 0])
        edges = [(mean + side * sigma - 76.0 * slope) / np.abs(slope) for side in (-3.0, 3.0)]
        expected = (density * (norm.cdf(edges[1]) - norm.cdf(edges[0]))).sum()
        error = np.sqrt(expected * (1.0 - expected) / runs)
        assert abs(shares[component] - expected) < 4.5 * error, (component, shares[component], expected)


def test_the_nees_of_the_samples_is_one_under_the_exact_moments():
    runs = 20_000
    problem, record, _ = predicted("ii", "filter=ekf", runs=runs)
    off = record.truth[:, 0] - problem.exact.mean[:, None]
    nees = np.einsum("ir,ij,jr->r", off, np.linalg.inv(problem.exact.cov), off)
    assert abs(nees.mean() / 2.0 - 1.0) < 4.5 * nees.std() / 2.0 / np.sqrt(runs)


def test_the_table_is_of_all_runs_whatever_the_block(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    common = ["run", "scenario=radar", "scenario.case=ii", "filter=[ekf,ukf]", "runs=70", "keep_runs=5"]
    tables = []
    for block in ("100", "30"):
        assert main([*common, f"block_runs={block}", f"hydra.run.dir=of_{block}"]) == 0
        tables.append(pd.read_csv(f"of_{block}/radar.csv").set_index("transform"))
    one, other = tables
    pd.testing.assert_frame_equal(one, other, rtol=1e-12)
    assert list(one.index) == ["ekf", "ukf", "exact", "samples"]
    np.testing.assert_allclose(one.loc["exact"], EXACT["ii"], atol=1e-9)
    problem = settings("scenario=radar", "scenario.case=ii")
    truth = problem.scenario.simulate(Streams(1, "radar"), range(70), problem.noise.truth).truth[:, 0]
    np.testing.assert_allclose(one.loc["samples"], five(truth.mean(axis=1), np.cov(truth)), rtol=1e-12)
    with np.load("of_30/estimates.npz") as arrays:
        assert arrays["shown.count"] == 70
        assert arrays["ekf.mean"].shape == (2, 1, 5)
    assert {path.name for path in (tmp_path / "of_30/plots").iterdir()} == {"transform.png"}
    assert "samples" in capsys.readouterr().out


def test_a_single_sample_has_no_covariance():
    table = estlab.run("scenario=radar", "filter=ekf", runs=1, save=False).own.set_index("transform")
    assert table.loc["samples"].isna().tolist() == [False, False, True, True, True]


@pytest.mark.parametrize("scenario", ["radar", "generator"])
def test_a_problem_without_noise_refuses_to_scale_it(scenario):
    experiment = settings(f"scenario={scenario}", "noise.truth.process_scale=2")
    with pytest.raises(UserError, match="neither process nor measurement noise"):
        experiment.scenario.simulate(Streams(1, scenario), range(1), experiment.noise.truth)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("scenario.cov=[[1,0],[0,1]]", "scenario.cov must have 3 rows of 3 numbers"),
        ("scenario.cov=[[1,0,0],[0,1,2],[0,2,1]]", "scenario.cov must be symmetric and positive definite"),
        ("scenario.samples=3", "scenario.samples must be >= 10"),
    ],
)
def test_a_generator_that_cannot_be_is_refused(override, message):
    with pytest.raises(UserError) as caught:
        build(composed("scenario=generator", override))
    assert message in str(caught.value)


def test_errors_of_generated_mean_and_covariance_are_chi_square_about_what_is_expected():
    """With one component, n m^2 / P and (n - 1) S / P are chi-square, so their sums over runs are bounded."""
    runs = 200
    experiment = settings("scenario=generator", "scenario.mean=[3.0]", "scenario.cov=[[4.0]]")
    problem = experiment.scenario
    sums = problem.simulate(Streams(5, "generator"), range(runs), experiment.noise.truth).sums
    low, high = chi2.ppf([1e-5, 1.0 - 1e-5], runs)
    scaled = sums["mean_error2"] * problem.sizes / 4.0
    assert ((low < scaled) & (scaled < high)).all()
    ratio = np.sqrt(sums["cov_error2"] / runs) / problem.expected()[1]
    assert (np.abs(ratio - 1.0) < 0.4).all()


def test_the_generators_mean_and_covariance_converge_like_the_root_of_the_number():
    experiment = settings("scenario=generator", "scenario.samples=100000")
    problem, runs = experiment.scenario, 40
    sums = problem.simulate(Streams(6, "generator"), range(runs), experiment.noise.truth).sums
    for name, expected in zip(("mean_error2", "cov_error2"), problem.expected(), strict=True):
        found = np.sqrt(sums[name] / runs)
        slope = np.polyfit(np.log(problem.sizes), np.log(found), 1)[0]
        assert -0.55 < slope < -0.45
        assert (np.abs(found / expected - 1.0) < 0.45).all()


def test_generated_vectors_do_not_depend_on_how_many_are_drawn_at_once(monkeypatch):
    from estlab.scenarios import generator

    experiment = settings("scenario=generator", "scenario.samples=700")
    records = []
    for at_once in (1_000_000, 90):
        monkeypatch.setattr(generator, "_AT_ONCE", at_once)
        records.append(experiment.scenario.simulate(Streams(7, "generator"), range(3), experiment.noise.truth))
    for name, array in records[0].sums.items():
        np.testing.assert_allclose(records[1].sums[name], array, rtol=1e-9)


@pytest.mark.parametrize("name", ["ekf", "ukf", "ckf", "second_order"])
def test_the_generators_belief_is_the_mean_and_the_covariance_asked_for(name):
    experiment = settings("scenario=generator", f"filter={name}")
    problem, noise = experiment.scenario, experiment.noise.filter
    record = problem.simulate(Streams(8, "generator"), range(2), noise)
    found = estimate(experiment.filter, problem.motion(noise), problem.sensor(noise, record.landmarks), record)
    np.testing.assert_allclose(found.mean[:, 0, 1], problem.mean, atol=1e-12)
    np.testing.assert_allclose(found.cov[:, :, 0, 1], problem.cov, atol=1e-12)
