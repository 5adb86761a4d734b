"""The tables of a run as DataFrames, with the same columns and types for every run."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estlab import rundir
from estlab.rundir import files, finished

if TYPE_CHECKING:
    from pandas import DataFrame, Series

_INTERVAL = {"ci_low": float, "ci_high": float}

# The columns of each file in order. A column that is not listed, such as an RMSE of runs.csv, contains numbers.
COLUMNS: dict[str, dict[str, type]] = {
    rundir.METRICS: {
        **{"filter": str, "metric": str, "component": str, "unit": str},
        **{"value": float, **_INTERVAL, "n": int, "seed": int},
    },
    rundir.ERRORS: {
        **{"filter": str, "time": float, "component": str, "unit": str},
        **dict.fromkeys(("truth", "estimate", "error", "sigma", "lower3", "upper3", "mean_error"), float),
        **dict.fromkeys(("rmse", "rmse_low", "rmse_high", "bound", "mean_sigma", "inside_3sigma"), float),
        **{"runs_scored": int, "seed": int},
    },
    rundir.NEES: {
        **{"filter": str, "time": float, "anees": float, "expected": float, "lower": float, "upper": float},
        **{"runs_scored": int, "seed": int},
    },
    rundir.NIS: {
        **{"filter": str, "time": float, "anis": float, "lower": float, "upper": float},
        **{"degrees_of_freedom": int, "runs_scored": int, "seed": int},
    },
    rundir.NOTES: {"filter": str, "time": float, "note": str, "mean": float, "seed": int},
    rundir.TESTS: {
        **{"filter": str, "test": str, "of": str, "value": float, **_INTERVAL, "expected": float},
        **{"p": float, "p_holm": float, "n": int, "outcome": str, "level": float, "seed": int},
    },
    rundir.VERDICTS: {"filter": str, "word": str, "sentence": str, "key": str, "p": float, "seed": int},
    rundir.COVERAGE: {
        **{"filter": str, "when": str, "component": str, "sigmas": float, "nominal": float, "share": float},
        **{**_INTERVAL, "n": int, "seed": int},
    },
    rundir.HISTOGRAMS: {
        **{"filter": str, "metric": str, "component": str, "low": float, "high": float, "runs": int, "seed": int}
    },
    rundir.RUNS: {"filter": str, "run": int, "truth_mark": float, "readings_mark": float, "seed": int},
    rundir.COMPARISON: {
        **{"filter": str, "against": str, "component": str, "unit": str, "rmse": float, "rmse_against": float},
        **{"difference": float, **_INTERVAL, "p": float, "p_holm": float},
        **{"wins": float, "wins_low": float, "wins_high": float, "n": int, "real": bool},
        **{"cost_ratio": float, "seed": int},
    },
    rundir.EXPECTATIONS: {
        **{"filter": str, "expectation": str, "expected": str, "found": str, **_INTERVAL, "met": bool}
    },
}


def of_columns(file: str, columns: Mapping[str, Any]) -> "DataFrame":
    """The DataFrame of a table by column, as in a file of this name."""
    import pandas as pd

    return _typed(file, pd.DataFrame({name: pd.Series(list(values)) for name, values in columns.items()}))


def of_file(folder: Path, file: str) -> "DataFrame":
    """A table of a run directory; empty if the run has none.

    Raises UserError that names the file if it is not such a table.
    """
    import pandas as pd

    if not files.has(folder, file):
        return _typed(file, pd.DataFrame())
    # A seed may have more digits than a float.
    words = [name for name, kind in COLUMNS[file].items() if kind in (str, bool) or name == "seed"]
    return _typed(file, finished.table(folder, file, words, all_of_them=False))


def of_text(text: str) -> "DataFrame":
    """A table whose columns no one knows beforehand, from its CSV: of numbers where all cells are, else of text."""
    import pandas as pd

    table = pd.read_csv(io.StringIO(text), dtype=str, keep_default_na=False)
    for name in table:
        numbers = pd.to_numeric(table[name].where(table[name] != ""), errors="coerce")
        if numbers.notna().equals(table[name] != "") and numbers.notna().any():
            table[name] = numbers
    return table


def _typed(file: str, frame: "DataFrame") -> "DataFrame":
    """The columns of a file in their order and types, then those that are not listed."""
    import pandas as pd

    columns = {name: _column(frame.get(name), kind, len(frame)) for name, kind in COLUMNS[file].items()}
    others = {str(name): _column(frame[name], float, len(frame)) for name in frame if name not in columns}
    seed = {"seed": columns.pop("seed")} if "seed" in columns else {}
    return pd.DataFrame({**columns, **others, **seed})


def _column(values: "Series | None", kind: type, size: int) -> "Series":
    """Values as this type; missing ones become empty texts, NaN, 0 and false."""
    import pandas as pd

    if values is None:
        return pd.Series([kind() if kind is not float else float("nan")] * size, dtype=kind)
    if kind is int:
        return pd.Series([int(value) if value == value else 0 for value in values], dtype="int64")
    if kind is bool:
        return pd.Series([str(value) == "True" for value in values], dtype=bool)
    if kind is str:
        return pd.Series(["" if value != value else str(value) for value in values], dtype=str)
    return pd.Series(values, dtype=float)
