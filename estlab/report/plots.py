"""The pictures of a run, drawn from its directory."""

import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from estlab import rundir
from estlab.maths.gaussian import ellipses
from estlab.maths.space import Array, Space

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from pandas import DataFrame

_TRUTH, _ESTIMATE, _BAND, _ENSEMBLE = "black", "C0", "C3", "C2"
_COLOURS = ("C0", "C1", "C2", "C4", "C5", "C6", "C8", "C9", "C7")  # of several filters; red is the bands'
_WIDTH = 9.0  # inches
_MANY = 20  # runs from which their distribution has a shape
_DENSE = 1500  # steps from which a line would be a smear

Save = Callable[[str, Callable[[Any], object]], object]
Draw = Callable[["Axes", str], None]
Pictures = Callable[[], "dict[str, Figure]"]


def draw_all(
    directory: Path, save: Save, space: Space, title: str, runs: range, draw: Draw, pictures: Pictures
) -> None:
    """Draw every picture of a run directory and hand each to ``save`` by its name.

    draw: adds the problem's own things to the trajectory, for a filter's name. pictures: the problem's own figures.
    """
    import pandas as pd

    errors = pd.read_csv(directory / rundir.ERRORS)
    if errors["time"].nunique() > 1:
        _save(save, "errors.png", draw_errors(errors, space, title, runs))
        for name, column, what in ((rundir.NEES, "anees", "NEES / n"), (rundir.NIS, "anis", "NIS / m")):
            table = pd.read_csv(directory / name)
            if table[column].notna().any():
                _save(save, f"{column[1:]}.png", draw_consistency(table, column, what, title, runs))
        notes = pd.read_csv(directory / rundir.NOTES)
        if (notes["note"] == "ess").any():
            _save(save, "ess.png", draw_ess(notes[notes["note"] == "ess"], title, runs))
        if len(runs) >= _MANY:
            _save(save, "distribution.png", draw_distribution(pd.read_csv(directory / rundir.HISTOGRAMS), space, title))
        if space.position:
            with np.load(directory / rundir.ESTIMATES) as arrays:
                filters = list(dict.fromkeys(errors["filter"]))
                _save(save, "trajectory.png", draw_trajectory(dict(arrays), filters, space, title, draw))
    for name, figure in pictures().items():
        _save(save, name, figure)


def draw_errors(errors: "DataFrame", space: Space, title: str, runs: range) -> "Figure":
    """One panel a component: the first run's error and +-3 sigma, the bound, for one filter the ensemble's RMSE."""
    figure, panels = new_figure(space.size, title, 1.7)
    dense = errors["time"].nunique() > _DENSE
    by_filter = list(errors.groupby("filter", sort=False))
    alone = len(by_filter) == 1
    held = errors[errors["filter"].isin(_held(errors))]
    for axes, name, unit in zip(panels, space.names, space.units, strict=True):
        for (filter, rows_of_filter), colour in zip(by_filter, _colours(len(by_filter)), strict=True):
            rows = rows_of_filter[rows_of_filter["component"] == name]
            band = _BAND if alone else colour
            of = f"run {runs[0]}" if alone else f"{filter}, run {runs[0]}"
            alpha = (0.35 if dense else 0.15) if alone else 0.08
            label = f"±3 sigma, {of}" if alone else None
            axes.fill_between(rows["time"], rows["lower3"], rows["upper3"], color=band, alpha=alpha, lw=0, label=label)
            if not dense:
                axes.plot(rows["time"], rows[["lower3", "upper3"]], color=band, lw=0.8, ls="-" if alone else ":")
            what = "error" if errors["truth"].notna().any() else "truth not known"
            axes.plot(rows["time"], rows["error"], color=colour, lw=0.7 if dense else 1.0, label=f"{what}, {of}")
            if alone and len(runs) > 1:
                label = f"RMSE of {len(runs)} runs"
                axes.plot(rows["time"], rows["rmse"], color=_ENSEMBLE, lw=1.2, ls="--", label=label)
        bound = by_filter[0][1].loc[by_filter[0][1]["component"] == name, ["time", "bound"]]
        if bound["bound"].notna().any():
            axes.plot(bound["time"], bound["bound"], color=_TRUTH, lw=1.2, ls=":", label="Cramér-Rao bound")
        _limit(axes, held[held["component"] == name])
        axes.set_ylabel(f"{name} [{unit}]")
    if not alone:
        panels[0].plot([], [], color="0.4", lw=0.8, ls=":", label="±3 sigma")
    panels[-1].set_xlabel("time [s]")
    legend_below(figure, panels[0])
    return figure


def draw_consistency(table: "DataFrame", column: str, what: str, title: str, runs: range) -> "Figure":
    """A normalised statistic over time, on a logarithmic scale, with the 95 % band of a consistent filter."""
    figure, (axes,) = new_figure(1, title, 3.6)
    by_filter = list(table.groupby("filter", sort=False))
    dense = len(runs) == 1 and len(table) > 600 * len(by_filter)
    mean = "" if len(runs) == 1 else f", mean of {int(table['runs_scored'].max())} runs"
    for (filter, rows), colour in zip(by_filter, _colours(len(by_filter)), strict=True):
        label = what + mean if len(by_filter) == 1 else f"{filter}{mean}"
        rows = broken_at_gaps(rows)
        axes.plot(rows["time"], rows[column], "." if dense else "-", ms=2, color=colour, lw=1.0, label=label)
    first = broken_at_gaps(by_filter[0][1])
    axes.fill_between(
        first["time"],
        first["lower"],
        first["upper"],
        color=_ENSEMBLE,
        alpha=0.25,
        lw=0,
        label="95 % of a consistent filter" + ("" if len(by_filter) == 1 else f", for {table['filter'].iloc[0]}"),
    )
    axes.axhline(1.0, color="0.4", lw=0.8)
    positive = table[column][table[column] > 0.0]
    low = min(0.5 * float(table["lower"].min()), 0.8 * float(np.nanquantile(positive, 0.005 if dense else 0.0)))
    high = max(2.0 * float(table["upper"].max()), 1.25 * float(np.nanquantile(positive, 0.995 if dense else 1.0)))
    low, high = max(low, 1e-4), min(high, 1e8)
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    logarithmic(axes.yaxis, low, high)
    axes.set_ylabel(f"{what} (in the band when consistent)")
    axes.set_xlabel("time [s]")
    legend_below(figure, axes)
    return figure


def draw_ess(notes: "DataFrame", title: str, runs: range) -> "Figure":
    """The effective sample size over time."""
    figure, (axes,) = new_figure(1, title, 3.0)
    by_filter = list(notes.groupby("filter", sort=False))
    for (filter, rows), colour in zip(by_filter, _colours(len(by_filter)), strict=True):
        axes.plot(rows["time"], rows["mean"], color=colour, lw=1.0, label=f"{filter}, mean of {len(runs)} runs")
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("effective sample size [particles]")
    axes.set_xlabel("time [s]")
    legend_below(figure, axes)
    return figure


def draw_distribution(histograms: "DataFrame", space: Space, title: str) -> "Figure":
    """How many runs have which RMSE, and which mean NEES / n: a second heap is of runs that lost their way."""
    from matplotlib.ticker import MaxNLocator

    chosen = "position" if (histograms["component"] == "position").any() else histograms["component"].iloc[0]
    unit = space.units[space.position[0] if chosen == "position" else space.names.index(chosen)]
    figure, axes = new_figure(1, title, 3.6, columns=2)
    for panel, metric, component, what in (
        (axes[0], "rmse", chosen, f"RMSE of a run, {chosen} [{unit}]"),
        (axes[1], "anees", "all", "NEES / n of a run"),
    ):
        rows = histograms[(histograms["metric"] == metric) & (histograms["component"] == component)]
        by_filter = list(rows.groupby("filter", sort=False))
        for (filter, mine), colour in zip(by_filter, _colours(len(by_filter)), strict=True):
            # A line at zero wherever bins without runs were left out.
            edges = np.unique(np.concatenate([mine["low"], mine["high"]]))
            heights = mine.set_index("low")["runs"].reindex(edges[:-1], fill_value=0).to_numpy()
            panel.stairs(heights, edges, color=colour, lw=1.3, label=filter, fill=len(by_filter) == 1, alpha=0.9)
        panel.set_xscale("log")
        logarithmic(panel.xaxis, rows["low"].min(), rows["high"].max())
        panel.yaxis.set_major_locator(MaxNLocator(integer=True))
        panel.set_xlabel(what)
    axes[0].set_ylabel("runs")
    if histograms["filter"].nunique() > 1:
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
    figure.set_size_inches(_WIDTH, 1.6 + _WIDTH * float(np.clip(1.1 * high / max(wide, 1e-9), 0.35, 1.0)))
    axes.set_aspect("equal")
    axes.set_xlabel(f"{space.names[at[0]]} [{space.units[at[0]]}]")
    axes.set_ylabel(f"{space.names[at[1]]} [{space.units[at[1]]}]")
    axes.grid(alpha=0.3)
    _title(figure, f"{title} · run {arrays['run'][0]}")
    legend_below(figure, axes)
    return figure


def new_figure(rows: int, title: str, height: float, columns: int = 1) -> tuple["Figure", list["Axes"]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, height * rows + 1.0), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=columns == 1, squeeze=False).ravel()
    for axes in panels:
        axes.grid(alpha=0.3)
    _title(figure, title)
    return figure, list(panels)


def _colours(count: int) -> list[str]:
    return [_COLOURS[i % len(_COLOURS)] for i in range(count)]


def legend_below(figure: "Figure", axes: "Axes") -> None:
    """A legend under the panels, in as many columns as its longest entry leaves room for."""
    handles, labels = axes.get_legend_handles_labels()
    columns = max(1, int(14.0 * _WIDTH / (max(map(len, labels), default=1) + 8)))
    figure.legend(handles, labels, loc="outside lower center", ncols=min(columns, 5), frameon=False, fontsize="small")


def _title(figure: "Figure", title: str) -> None:
    figure.suptitle(textwrap.fill(title, 90), fontsize="large")


def broken_at_gaps(rows: "DataFrame") -> "DataFrame":
    """Rows with an empty one wherever time jumps by many steps, so that no line is drawn across."""
    import pandas as pd

    time = rows["time"].to_numpy()
    lapse = np.diff(time)
    gaps = np.flatnonzero(lapse > 10.0 * np.median(lapse)) if lapse.size else np.empty(0, dtype=int)
    empty = pd.DataFrame({"time": 0.5 * (time[gaps] + time[gaps + 1])})
    return pd.concat([rows, empty]).sort_values("time", kind="stable") if gaps.size else rows


def logarithmic(axis: "Axis", low: float, high: float) -> None:
    """Ticks of a logarithmic axis as plain numbers, closer together where it spans little."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    span = high / low
    subs = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if span < 10.0 else (1.0, 2.0, 5.0) if span < 300.0 else (1.0,)
    axis.set_major_locator(LogLocator(subs=subs, numticks=20))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _limit(axes: "Axes", rows: "DataFrame") -> None:
    """A scale on which the settled part is seen: an opening ten times as uncertain may leave the panel."""
    wide, far = rows["upper3"].quantile(0.9), rows["error"].abs().quantile(0.99)  # NaN where there is none
    settled = 1.25 * float(np.nanmax([wide, far, 1e-12]))
    if np.isfinite(settled):
        axes.set_ylim(-settled, settled)


def _held(errors: "DataFrame") -> list[str]:
    """The filters whose first run did not diverge, which alone say how large a panel is; all where each one did."""
    sound = errors["estimate"].notna().groupby(errors["filter"]).all()
    return list(sound.index[sound]) or list(sound.index)


def _within(place: Array, box: Array) -> Array:
    """A path (2, T) where it is in a box (2, 2), half as large again, of least and greatest; NaN elsewhere."""
    low, high = box[:, :1], box[:, 1:]
    room = 0.25 * (high - low).max()
    return np.where(((place >= low - room) & (place <= high + room)).all(axis=0), place, np.nan)


def _save(save: Save, name: str, figure: "Figure") -> None:
    save(f"{rundir.PLOTS}/{name}", lambda stream: figure.savefig(stream, format="png", dpi=110))
