"""What holds of comparisons between filters."""

from dataclasses import replace

import numpy as np
import pytest

from estlab.filters.gaussian import extended
from estlab.maths.space import Space
from estlab.metrics.paired import Comparison, against_best
from estlab.metrics.tally import Tally
from tests import linear
from tests.conftest import estimate

LINE = Space(("x",), ("m",))


def compared(**squares) -> list[dict]:
    comparison = Comparison(LINE)
    comparison.add({name: {"mean_square": np.array([values])} for name, values in squares.items()})
    return comparison.rows({})


def test_a_filter_wins_the_runs_in_which_its_error_is_the_smaller_and_half_of_the_ties():
    (row,) = compared(a=[1.0, 1.0, 1.0, 2.0], b=[2.0, 2.0, 1.0, 1.0])
    assert row["wins"] == pytest.approx(2.5 / 4)
    assert row["wins_low"] < 2.5 / 4 < row["wins_high"]
    turned = against_best([row], "x")[1]
    assert (turned["filter"], turned["wins"]) == ("b", pytest.approx(1.5 / 4))


def test_a_difference_is_real_just_where_its_interval_leaves_out_zero():
    random, real = np.random.default_rng(2), []
    for _ in range(60):
        squares = {name: random.gamma(2.0, 1.0 + 0.2 * i, 12) for i, name in enumerate("abcd")}
        for row in compared(**squares):
            assert row["real"] == (not row["ci_low"] <= 0.0 <= row["ci_high"])
            real.append(row["real"])
    assert 0 < sum(real) < len(real)


def test_a_run_that_broke_is_lost_to_the_filter_that_went_on():
    (row,) = compared(a=[1.0, 1.0, 1.0, np.nan], b=[np.inf, np.inf, 1.0, 1.0])
    assert row["wins"] == pytest.approx(2.5 / 3)
    assert (row["n"], row["difference"]) == (1, 0.0)


def test_a_filter_that_broke_early_in_half_of_the_runs_is_not_better_for_it():
    record = linear.record(range(40))
    found = estimate(extended("additive", None), linear.MOTION, linear.SENSOR, record)
    # The errors grow with time, so those before the break are the smaller ones.
    growth = np.linspace(0.1, 3.0, record.time.size)[:, None]
    sound = replace(found, mean=record.truth + growth * (found.mean - record.truth))
    mean, cov = sound.mean.copy(), sound.cov.copy()
    mean[:, 5:, :20], cov[:, :, 5:, :20] = np.nan, np.nan
    comparison = Comparison(linear.STATE)
    comparison.add(
        {
            name: Tally(linear.STATE, record.time).add(record, estimates, range(40))
            for name, estimates in (("broken", replace(sound, mean=mean, cov=cov)), ("sound", sound))
        }
    )
    row = comparison.rows({})[0]
    assert (row["filter"], row["wins"], row["n"]) == ("broken", 0.25, 20)
    assert row["difference"] == pytest.approx(0.0)
    assert not row["real"]


def test_the_error_shown_beside_the_best_is_that_of_the_most_runs():
    rows = compared(a=[1.0, 4.0, 9.0], b=[2.0, 5.0, 9.5], broken=[np.inf, 3.0, np.inf], none=[np.inf] * 3)
    assert [row["filter"] for row in against_best(rows, "x")][-1] == "none"
    shown = {row["filter"]: row["rmse"] for row in against_best(rows, "x")}
    assert shown["a"] == pytest.approx(np.sqrt(14.0 / 3.0))
