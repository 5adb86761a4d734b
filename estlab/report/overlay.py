"""Several runs over time in one picture."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from estlab import rundir
from estlab.comparison.rows import ComparisonRow
from estlab.errors import UserError
from estlab.metrics.vocabulary import heading
from estlab.report import palette
from estlab.report.components import chosen as few
from estlab.report.components import selection
from estlab.report.figures import (
    broken_at_gaps,
    cornered,
    legend_below,
    logarithmic,
    named,
    new_figure,
    short,
    within_reach,
)
from estlab.report.over_time import draw_consistent
from estlab.rundir.finished import table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

_FAR = 1e3  # times as large as the smallest curve, from which one leaves a panel


@dataclass(frozen=True)
class Curves:
    """A row's tables over time. errors: time, component, unit, rmse. nees: time, anees, lower, upper."""

    label: str
    filter: str
    errors: "DataFrame"
    nees: "DataFrame"


def curves_of(rows: Sequence[ComparisonRow]) -> tuple[list[Curves], list[str]]:
    """The curves of each row that has two steps or more, and what could not be read."""
    found, unread = [], []
    read: dict[Any, Any] = {}
    for number, row in enumerate(rows, 1):
        path = row.run.path
        try:
            if path not in read:
                errors = table(path, rundir.ERRORS, ("filter", "component", "unit"), ("time", "rmse"))
                nees = table(path, rundir.NEES, ("filter",), ("time", "anees", "lower", "upper"))
                read[path] = errors, nees
        except UserError as error:
            read[path] = None
            unread.append(str(error))
        if read[path]:
            mine = [one[one["filter"] == row.filter] for one in read[path]]
            if mine[0]["time"].nunique() > 1:
                found.append(Curves(f"{number}  {row.label}", row.filter, *mine))
    return found, unread


def draw(curves: Sequence[Curves], components: Sequence[str]) -> "Figure":
    """RMSE over the runs at each time, a panel a component (the position's in it), and NEES / n with its band.

    components: those chosen; the position, all together, or none, means all.
    """
    chosen = [name for name in components if name not in ("position", "all")]
    panels = _panels(curves, chosen if len(chosen) == len(components) else [])
    some = few(np.array([_largest(curves, *panel) for panel in panels]))
    title, panels = selection(some, len(panels), "RMSE"), [panels[i] for i in some]
    with_nees = any(np.isfinite(one.nees["anees"]).any() for one in curves)
    if not panels and not with_nees:
        raise UserError("no run has errors over time to draw: its truth is unknown, or it lacks the components")
    figure, axes = new_figure(len(panels) + with_nees, title, 1.9)
    for axis, (component, unit) in zip(axes, panels, strict=False):
        for one, style in zip(curves, _styles(curves), strict=True):
            lines = one.errors[(one.errors["component"] == component) & (one.errors["unit"] == unit)]
            _line(axis, lines, "rmse", style, one.label)
        _scale(axis)
        named(axis, heading("rmse", component), unit)
    if with_nees:
        _draw_nees(axes[-1], curves)
    axes[-1].set_xlabel("time [s]")
    legend_below(figure, axes[-1])
    return figure


def _styles(curves: Sequence[Curves]) -> list[tuple[str, str]]:
    return palette.curves([one.filter for one in curves])


def _largest(curves: Sequence[Curves], component: str, unit: str) -> float:
    """The largest of the rows' median RMSE in a component; infinite ones count for nothing."""
    found = [one.errors[(one.errors["component"] == component) & (one.errors["unit"] == unit)] for one in curves]
    values = [lines["rmse"][np.isfinite(lines["rmse"])] for lines in found]
    return max((float(one.median()) for one in values if len(one)), default=0.0)


def _panels(curves: Sequence[Curves], chosen: Sequence[str]) -> list[tuple[str, str]]:
    found = [
        (component, unit)
        for one in curves
        for component, unit in one.errors[np.isfinite(one.errors["rmse"])][["component", "unit"]]
        .drop_duplicates()
        .itertuples(index=False)
    ]
    return [panel for panel in dict.fromkeys(found) if not chosen or panel[0] in chosen]


def _draw_nees(axes: "Axes", curves: Sequence[Curves]) -> None:
    """NEES / n, and the band of a consistent filter: of the first row, where it is not the same for all."""
    for one, style in zip(curves, _styles(curves), strict=True):
        _line(axes, one.nees, "anees", style, one.label)
    bands = [one.nees[["time", "lower", "upper"]].reset_index(drop=True) for one in curves]
    alike = all(band.equals(bands[0]) for band in bands)
    columns = {name: bands[0][name].to_numpy() for name in ("time", "lower", "upper")}
    draw_consistent(axes, columns, "" if alike else f", row {curves[0].label.split()[0]}")
    _scale(axes)
    axes.set_ylabel(heading("anees"))


def _line(axes: "Axes", lines: "DataFrame", column: str, style: tuple[str, str], label: str) -> None:
    broken = broken_at_gaps({name: lines[name].to_numpy() for name in ("time", column)})
    values = np.minimum(broken[column], 1e99)  # the largest that a picture's coordinates hold
    colour, dash = style
    drawn = np.where(values > 0.0, values, np.nan)
    axes.plot(broken["time"], drawn, dash, color=colour, lw=1.1, label=short(label, 90))


def _scale(axes: "Axes") -> None:
    """A logarithmic axis of what is drawn, but for ends where a filter loses its way: one that is far off leaves it."""
    lines = {str(line.get_label()): np.asarray(line.get_ydata(), dtype=float) for line in axes.get_lines()}
    drawn = {label: values[np.isfinite(values) & (values > 0.0)] for label, values in lines.items()}
    drawn = {label: values for label, values in drawn.items() if values.size}
    reach, gone = within_reach({label: float(np.quantile(values, 0.9)) for label, values in drawn.items()}, _FAR)
    inside = [values for label, values in drawn.items() if label not in gone]
    if inside:
        every = np.concatenate(inside)
        low, high = 0.8 * float(np.quantile(every, 0.002)), 1.25 * float(np.quantile(every, 0.998))
        low, high = max(low, 1e-4 * reach), min(high, 1e4 * reach)
        axes.set_yscale("log")
        axes.set_ylim(low, high)
        logarithmic(axes.yaxis, low, high)
        numbers = ", ".join(label.strip().split(" ")[0] for label in gone)
        cornered(axes, f"beyond the panel: row {numbers}" if gone else "")
