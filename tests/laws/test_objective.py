"""What a tuning makes small, from the rows of metrics.csv."""

import math

import pytest

from estlab.metrics.objective import Objective


def rows(filter="ukf", runs=100, **values):
    """Rows of metrics.csv as text; metrics of all components but for rmse."""
    return [
        {"filter": filter, "metric": metric, "component": "x" if metric == "rmse" else "all", "value": value}
        | {"n": str(runs)}
        for metric, value in values.items()
    ]


def test_half_and_twice_the_consistent_value_are_equally_bad_and_one_is_best():
    for text, metric in (("nis", "anis"), ("nees", "anees")):
        of = [Objective.parse(text).of(rows(**{metric: value}), 0.01) for value in ("0.5", "1.0", "2.0")]
        assert of == pytest.approx([math.log(2.0), 0.0, math.log(2.0)])


def test_an_error_counts_as_it_is_and_a_likelihood_the_other_way():
    assert Objective.parse("rmse:x").of(rows(rmse="0.25"), 0.01) == 0.25
    assert Objective.parse("loglik").of(rows(loglik="-1.5"), 0.01) == 1.5
    assert Objective.parse("loglik").of(rows(loglik="2.0"), 0.01) == -2.0


def test_the_filter_is_the_first_unless_one_is_named():
    both = [*rows("ekf", rmse="1.0"), *rows("ukf", rmse="2.0")]
    assert [Objective.parse(text).of(both, 0.01) for text in ("rmse:x", "rmse:x:ekf", "rmse:x:ukf")] == [1.0, 1.0, 2.0]


def test_a_filter_that_breaks_in_more_runs_than_may_be_lost_is_infinitely_bad():
    objective = Objective.parse("rmse:x")
    assert objective.of(rows(rmse="0.1", not_finite="1", not_definite="0"), 0.01) == 0.1
    assert objective.of(rows(rmse="0.1", not_finite="1", not_definite="1"), 0.01) == math.inf


@pytest.mark.parametrize(
    ("text", "found", "message"),
    [
        ("nis", rows(rmse="1.0"), "there is no anis all of ukf"),
        ("nis:pf", rows(anis="1.0"), "there is no anis all of pf"),
        ("nis", [], "there is no anis all of any filter"),
        ("nis", rows(anis=""), "anis all of ukf is not a number to compare"),
        ("nees", rows(anees="nan"), "anees all of ukf is not a number to compare"),
        ("nees", rows(anees="0.0"), "anees all of ukf is not a number to compare"),
    ],
)
def test_what_is_not_there_is_said(text, found, message):
    with pytest.raises(ValueError, match=message):
        Objective.parse(text).of(found, 0.01)


@pytest.mark.parametrize("text", ["", "niss", "rmse", "rmse:", "nis:", "nis:a:b", "rmse:x:", "rmse:x:ukf:y"])
def test_an_objective_that_there_is_not_is_refused(text):
    with pytest.raises(ValueError, match="objective must be nis, nees, loglik or rmse:<component>"):
        Objective.parse(text)
