"""A filter has one colour, and curves that are shown together can be told apart."""

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.colors import to_rgb

from estlab.report.palette import BAND, ENSEMBLE, MOST, TRUTH, colours, curves
from tests.conftest import options

NAMES = st.lists(st.sampled_from(["ekf", "ukf", "pf", "ekf_smoothed", "mine", "mine_smoothed", "yours", "zz"]))


def test_every_shipped_filter_has_a_colour_of_its_own_which_is_no_bands_and_no_truths():
    found = colours(options("filter"))
    assert len({*found.values()}) == len(found)
    marks = {to_rgb(one) for one in (TRUTH, BAND, ENSEMBLE)}
    smoothed = colours([f"{name}_smoothed" for name in found])
    for one, other in combinations([*found.values(), *smoothed.values()], 2):
        assert to_rgb(one) != to_rgb(other)
        assert to_rgb(one) not in marks


@given(NAMES)
def test_a_shipped_filters_colour_is_the_same_whatever_is_beside_it(names):
    alone = {name: colours([name])[name] for name in names}
    together = colours(names)
    for name in names:
        if name.removesuffix("_smoothed") in ("ekf", "ukf", "pf"):
            assert together[name] == alone[name]
    assert len({*together.values()}) == len({*names}), "and no two filters of a run have one"


@given(NAMES)
def test_curves_have_their_filters_colour_and_are_told_apart(names):
    found = curves(names)
    assert len({*found}) == len(names)
    own = colours(names)
    for number, name in enumerate(names):
        if names[: number + 1].count(name) <= 3:
            assert found[number][0] == own[name], "three dashes of one colour before another colour"


@pytest.mark.parametrize("filters", [["ekf"] * MOST, options("filter") * 3])
def test_as_many_curves_are_told_apart_as_are_promised(filters):
    assert len({*curves(filters[:MOST])}) == min(len(filters), MOST)
