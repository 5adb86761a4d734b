"""What pictures leave out of lines with more points than pixels."""

import numpy as np
import pytest

from estlab.report.figures import broken_at_gaps, telling


@pytest.mark.parametrize("size", [10_000, 62_749])
def test_points_left_out_of_a_line_are_between_others_of_the_same_pixel(size):
    values = np.random.default_rng(size).standard_normal(size).cumsum()
    shown = telling(values)
    assert shown.size < 4600
    assert np.all(np.diff(shown) > 0)
    for part in np.array_split(np.arange(size), 700):
        chosen = values[shown[np.searchsorted(shown, part[0] - 45) : np.searchsorted(shown, part[-1] + 45)]]
        assert chosen.max() >= values[part].max()
        assert chosen.min() <= values[part].min()


def test_a_short_line_is_whole_and_a_gap_in_a_long_one_stays():
    assert telling(np.arange(4000.0)).size == 4000
    values = np.ones(60_000)
    values[20_000:20_300] = np.nan
    shown = telling(values)
    inside = (shown >= 20_000) & (shown < 20_300)
    assert inside.any()
    np.testing.assert_array_equal(np.isnan(values[shown]), inside)


def test_a_value_that_is_there_once_is_seen():
    values = np.zeros(50_000)
    values[33_333] = 7.0
    assert 33_333 in telling(values)


def test_a_line_is_broken_where_time_jumps():
    time = np.concatenate([np.arange(5.0), 100.0 + np.arange(5.0)])
    broken = broken_at_gaps({"time": time, "count": np.arange(10)})
    np.testing.assert_array_equal(broken["time"], [0, 1, 2, 3, 4, 52, 100, 101, 102, 103, 104])
    np.testing.assert_array_equal(broken["count"], [0, 1, 2, 3, 4, np.nan, 5, 6, 7, 8, 9])
