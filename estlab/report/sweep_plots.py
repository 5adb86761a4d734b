"""The pictures of a sweep, drawn from its table: a curve with its interval for one swept number, a map for two."""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from estlab import rundir
from estlab.metrics.vocabulary import column_heading
from estlab.report.components import chosen, selection
from estlab.report.figures import escaped, png, short
from estlab.report.palette import curves

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame, Series

Save = Callable[[str, Callable[[Any], object]], object]

_PANEL = 2.6  # inches
_MULTIPLES = 12  # small multiples, or curves, that an eye can tell apart
_CELLS = 8  # small multiples, or curves, that are still distinguishable
_TICKS = 12  # rows and columns of a map up to which it shows its numbers
_LARGEST = 1e100  # values of a key up to which each has a tick
_ROUND = ("anees", "anis")  # the largest number in a picture's coordinates


def draw_all(path: Path, title: str, keys: Sequence[str], units: Mapping[str, str], save: Save) -> list[str]:
    """Draw a figure a metric from sweep.csv or groups.csv and hand each to ``save``; what could not be drawn.

    keys: the swept keys but for the filter. units: of each metric's column.
    """
    import pandas as pd

    table = pd.read_csv(path, keep_default_na=True, dtype={"filter": str})
    table = (table[table["status"].isin(rundir.WHOLE)] if "status" in table else table).copy()
    large = table.select_dtypes("number").abs() >= _LARGEST
    if large.to_numpy().any():
        table = table.mask(large.reindex(columns=table.columns, fill_value=False))
    numbers = [key for key in keys if _is_numeric(table[key]) and table[key].nunique() > 1]
    numbers = sorted(numbers, key=lambda key: -table[key].nunique())
    numbers, others = numbers[:2], [key for key in keys if key not in numbers[:2]]
    table = table.assign(_series=_labels(table, [k for k in ["filter", *others] if table[k].nunique() > 1]))
    metrics = _metrics(table, keys)
    if not metrics:
        return []
    series = list(dict.fromkeys(table["_series"]))
    if numbers and len(series) > _MULTIPLES:
        return [f"no plots: {len(series)} curves or maps would be too many; sweep fewer keys, or draw from {path.name}"]
    axes = sorted(numbers, key=list(keys).index)
    failed = []
    for metric, columns in metrics.items():
        try:
            some, note = _few(table, columns)
            headed = f"{title} · {note}" if note else title
            content = _drawn(table, some, axes, series, units, headed)
        except Warning:
            raise
        except Exception as error:
            failed.append(f"missing: {metric}.png ({type(error).__name__}: {error})")
        else:
            save(f"{metric}.png", partial(_put, content))
    return failed


def _few(table: "DataFrame", columns: Sequence[str]) -> tuple[list[str], str]:
    """The columns that are drawn, those of the position and of all together among them, and what is said of this."""
    whole = [i for i, column in enumerate(columns) if column.endswith((".position", ".all"))]
    some = chosen(table[list(columns)].abs().max().to_numpy(dtype=float), whole)
    return [columns[i] for i in some], selection(some, len(columns), "values")


def _drawn(
    table: "DataFrame",
    columns: Sequence[str],
    keys: Sequence[str],
    series: Sequence[str],
    units: Mapping[str, str],
    title: str,
) -> bytes:
    """A metric's figure, as a PNG file: over two keys, one or none."""
    if len(keys) == 2:
        figure = draw_maps(table, columns, keys, series, units)
    elif keys:
        figure = draw_curves(table, columns, keys[0], series, units)
    else:
        figure = draw_points(table, columns, series, units)
    figure.suptitle(textwrap.fill(escaped(title), int(10 * figure.get_figwidth())), fontsize=9)
    return png(figure)


def _put(content: bytes, stream: Any) -> None:
    stream.write(content)


def draw_curves(
    table: "DataFrame", columns: Sequence[str], key: str, series: Sequence[str], units: Mapping[str, str]
) -> "Figure":
    """A panel a component: the metric over the key, a curve a filter, with the band of its interval."""
    figure, panels = _column(columns, 7.0)
    styles = _styles(table, series)
    for axes, column in zip(panels, columns, strict=True):
        for name, (colour, dash) in zip(series, styles, strict=True):
            rows = table[table["_series"] == name].sort_values(key)
            axes.plot(rows[key], rows[column], f"o{dash}", ms=3.5, lw=1.2, color=colour, label=short(name) or None)
            if f"{column}.low" in rows:
                low, high = rows[f"{column}.low"], rows[f"{column}.high"]
                axes.fill_between(rows[key], low, high, color=colour, alpha=0.18, lw=0)
        _label(axes, column, units)
        _key_scale(axes, table[key])
        _value_scale(axes, table[column])
    panels[-1].set_xlabel(escaped(key))
    _legend(figure, panels[0], series)
    return figure


def draw_points(
    table: "DataFrame", columns: Sequence[str], series: Sequence[str], units: Mapping[str, str]
) -> "Figure":
    """A panel a component: the metric of each filter, or of each other choice, with its interval."""
    figure, panels = _column(columns, max(4.5, min(14.0, 1.0 + 0.9 * len(series))))
    for axes, column in zip(panels, columns, strict=True):
        for at, (name, (colour, _)) in enumerate(zip(series, _styles(table, series), strict=True)):
            rows = table[table["_series"] == name]
            places = at + np.linspace(-0.15, 0.15, len(rows)) if len(rows) > 1 else np.array([at])
            axes.plot(places, rows[column], "o", ms=4, color=colour)
            if f"{column}.low" in rows:
                axes.vlines(places, rows[f"{column}.low"], rows[f"{column}.high"], color=colour, lw=1.5)
        axes.set_xlim(-0.5, len(series) - 0.5)
        _label(axes, column, units)
        _value_scale(axes, table[column])
    panels[-1].set_xticks(
        range(len(series)), [short(name, 30) for name in series], rotation=30 if len(series) > 4 else 0
    )
    return figure


def draw_maps(
    table: "DataFrame", columns: Sequence[str], keys: Sequence[str], series: Sequence[str], units: Mapping[str, str]
) -> "Figure":
    """A row a component, a column a filter: the metric over two keys, in one scale of colours along a row."""
    from matplotlib.colors import LogNorm, Normalize
    from matplotlib.figure import Figure

    down, across = keys
    size = (1.5 + (_PANEL + 0.4) * len(series), 0.6 + _PANEL * len(columns))
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(columns), len(series), squeeze=False)
    ys, xs = (sorted(table[key].dropna().unique()) for key in keys)
    for row, column in zip(grid, columns, strict=True):
        seen = table[column].to_numpy(dtype=float)
        low, high = float(np.nanmin(seen)), float(np.nanmax(seen))
        scale = LogNorm(low, high) if low > 0.0 and high > 30.0 * low else Normalize(low, high)
        for axes, name in zip(row, series, strict=True):
            rows = table[table["_series"] == name]
            grid_of = rows.pivot_table(index=down, columns=across, values=column, aggfunc="mean", dropna=False)
            values = grid_of.reindex(index=ys, columns=xs).to_numpy(dtype=float)
            image = axes.pcolormesh(np.ma.masked_invalid(values), norm=scale, cmap="viridis")
            _write_numbers(axes, values, scale)
            axes.set_xticks(np.arange(len(xs)) + 0.5, [f"{x:g}" for x in xs], rotation=90 if len(xs) > _CELLS else 0)
            axes.set_yticks(np.arange(len(ys)) + 0.5, [f"{y:g}" for y in ys])
            if axes in grid[0] and name:
                axes.set_title(short(name, 30), fontsize=10)
            if axes in grid[-1]:
                axes.set_xlabel(escaped(across))
        row[0].set_ylabel(escaped(down))
        figure.colorbar(image, ax=list(row), label=escaped(column_heading(column, units.get(column, ""))))
    return figure


def _write_numbers(axes: "Axes", values: Any, scale: Any) -> None:
    if max(values.shape) > _CELLS:
        return
    for (i, j), value in np.ndenumerate(values):
        if np.isfinite(value):
            dark = float(scale(value)) < 0.6
            axes.text(
                j + 0.5, i + 0.5, f"{value:.3g}", ha="center", va="center", fontsize=8, color="w" if dark else "k"
            )


def _column(columns: Sequence[str], width: float) -> "tuple[Figure, list[Axes]]":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, 0.6 + 2.0 * len(columns)), layout="constrained")
    return figure, list(figure.subplots(len(columns), 1, sharex=True, squeeze=False)[:, 0])


def _label(axes: "Axes", column: str, units: Mapping[str, str]) -> None:
    axes.set_ylabel(textwrap.fill(escaped(column_heading(column, units.get(column, ""))), 20))
    axes.grid(alpha=0.3, lw=0.5)
    if column.partition(".")[0] in _ROUND:
        axes.axhline(1.0, color="0.4", lw=0.8)


def _value_scale(axes: "Axes", values: "Series[float]") -> None:
    """Logarithmic if the values are powers of a factor; the values themselves are the ticks while there is room."""
    positive = values[values > 0.0]
    if len(positive) == values.notna().sum() and len(positive) and positive.max() > 30.0 * positive.min():
        axes.set_yscale("log")


def _key_scale(axes: "Axes", values: "Series[float]") -> None:
    """Logarithmic where the values are steps of a factor; the values themselves as ticks while there is room."""
    if values.min() > 0.0 and values.max() >= 10.0 * values.min():
        axes.set_xscale("log")
    if values.nunique() <= _TICKS:
        axes.set_xticks(sorted(values.dropna().unique()), [f"{value:g}" for value in sorted(values.dropna().unique())])
        axes.minorticks_off()


def _legend(figure: "Figure", axes: "Axes", series: Sequence[str]) -> None:
    if len(series) > 1:
        room = int(12 * figure.get_figwidth() / (6 + max(map(len, series))))  # letters of an inch, and a sample line
        columns = max(1, min(len(series), room))
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=columns)


def _styles(table: "DataFrame", series: Sequence[str]) -> list[tuple[str, str]]:
    """Colour and dash of each series, by its filter."""
    filter_of = dict(zip(table["_series"], table["filter"].astype(str), strict=True))
    return curves([filter_of[name] for name in series])


def _labels(table: "DataFrame", keys: Sequence[str]) -> list[str]:
    """What tells the curves apart: the filter, and any other key that is no axis."""
    words = [[str(v) if key == "filter" else f"{key}={v}" for v in table[key]] for key in keys]
    return [" ".join(row) for row in zip(*words, strict=True)] if words else [""] * len(table)


def _metrics(table: "DataFrame", keys: Sequence[str]) -> dict[str, list[str]]:
    """The columns of each metric, its components, that are numbers and not one number everywhere."""
    found: dict[str, list[str]] = {}
    for column in table.columns:
        metric, dot, _ = column.partition(".")
        if not dot or column in keys or column.endswith((".low", ".high")) or not _is_numeric(table[column]):
            continue
        if table[column].nunique() > 1:
            found.setdefault(metric, []).append(column)
    return {metric: columns for metric, columns in found.items() if not _repeats(table, columns, metric, found)}


def _repeats(table: "DataFrame", columns: Sequence[str], metric: str, found: Mapping[str, Sequence[str]]) -> bool:
    """Whether the figure of the converged runs is that of all, because none diverged."""
    whole = metric.removesuffix("_converged")
    return (
        whole != metric
        and whole in found
        and all(table[column].equals(table[column.replace(metric, whole, 1)]) for column in columns)
    )


def _is_numeric(column: "Series[Any]") -> bool:
    return column.dtype.kind in "if" and bool(np.isfinite(column).any())
