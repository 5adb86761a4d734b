"""An expectation is met where the value is what it says, and nowhere else."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from estlab.config.expectations import (
    WORDS,
    Bounds,
    Finding,
    _shown,
    check,
    columns,
    of_recording,
    over,
    parse,
    parse_sets,
    unmet,
)  # fmt: skip
from estlab.errors import UserError


def row(metric, component, value, low=math.nan, high=math.nan):
    return {
        "metric": metric,
        "component": component,
        "unit": "",
        "value": value,
        "ci_low": low,
        "ci_high": high,
        "n": 9,
    }


ROWS = {
    "ekf": [
        *(row("rmse", "x", 0.15, 0.1, 0.2), row("rmse", "position", 3.0), row("scored", "x", 0.5)),
        *(row("scored", "all", 1.0), row("anees", "all", 1.02), row("diverged", "all", 0)),
        *(row("found", "position", math.nan), row("verdict", "consistent", math.nan)),
    ],
    "pf": [
        *(row("rmse", "x", 0.25), row("rmse", "position", 4.0), row("anees", "all", 2.0), row("ess", "all", 640.5)),
        *(row("diverged", "all", 3), row("verdict", "overconfident", math.nan)),
    ],
}


def found(expect):
    return check(parse(expect, list(ROWS)), ROWS)


def met(expect):
    return {(finding.filter, finding.what): finding.met for finding in found(expect)}


def test_filter_and_component_come_in_either_order_and_none_means_each():
    assert (
        met({"rmse": {"x": {"pf": [0.2, 0.3]}}}) == met({"rmse": {"pf": {"x": [0.2, 0.3]}}}) == {("pf", "rmse.x"): True}
    )
    assert met({"rmse": {"x": [0.1, 0.2]}}) == {("ekf", "rmse.x"): True, ("pf", "rmse.x"): False}


def test_the_only_component_and_the_one_called_all_need_no_name():
    assert met({"anees": {"ekf": [1.0, 1.1]}, "scored": {"ekf": 1}, "ess": {"pf": {"min": 640}}}) == {
        ("ekf", "anees"): True,
        ("ekf", "scored"): True,
        ("pf", "ess"): True,
    }
    assert met({"anees": {"all": {"ekf": [1.0, 1.1]}}}) == {("ekf", "anees.all"): True}


@pytest.mark.parametrize(
    ("bounds", "holds"),
    [
        ([0.15, 0.2], True), ([0.1, 0.15], True), ([0.1500001, 0.2], False), ([0.1, 0.1499999], False),
        ({"min": 0.15}, True), ({"min": 0.16}, False), ({"max": 0.15}, True), ({"max": 0.14}, False),
        ({"min": 0.1, "max": 0.2}, True), ({"min": 0.1, "max": None}, True), (0.15, True), (0.1501, False),
    ],
)  # fmt: skip
def test_bounds_are_inclusive_on_both_sides(bounds, holds):
    assert met({"rmse": {"x": {"ekf": bounds}}}) == {("ekf", "rmse.x"): holds}


def test_a_count_is_exact_and_one_without_a_row_is_zero():
    assert met({"diverged": {"ekf": 0, "pf": 2}}) == {("ekf", "diverged"): True, ("pf", "diverged"): False}
    assert met({"vanished": 0, "gated": {"ekf": {"min": 1}}}) == {
        ("ekf", "vanished"): True,
        ("pf", "vanished"): True,
        ("ekf", "gated"): False,
    }


@pytest.mark.parametrize("nothing", [None, {}, {"rmse": None}, {"rmse": {"x": None}}, {"rmse": {"x": {"max": None}}}])
def test_null_expects_nothing(nothing):
    assert found(nothing) == []


def test_nan_meets_no_expectation():
    assert met({"found": {"ekf": {"min": 0.0}}}) == {("ekf", "found"): False}


def test_a_verdict_is_one_of_the_words_allowed():
    assert met({"verdict": {"ekf": "consistent", "pf": "consistent"}}) == {
        ("ekf", "verdict"): True,
        ("pf", "verdict"): False,
    }
    assert all(met({"verdict": ["consistent", "overconfident"]}).values())
    without = check(parse({"verdict": "lost"}, ["ekf"]), {"ekf": ROWS["ekf"][:2]})
    assert [finding.met for finding in without] == [False]


@pytest.mark.parametrize(
    ("expect", "said"),
    [
        ({"rsme": {"ekf": {"x": 1}}}, "not found (did you mean rmse?)"),
        ({"rmse": {"ekf": {"postion": 1}}}, "not found (did you mean position?)"),
        ({"rmse": {"ekf": 1}}, "not found (name one of x, position)"),
        ({"anees": {"ekf": {"x": 1}}}, "not found (there are all)"),
        ({"ess": {"ekf": 1}}, "not found (ekf has no such metric; name pf)"),
    ],
)
def test_what_is_not_there_is_not_met_and_the_nearest_is_named(expect, said):
    (finding,) = found(expect)
    assert (finding.found, finding.met) == (said, False)


@given(st.floats(0.0, 100.0), st.floats(0.0, 100.0), st.floats(0.0, 100.0))
def test_no_value_is_rounded_across_a_bound(value, one, other):
    bounds = Bounds(min(one, other), max(one, other))
    assert bounds.admit(float(_shown(value, bounds))) == bounds.admit(value)


def test_of_many_metrics_a_few_are_named_where_none_is_like_the_one_that_is_not_there():
    rows = [row(metric, "all", 1.0) for metric in ("anees", "anis", "ess", "loglik", "nees", "nis")]
    (finding,) = check(parse({"coverage": [0, 1]}, ["a"]), {"a": rows})
    assert finding.found == "not found (there are anees, anis, ess, loglik and 2 more in metrics.csv)"


def test_a_value_just_outside_is_shown_with_the_digits_that_say_so():
    (finding,) = check(parse({"rmse": [0.1, 0.2]}, ["a"]), {"a": [row("rmse", "x", 0.2004)]})
    assert (finding.found, finding.met) == ("0.2004", False)


@pytest.mark.parametrize(
    ("expect", "message"),
    [
        (5, "expect must be a group, as in expect.rmse.x=[0.1,0.2], or null for none; got 5"),
        ({"rmse": {"x": [0.2, 0.1]}}, "expect.rmse.x: write the lower bound first, got [0.2, 0.1]"),
        ({"rmse": {"x": {"min": 2, "max": 1}}}, "expect.rmse.x: write the lower bound first"),
        ({"rmse": {"x": [0.1]}}, "expect.rmse.x must be [low, high], min and max, or a number, got [0.1]"),
        ({"rmse": {"x": "small"}}, "expect.rmse.x must be [low, high], min and max, or a number, got 'small'"),
        ({"rmse": {"x": True}}, "expect.rmse.x must be [low, high]"),
        ({"rmse": {"x": [math.nan, 1]}}, "expect.rmse.x must be [low, high]"),
        ({"rmse": {"x": 10**400}}, "expect.rmse.x must be [low, high]"),
        ({"rmse": {"x": {"min": 1, "mxa": 2}}}, "expect.rmse.x takes only min and max, got mxa"),
        ({"rmse": {"x": {"mni": 1}}}, "expect.rmse.x.mni: there is no filter x or mni here; did you mean min?"),
        ({"rmse": {"x": {"efk": 1}}}, "there is no filter x or efk here; did you mean ekf? (one of ekf, pf)"),
        ({"rmse": {"x": {"ekf": {"y": 1}}}}, "expect.rmse.x.ekf.y: y is one name too many"),
        ({"verdict": {"efk": "lost"}}, "expect.verdict.efk: there is no filter efk here; did you mean ekf?"),
        ({"verdict": "consistnt"}, f"must be one of {', '.join(WORDS)}, got consistnt; did you mean consistent?"),
        ({"verdict": {"ekf": 3}}, "expect.verdict.ekf must be one of consistent, "),
        ({"verdict": []}, "expect.verdict must be one of consistent, "),
    ],
)
def test_an_expectation_that_says_nothing_is_refused(expect, message):
    with pytest.raises(UserError) as caught:
        parse(expect, list(ROWS))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_line_for_what_is_not_met_names_it_with_its_filter_where_there_are_several():
    assert unmet(found({"rmse": {"x": [0.1, 0.2]}})) == (
        "1 of 2 expectations not met: rmse.x of pf expected 0.1 to 0.2, found 0.25"
    )
    one = check(parse({"rmse": {"x": 1}, "anees": {"min": 9}, "a": 1, "b": 1}, ["ekf"]), {"ekf": ROWS["ekf"]})
    assert unmet(one).startswith(
        "4 of 4 expectations not met: rmse.x expected 1, found 0.15; anees expected at least 9, "
    )
    assert unmet(one).endswith("; and 1 more")
    assert unmet(found({"anees": {"min": 1}})) == ""


def test_the_table_for_machines_has_values_in_full():
    table = columns(found({"anees": {"ekf": 1}, "verdict": {"ekf": "lost"}, "none": {"ekf": 1}}))
    assert table["found"][:2] == [1.02, "consistent"]
    assert table["found"][2].startswith("not found")
    assert table["met"] == [False, False, False]


def test_the_interval_stands_beside_the_value():
    assert Finding("ekf", "rmse.x", "1", "0.15", False, 0.15, 0.1, 0.2).cells() == (
        "ekf", "rmse.x", "1", "0.15 [0.100, 0.200]", "FAILED",
    )  # fmt: skip


TABLE = {"transform": ["ekf", "exact"], "mean x [m]": [75.9, 75.8], "Pxx [m^2]": [1.0, math.nan]}


def cells(expect):
    return [(f.filter, f.what, f.found, f.met) for f in check(parse({"table": expect}, ["ekf"]), ROWS, TABLE)]


def test_a_cell_of_the_own_table_is_found_by_column_and_row_once_for_all_filters():
    assert cells({"mean x": {"ekf": [75.85, 75.95]}}) == [("", "table.mean x.ekf", "75.9", True)]
    assert cells({"mean x [m]": {"exact": {"max": 75.0}}}) == [("", "table.mean x [m].exact", "75.8", False)]
    assert cells({"Pxx": {"exact": {"min": 0}}}) == [("", "table.Pxx.exact", "nan", False)]


def test_a_cell_that_is_not_there_is_not_met_and_the_table_is_named():
    there = "not found (there are columns transform, mean x [m], Pxx [m^2]; rows ekf, exact)"
    assert cells({"mean z": {"ekf": 1}, "Pxx": {"ukf": 1}}) == [
        ("", "table.mean z.ekf", there, False), ("", "table.Pxx.ukf", there, False),
    ]  # fmt: skip
    (without,) = check(parse({"table": {"x": {"1": 1}}}, ["ekf"]), ROWS)
    assert (without.found, without.met) == ("not found (there is no table)", False)
    with pytest.raises(UserError, match=r"expect.table.x: a cell of the table is expect.table.<column>.<row>"):
        parse({"table": {"x": 1}}, ["ekf"])


def test_a_recording_has_the_expectations_of_its_files_and_what_is_typed_goes_over_them():
    sets = {"0123456789": {"anees": 1, "rmse": {"x": 2, "y": 3}}, "fedcba98": {"anees": 4}}
    known = of_recording(sets, ["0123456789abcdef", "7777"])
    assert known == sets["0123456789"]
    assert of_recording(sets, ["0123456"]) == of_recording(sets, []) == of_recording(None, ["0123"]) == {}
    assert over(known, {"rmse": {"x": None, "z": 5}}) == {"anees": 1, "rmse": {"x": None, "y": 3, "z": 5}}
    assert over(known, None) == known
    assert over(known, {"rmse": [1, 2]}) == {"anees": 1, "rmse": [1, 2]}


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (5, "expect_files must be a group, or null for none; got 5"),
        ({"epuck": {}}, "expect_files takes 8 to 64 digits of a file's SHA-256 as keys, from run.json; got epuck"),
        ({"0123abcd": {"rmse": {"x": {"efk": 1}}}}, "there is no filter x or efk here; did you mean ekf?"),
    ],
)
def test_expectations_of_recordings_are_checked_before_the_run(sets, message):
    with pytest.raises(UserError) as caught:
        parse_sets(sets, ["ekf"])
    assert message in str(caught.value)
