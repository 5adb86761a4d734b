"""The pictures of a run."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from estlab import rundir
from estlab.maths.gaussian import ellipses
from estlab.maths.space import Array, Space
from estlab.report.figures import (
    WIDTH,
    broken_at_gaps,
    headed,
    legend_below,
    logarithmic,
    new_figure,
    telling,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_TRUTH, _ESTIMATE, _BAND, _ENSEMBLE = "black", "C0", "C3", "C2"
_COLOURS = ("C0", "C1", "C2", "C4", "C5", "C6", "C8", "C9", "C7")  # of several filters; red is the bands'
_MANY = 20  # runs from which their distribution has a shape
_DENSE = 1500  # steps from which a line would be a smear

Draw = Callable[["Axes", str], None]
Make = Callable[[], "Figure"]
Columns = Mapping[str, Array]
Rows = Sequence[Mapping[str, Any]]


def pictures(
    tables: Mapping[str, Mapping[str, Any]],
    arrays: dict[str, Array],
    filters: Sequence[str],
    space: Space,
    title: str,
    runs: range,
    draw: Draw,
) -> dict[str, Make]:
    """What draws each picture that the run has, by its name. A single step has none.

    tables: what is written of each filter, by file, as far as there is any. arrays: those of estimates.npz. draw: adds
    the problem's own things to the trajectory, for a filter's name.
    """
    if arrays["time"].size < 2:
        return {}
    found: dict[str, Make] = {}
    errors, histograms = tables.get(rundir.ERRORS), tables.get(rundir.HISTOGRAMS)
    if errors:
        found["errors.png"] = lambda: draw_errors(errors, space, title, runs)
    for file, column, what in ((rundir.NEES, "anees", "NEES / n"), (rundir.NIS, "anis", "NIS / m")):
        if shown := {name: one for name, one in tables.get(file, {}).items() if np.isfinite(one[column]).any()}:
            found[f"{column[1:]}.png"] = partial(draw_consistency, shown, column, what, title, runs)
    sizes = {name: _noted(one, "ess") for name, one in tables.get(rundir.NOTES, {}).items() if "ess" in one["note"]}
    if sizes:
        found["ess.png"] = lambda: draw_ess(sizes, title, runs)
    if histograms and len(runs) >= _MANY:
        found["distribution.png"] = lambda: draw_distribution(histograms, space, title)
    if space.position:
        found["trajectory.png"] = lambda: draw_trajectory(arrays, list(filters), space, title, draw)
    return found


def draw_errors(errors: Mapping[str, Columns], space: Space, title: str, runs: range) -> "Figure":
    """One panel a component: the first run's error and +-3 sigma, the bound, for one filter the ensemble's RMSE."""
    figure, panels = new_figure(space.size, title, 1.7)
    alone = len(errors) == 1
    held = _held(errors)
    for i, axes in enumerate(panels):
        of_component = {name: {k: c[i :: space.size] for k, c in columns.items()} for name, columns in errors.items()}
        for (name, columns), colour in zip(of_component.items(), _colours(len(errors)), strict=True):
            of = f"run {runs[0]}" if alone else f"{name}, run {runs[0]}"
            _draw_error(axes, columns, colour, of, alone)
            if alone and len(runs) > 1:
                label = f"RMSE of {len(runs)} runs"
                _line(axes, columns, "rmse", color=_ENSEMBLE, lw=1.2, ls="--", label=label)
        first = next(iter(of_component.values()))
        if np.isfinite(first["bound"]).any():
            _line(axes, first, "bound", color=_TRUTH, lw=1.2, ls=":", label="Cramér-Rao bound")
        _limit(axes, [of_component[name] for name in held])
        axes.set_ylabel(f"{space.names[i]} [{space.units[i]}]")
    if not alone:
        panels[0].plot([], [], color="0.4", lw=0.8, ls=":", label="±3 sigma")
    panels[-1].set_xlabel("time [s]")
    legend_below(figure, panels[0])
    return figure


def _draw_error(axes: "Axes", columns: Columns, colour: str, of: str, alone: bool) -> None:
    """A run's error in a component, and +-3 sigma about zero."""
    dense = columns["time"].size > _DENSE
    band = _BAND if alone else colour
    shown = telling(columns["upper3"])
    axes.fill_between(
        columns["time"][shown],
        columns["lower3"][shown],
        columns["upper3"][shown],
        color=band,
        alpha=(0.35 if dense else 0.15) if alone else 0.08,
        lw=0,
        label=f"±3 sigma, {of}" if alone else None,
    )
    if not dense:
        for key in ("lower3", "upper3"):
            axes.plot(columns["time"], columns[key], color=band, lw=0.8, ls="-" if alone else ":")
    what = "error" if np.isfinite(columns["truth"]).any() else "truth not known"
    _line(axes, columns, "error", color=colour, lw=0.7 if dense else 1.0, label=f"{what}, {of}")


def draw_consistency(by_filter: Mapping[str, Columns], column: str, what: str, title: str, runs: range) -> "Figure":
    """A normalised statistic over time, on a logarithmic scale, with the 95 % band of a consistent filter."""
    figure, (axes,) = new_figure(1, title, 3.6)
    colours = dict(zip(by_filter, _colours(len(by_filter)), strict=True))
    shown = {name: columns for name, columns in by_filter.items() if columns["time"].size}
    whole = {key: _all(shown, key) for key in (column, "lower", "upper", "runs_scored")}
    dense = len(runs) == 1 and whole[column].size > 600 * len(shown)
    mean = "" if len(runs) == 1 else f", mean of {int(whole['runs_scored'].max())} runs"
    first = next(iter(shown))
    for name, columns in shown.items():
        label = what + mean if len(shown) == 1 else f"{name}{mean}"
        broken = broken_at_gaps({key: columns[key] for key in ("time", column)})
        style = "." if dense else "-"
        axes.plot(broken["time"], broken[column], style, ms=2, color=colours[name], lw=1.0, label=label)
    band = broken_at_gaps({key: shown[first][key] for key in ("time", "lower", "upper")})
    label = "95 % of a consistent filter" + ("" if len(shown) == 1 else f", for {first}")
    axes.fill_between(band["time"], band["lower"], band["upper"], color=_ENSEMBLE, alpha=0.25, lw=0, label=label)
    axes.axhline(1.0, color="0.4", lw=0.8)
    positive = whole[column][(whole[column] > 0.0) & np.isfinite(whole[column])]
    tail = 0.005 if dense else 0.0
    ends = [0.8 * np.quantile(positive, tail), 1.25 * np.quantile(positive, 1.0 - tail)] if positive.size else [1.0]
    lower, upper = whole["lower"][whole["lower"] > 0.0], whole["upper"][np.isfinite(whole["upper"])]  # NaN without law
    low = float(np.clip(min(*ends, 0.5 * lower.min(initial=1.0)), 1e-4, 0.5))
    high = float(np.clip(max(*ends, 2.0 * upper.max(initial=1.0)), 2.0, 1e8))
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    logarithmic(axes.yaxis, low, high)
    axes.set_ylabel(f"{what} (in the band when consistent)")
    axes.set_xlabel("time [s]")
    legend_below(figure, axes)
    return figure


def draw_ess(notes: Mapping[str, Columns], title: str, runs: range) -> "Figure":
    """The effective sample size over time."""
    figure, (axes,) = new_figure(1, title, 3.0)
    for (name, columns), colour in zip(notes.items(), _colours(len(notes)), strict=True):
        _line(axes, columns, "mean", color=colour, lw=1.0, label=f"{name}, mean of {len(runs)} runs")
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("effective sample size [particles]")
    axes.set_xlabel("time [s]")
    legend_below(figure, axes)
    return figure


def _is_drawn(row: Mapping[str, Any]) -> bool:
    """Whether a bin of a histogram is none of those for what lies beyond the others."""
    return row["low"] > 0.0 and bool(np.isfinite(row["high"]))


def draw_distribution(by_filter: Mapping[str, Rows], space: Space, title: str) -> "Figure":
    """How many runs have which RMSE, and which mean NEES / n: a second heap is of runs that lost their way."""
    from matplotlib.ticker import MaxNLocator

    chosen = "position" if space.position else space.names[0]
    unit = space.units[space.position[0] if space.position else 0]
    figure, axes = new_figure(1, title, 3.6, columns=2)
    for panel, metric, component, what in (
        (axes[0], "rmse", chosen, f"RMSE of a run, {chosen} [{unit}]"),
        (axes[1], "anees", "all", "NEES / n of a run"),
    ):
        bins = {
            name: [row for row in rows if (row["metric"], row["component"]) == (metric, component)]
            for name, rows in by_filter.items()
        }
        for (name, mine), colour in zip(bins.items(), _colours(len(bins)), strict=True):
            if not mine:
                continue
            # A line at zero wherever bins without runs were left out. No axis reaches zero or infinity.
            counts = {row["low"]: row["runs"] for row in mine if _is_drawn(row)}
            edges = np.unique([edge for row in mine if _is_drawn(row) for edge in (row["low"], row["high"])])
            heights = [counts.get(edge, 0) for edge in edges[:-1]]
            panel.stairs(heights, edges, color=colour, lw=1.3, label=name, fill=len(bins) == 1, alpha=0.9)
        panel.set_xscale("log")
        drawn = [row for rows in bins.values() for row in rows if _is_drawn(row)]
        lows, highs = ([row[key] for row in drawn] for key in ("low", "high"))
        logarithmic(panel.xaxis, min(lows, default=np.nan), max(highs, default=np.nan))
        beyond = sum(row["runs"] for rows in bins.values() for row in rows if not _is_drawn(row))
        if beyond:
            what += f"; {beyond} run{'s' * (beyond > 1)} beyond"
        panel.yaxis.set_major_locator(MaxNLocator(integer=True))
        panel.set_xlabel(what)
    axes[0].set_ylabel("runs")
    if len(by_filter) > 1:
        legend_below(figure, axes[0])
    return figure


def draw_trajectory(arrays: dict[str, Array], filters: list[str], space: Space, title: str, draw: Draw) -> "Figure":
    """The path of the first run: truth, estimates, 3-sigma ellipses along them, and what the problem adds."""
    from matplotlib.figure import Figure

    at = list(space.position)
    truth = arrays["truth"][at, :, 0]
    figure = Figure(layout="constrained")
    axes = figure.add_subplot()
    draw(axes, filters[0])
    if np.isfinite(truth).any():
        axes.plot(*truth, color=_TRUTH, lw=1.6, label="truth")
    steps = np.unique(np.linspace(0, arrays["time"].size - 1, 15).astype(int))
    # Truth and readings set the scale: neither a filter that diverges nor its uncertainty shall shrink the picture.
    box = axes.dataLim.get_points().T
    for name, colour in zip(filters, _colours(len(filters)), strict=True):
        prefix = f"{name}." if len(filters) > 1 else ""
        path = arrays[f"{prefix}mean"][at, :, 0]
        path = _within(path, box) if np.isfinite(box).all() else path
        axes.plot(*path, color=colour, lw=1.1, label=name if prefix else "estimate")
    left, low, right, top = axes.dataLim.extents
    wide, high = axes.dataLim.size
    for name, colour in zip(filters, _colours(len(filters)), strict=True):
        prefix = f"{name}." if len(filters) > 1 else ""
        mean, cov = arrays[f"{prefix}mean"][at, :, 0], arrays[f"{prefix}cov"][at][:, at, :, 0]
        outline = ellipses(mean[:, steps], cov[..., steps])
        axes.plot(*outline, color=colour if prefix else _BAND, lw=0.8, ls=":" if prefix else "-")
    axes.plot([], [], color="0.4" if len(filters) > 1 else _BAND, lw=0.8, label="3 sigma of the position")
    known = np.flatnonzero(np.isfinite(truth).all(axis=0))
    if known.size:
        axes.plot(*truth[:, known[0]], "o", color=_TRUTH, mfc="white", ms=7, label="start of the truth")
    margin = 0.08 * max(wide, high)
    axes.set_xlim(left - margin, right + margin)
    axes.set_ylim(low - margin, top + margin)
    figure.set_size_inches(WIDTH, 1.6 + WIDTH * float(np.clip(1.1 * high / max(wide, 1e-9), 0.35, 1.0)))
    axes.set_aspect("equal")
    axes.set_xlabel(f"{space.names[at[0]]} [{space.units[at[0]]}]")
    axes.set_ylabel(f"{space.names[at[1]]} [{space.units[at[1]]}]")
    axes.grid(alpha=0.3)
    headed(figure, f"{title} · run {arrays['run'][0]}")
    legend_below(figure, axes)
    return figure


def _colours(count: int) -> list[str]:
    return [_COLOURS[i % len(_COLOURS)] for i in range(count)]


def _line(axes: "Axes", columns: Columns, key: str, **style: Any) -> None:
    """A column over time, by as many points as can be seen."""
    shown = telling(columns[key])
    axes.plot(columns["time"][shown], columns[key][shown], **style)


def _all(by_filter: Mapping[str, Columns], key: str) -> Array:
    """A column of all filters."""
    return np.concatenate([columns[key] for columns in by_filter.values()])


def _noted(notes: Columns, name: str) -> dict[str, Array]:
    """The lines of notes.csv that are of one of the notes."""
    mine = notes["note"] == name
    return {key: notes[key][mine] for key in ("time", "mean")}


def _limit(axes: "Axes", columns: Sequence[Columns]) -> None:
    """A scale on which the settled part is seen: an opening ten times as uncertain may leave the panel."""
    upper, error = (np.concatenate([one[key] for one in columns]) for key in ("upper3", "error"))
    parts = ((upper[np.isfinite(upper)], 0.9), (np.abs(error[np.isfinite(error)]), 0.99))
    sizes = [float(np.quantile(values, share)) for values, share in parts if values.size]
    if sizes and 0.0 < (settled := 1.25 * max(sizes)) < 1e300:
        axes.set_ylim(-settled, settled)


def _held(errors: Mapping[str, Columns]) -> list[str]:
    """The filters whose first run did not diverge, which alone say how large a panel is; all where each one did."""
    return [name for name, columns in errors.items() if not np.isnan(columns["estimate"]).any()] or list(errors)


def _within(place: Array, box: Array) -> Array:
    """A path (2, T) where it is in a box (2, 2), half as large again, of least and greatest; NaN elsewhere."""
    low, high = box[:, :1], box[:, 1:]
    room = 0.25 * (high - low).max()
    return np.where(((place >= low - room) & (place <= high + room)).all(axis=0), place, np.nan)
