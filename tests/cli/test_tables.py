"""Tables as they stand in files, against pandas: another writer and another reader."""

import io

import numpy as np
import pandas as pd

from estlab.report import csv_tables


def _written(table) -> str:
    stream = io.BytesIO()
    csv_tables.write(table, stream)
    return stream.getvalue().decode()


def test_a_table_is_written_as_pandas_writes_it():
    columns = {
        "number": np.array([0.1, -0.1, 1e300, -np.inf, np.nan, -0.0, 5e-324]),
        "opposite": -np.array([0.1, -0.1, 1e300, -np.inf, np.nan, -0.0, 5e-324]),
        "count": np.arange(7),
        "zeros": np.zeros(7),
        "none": np.zeros(7, dtype=int),
        "word": np.array(["x", "a, b", 'say "so"', "two\nlines", "", "ü", "x"]),
        "some": [1, 2.5, None, 3, np.float64(0.1), np.nan, -7],
        "all sorts": ["x", 0.1, np.nan, 3, True, None, "a, b"],
        "met": [True, False] * 3 + [True],
    }
    assert _written(columns) == pd.DataFrame(columns).to_csv(index=False)


def test_several_filters_stand_one_after_another_with_their_names_and_the_seed():
    rows = {"ekf": [{"n": 1, "p": None}, {"n": 2, "p": 0.25}], "ukf": [{"n": 3, "p": 1}]}
    assert _written(csv_tables.of_filters(rows, 7)) == "filter,n,p,seed\nekf,1,,7\nekf,2,0.25,7\nukf,3,1.0,7\n"


def test_a_filter_without_lines_leaves_those_of_the_others_and_no_lines_at_all_leave_the_heading():
    columns = {"time": np.array([1.0]), "note": np.array(["ess"])}
    nothing = {"time": np.empty(0), "note": np.empty(0)}
    both = csv_tables.of_filters({"ekf": nothing, "pf": columns}, 1)
    assert _written(both) == "filter,time,note,seed\npf,1.0,ess,1\n"
    assert _written(csv_tables.of_filters({"ekf": nothing}, 1)) == "filter,time,note,seed\n"


def test_whole_numbers_stay_whole_where_one_is_missing():
    table = {"n": [12, None, 3], "p": [1.0, None, 0.5], "none": [None, None, None]}
    assert _written(table) == "n,p,none\n12,1.0,\n,,\n3,0.5,\n"


def test_numbers_read_back_the_same_to_the_last_bit():
    numbers = np.random.default_rng(1).standard_normal(2000) * 10.0 ** np.arange(-100, 100).repeat(10)
    text = _written({"number": numbers})
    np.testing.assert_array_equal([float(line) for line in text.splitlines()[1:]], numbers)
