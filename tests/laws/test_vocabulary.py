"""A metric is named, measured and written the same wherever it is shown."""

import csv
import math
import re
from pathlib import Path

import pytest

from estlab.metrics import vocabulary
from estlab.metrics.consistency import BIAS, INSIDE, NEES, NIS, WHITENESS
from estlab.metrics.digits import p_value, share, share_interval
from estlab.metrics.intervals import Estimate
from estlab.metrics.objective import Objective
from estlab.metrics.tally import CAUSES
from estlab.metrics.vocabulary import METRICS, column_heading, heading, usual, usual_columns, written_with_interval
from tests.cli.finished import made


def test_every_metric_of_a_run_is_in_the_vocabulary_with_its_unit(tmp_path):
    words = ("filter=[pf,ekf]", "filters.pf.particles=50", "filters.ekf.gate=0.9", "runs=6")
    with open(made(tmp_path / "run", *words) / "metrics.csv") as stream:
        rows = list(csv.DictReader(stream))
    assert {row["metric"] for row in rows} <= set(METRICS)
    assert {"rmse", "gated", "ess", "efficiency", "verdict"} <= {row["metric"] for row in rows}
    for row in rows:
        unit = METRICS[row["metric"]].unit
        assert row["unit"] == unit or (unit is None and row["unit"] in ("m", "rad")), row


def test_the_names_that_other_modules_use_are_the_vocabularys():
    assert set(vocabulary.TESTS) == {NEES, NIS, BIAS, WHITENESS, INSIDE}
    assert set(vocabulary.DIVERGED) == {*CAUSES, "diverged"} <= set(METRICS)
    assert [Objective.parse(words).words for words in ("nees", "nis:ukf", "loglik", "rmse:x")] == [
        "|log(NEES / n)|", "|log(NIS / m)|, ukf", "minus log-likelihood [nat]", "RMSE x",
    ]  # fmt: skip


def test_no_other_module_writes_the_heading_of_a_metric():
    """Sentences may name a statistic; a text that is nothing but its heading is the vocabulary's."""
    once = [term.heading for name, term in METRICS.items() if _is_its_own(name, term.heading)]
    once += [vocabulary.INTERVAL, vocabulary.HOLM_INTERVAL, vocabulary.HOLM_P, vocabulary.CONSISTENT_BAND, "< 0.0001"]
    pattern = re.compile("|".join(f'"{re.escape(text)}"' for text in once))
    folder = Path(vocabulary.__file__).parents[1]
    found = {path.name for path in folder.rglob("*.py") if pattern.search(path.read_text())}
    assert found == {"vocabulary.py", "digits.py"}


def _is_its_own(name: str, text: str) -> bool:
    return text.replace(" ", "_") != name and not text.isidentifier()


@pytest.mark.parametrize(
    ("name", "found", "written"),
    [
        ("rmse", Estimate(0.12345, 0.11, 0.14, 9), "0.123 [0.110, 0.140]"),
        ("inside_3sigma", Estimate(0.971, 0.944, 0.982, 9), "97.1 % [94.4, 98.2 %]"),
        ("inside_3sigma", Estimate(1.0, math.nan, math.nan, 1), "100.0 %"),
        ("diverged", Estimate(2.0, math.nan, math.nan, 100), "2 of 100"),
        ("gated", Estimate(31.0, math.nan, math.nan, 100), "31"),
        ("a_plugins_own", Estimate(0.5, math.nan, math.nan, 1), "0.500"),
        ("rmse", Estimate(math.nan, math.nan, math.nan, 0), ""),
    ],
)
def test_a_metric_is_written_in_its_form(name, found, written):
    assert written_with_interval(name, found) == written


def test_shares_and_p_values_have_one_form():
    assert (share(0.9712), share(math.nan), share_interval(0.944, 1.0)) == ("97.1 %", "", "94.4 to 100.0 %")
    assert [p_value(p) for p in (0.00009, 0.0123, 1.0, math.nan)] == ["< 0.0001", "0.012", "1", ""]


def test_headings_have_component_and_unit_and_counts_no_unit():
    assert heading("rmse", "x", "m") == column_heading("rmse.x", "m") == "RMSE x [m]"
    assert heading("anees") == column_heading("anees.all") == "NEES / n"
    assert heading("diverged", unit="runs") == "diverged"
    assert heading("some_thing", "of") == "some thing of"


def test_a_table_of_runs_has_the_positions_error_or_each_components_and_consistency():
    metrics = [("rmse", "x"), ("rmse", "y"), ("mean_sigma", "x"), ("anees", "all"), ("diverged", "all")]
    assert usual(metrics) == [("rmse", "x"), ("rmse", "y"), ("anees", "all"), ("diverged", "all")]
    assert usual(metrics, most=1)[:2] == [("rmse", "x"), ("anees", "all")]
    assert usual([*metrics, ("rmse", "position")])[0] == ("rmse", "position")
    columns = ["filter.alpha", "rmse.x", "rmse.x.low", "rmse.all", "anees.all", "verdict"]
    assert usual_columns(columns) == ["rmse.all", "anees.all", "verdict"]
