"""The pictures of a run over time: errors, NEES and NIS, effective sample size."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from estlab.maths.space import Array, Space
from estlab.metrics.vocabulary import CONSISTENT_BAND, heading, unit_of
from estlab.report import components
from estlab.report.components import Columns
from estlab.report.figures import (
    broken_at_gaps,
    cornered,
    drawable,
    legend_below,
    line,
    logarithmic,
    named,
    new_figure,
    short,
    telling,
    within_reach,
)
from estlab.report.palette import BAND, ENSEMBLE, TRUTH

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DENSE = 1500  # steps from which a line would be a smear
_CUT = 3.0  # times as large as the smallest, from which a filter's errors leave a panel
_LOST = 1e3  # steps from which a line would be a smear
_HIGHEST = 1e4  # times the smallest, from which a filter's errors leave a panel


def draw_errors(
    errors: Mapping[str, Columns], space: Space, title: str, runs: range, colours: Mapping[str, str]
) -> "Figure":
    """One panel a component: the first run's error and +-3 sigma, the bound, for one filter the ensemble's RMSE.

    Where the truth of a component is not known, its estimate and +-3 sigma about that. Of many components some.
    """
    some = components.chosen(components.ratios(errors, space.size), space.position)
    note = components.selection(some, space.size)
    figure, panels = new_figure(len(some), f"{title} · {note}" if note else title, 1.7)
    for i, axes in zip(some, panels, strict=True):
        mine = {name: {key: column[i :: space.size] for key, column in one.items()} for name, one in errors.items()}
        if any(np.isfinite(columns["error"]).any() for columns in mine.values()):
            _draw_component(axes, mine, runs, colours, i in space.angles)
        else:
            _draw_estimates(axes, mine, runs, colours, i in space.angles)
        named(axes, space.names[i], space.units[i])
    if len(errors) > 1:
        panels[0].plot([], [], color="0.4", lw=0.8, ls=":", label="±3 sigma")
    panels[-1].set_xlabel("time [s]")
    legend_below(figure, panels[0])
    return figure


def _draw_component(
    axes: "Axes", errors: Mapping[str, Columns], runs: range, colours: Mapping[str, str], angle: bool
) -> None:
    """Of one component, every filter's error about zero."""
    alone = len(errors) == 1
    for name, columns in errors.items():
        of = f"run {runs[0]}" if alone else f"{name}, run {runs[0]}"
        _draw_band(axes, columns, np.zeros(columns["time"].size), colours[name], of, alone)
        line(axes, columns, "error", color=colours[name], lw=_width(columns), label=short(f"error, {of}"))
        if alone and len(runs) > 1:
            line(axes, columns, "rmse", color=ENSEMBLE, lw=1.2, ls="--", label=f"RMSE of {len(runs)} runs")
    first = next(iter(errors.values()))
    if np.isfinite(first["bound"]).any():
        line(axes, first, "bound", color=TRUTH, lw=1.2, ls=":", label="Cramér-Rao bound")
    _limit(axes, errors, len(runs), np.pi if angle else 1e99)


def _draw_estimates(
    axes: "Axes", errors: Mapping[str, Columns], runs: range, colours: Mapping[str, str], angle: bool
) -> None:
    """Of one component whose truth is not known, every filter's estimate."""
    alone = len(errors) == 1
    edges, widths = {}, {}
    for name, columns in errors.items():
        of = f"run {runs[0]}" if alone else f"{name}, run {runs[0]}"
        middle = drawable(columns["estimate"])
        jumps = angle & (np.abs(np.diff(middle, append=middle[-1:])) > np.pi)
        about = np.where(jumps, np.nan, middle)
        _draw_band(axes, columns, about, colours[name], of, alone)
        label = short(f"estimate, truth unknown, {of}")
        line(axes, {**columns, "about": about}, "about", color=colours[name], lw=_width(columns), label=label)
        known = np.isfinite(middle) & np.isfinite(columns["upper3"])
        if known.any():
            widths[name] = float(np.quantile(columns["upper3"][known], 0.9))
            wide = np.minimum(columns["upper3"][known], widths[name])
            edges[name] = (middle[known] - wide).min(), (middle[known] + wide).max()
    _, gone = within_reach(widths, _CUT)
    ends = [end for name, both in edges.items() if name not in gone for end in both]
    if ends and max(ends) > min(ends):
        room = 0.05 * (max(ends) - min(ends))
        axes.set_ylim(min(ends) - room, max(ends) + room)
    _note_beyond(axes, gone, widths)


def _draw_band(axes: "Axes", columns: Columns, about: Array, colour: str, of: str, alone: bool) -> None:
    """+-3 sigma about a line."""
    dense = columns["time"].size > _DENSE
    band = BAND if alone else colour
    kept = telling(columns["upper3"])
    low, high = (drawable(about + columns[key]) for key in ("lower3", "upper3"))
    axes.fill_between(
        columns["time"][kept],
        low[kept],
        high[kept],
        color=band,
        alpha=(0.35 if dense else 0.15) if alone else 0.08,
        lw=0,
        label=short(f"±3 sigma, {of}") if alone else None,
    )
    if not dense:
        for edge in (low, high):
            axes.plot(columns["time"], edge, color=band, lw=0.8, ls="-" if alone else ":")


def _width(columns: Columns) -> float:
    return 0.7 if columns["time"].size > _DENSE else 1.0


def _limit(axes: "Axes", errors: Mapping[str, Columns], runs: int, most: float) -> None:
    """A scale on which the settled part is seen: an opening ten times as uncertain may leave the panel.

    It is that of the filters that hold: one that is far off leaves the panel, which says so. most: the largest error
    that there is, as of an angle half a turn, which a band may exceed.
    """
    sizes = {name: _settled(columns) for name, columns in errors.items()}
    # A filter that diverged on its way says nothing of the scale, unless each one did.
    whole = [name for name, columns in errors.items() if not np.isnan(columns["estimate"]).any()] or list(errors)
    size, gone = within_reach({name: sizes[name] for name in whole}, _CUT)
    if len(errors) == 1 and runs > 1 and _any(rmse := next(iter(errors.values()))["rmse"]):
        sizes[f"RMSE of {runs} runs"] = of_all = float(np.quantile(rmse[np.isfinite(rmse)], 0.9))
        size = of_all if size < of_all <= _CUT * size else size
    size = min(size, most)
    if 0.0 < size < 1e99:
        axes.set_ylim(-1.25 * size, 1.25 * size)
        gone += [name for name in sizes if name not in gone and sizes[name] > 1.25 * size]
    _note_beyond(axes, gone, sizes)


def _note_beyond(axes: "Axes", gone: Sequence[str], sizes: Mapping[str, float]) -> None:
    """Which filters leave the panel, and how far they reach."""
    beyond = ", ".join(f"{name} (±{sizes[name]:.2g})" for name in gone[:3])
    cornered(axes, f"beyond the panel: {beyond}" if beyond else "")


def _settled(columns: Columns) -> float:
    """How large errors and band are for most of the time; NaN where neither is known, infinite where they are not."""
    parts = ((columns["upper3"], 0.9), (np.abs(columns["error"]), 0.99))
    sizes = [float(np.quantile(values[np.isfinite(values)], share)) for values, share in parts if _any(values)]
    return max(sizes, default=np.nan)


def _any(values: Array) -> bool:
    return bool(np.isfinite(values).any())


def draw_consistency(
    by_filter: Mapping[str, Columns], column: str, title: str, runs: range, colours: Mapping[str, str]
) -> "Figure":
    """A normalised statistic over time, on a logarithmic scale, with the 95 % band of a consistent filter."""
    figure, (axes,) = new_figure(1, title, 3.6)
    what = heading(column)
    drawn = {name: columns for name, columns in by_filter.items() if columns["time"].size}
    longest = max(columns["time"].size for columns in drawn.values())
    dense = len(runs) == 1 and longest > 600
    count = max(int(columns["runs_scored"].max()) for columns in drawn.values())
    mean = "" if len(runs) == 1 else f", mean of {count} runs"
    first = next(iter(drawn))
    for name, columns in drawn.items():
        label = short(what + mean if len(drawn) == 1 else f"{name}{mean}")
        broken = broken_at_gaps({key: columns[key] for key in ("time", column)})
        style = "." if dense else "-"
        values = np.where(broken[column] > 0.0, drawable(broken[column]), np.nan)
        axes.plot(broken["time"], values, style, ms=2, color=colours[name], lw=1.0, label=label)
    draw_consistent(axes, drawn[first], "" if len(drawn) == 1 else f", for {first}")
    low, high, note = _span(drawn, column, 0.005 if dense else 0.0)
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    cornered(axes, note)
    logarithmic(axes.yaxis, low, high)
    axes.set_ylabel(f"{what} (in the band when consistent)")
    axes.set_xlabel("time [s]")
    legend_below(figure, axes)
    return figure


def draw_consistent(axes: "Axes", columns: Columns, of: str) -> None:
    """The band of a consistent filter and its mean, one; no band of a sample that is too small to have one.

    columns: time, lower and upper. of: what the label says after the band's name.
    """
    band = broken_at_gaps({key: columns[key] for key in ("time", "lower", "upper")})
    if np.isfinite(band["upper"]).any():
        style: dict[str, Any] = {"color": ENSEMBLE, "alpha": 0.25, "lw": 0, "label": short(CONSISTENT_BAND + of)}
        axes.fill_between(band["time"], band["lower"], band["upper"], **style)
    axes.axhline(1.0, color="0.4", lw=0.8)


def _span(drawn: Mapping[str, Columns], column: str, tail: float) -> tuple[float, float, str]:
    """The ends of the axis, which the filters that hold and the band decide, and what is said of the others."""
    values = {name: columns[column][_known(columns[column])] for name, columns in drawn.items()}
    values = {name: found for name, found in values.items() if found.size}
    _, gone = within_reach({name: float(np.quantile(found, 0.99)) for name, found in values.items()}, _LOST)
    inside = [found for name, found in values.items() if name not in gone]
    lows = [0.8 * float(np.quantile(found, tail)) for found in inside]
    highs = [1.25 * float(np.quantile(found, 1.0 - tail)) for found in inside]
    bands = [columns[key][_known(columns[key])] for columns in drawn.values() for key in ("lower", "upper")]
    lows += [0.5 * float(band.min()) for band in bands if band.size]  # NaN where the statistic has no law
    highs += [2.0 * float(band.max()) for band in bands if band.size]
    low = float(np.clip(min(lows, default=0.5), 1e-4, 0.5))
    high = float(np.clip(max(highs, default=2.0), 2.0, _HIGHEST))
    beyond = {name: float(found.max()) for name, found in values.items() if found.max() > 2.0 * high}
    names = ", ".join(f"{name} (to {most:.2g})" for name, most in list(beyond.items())[:3])
    return low, high, f"beyond the panel: {names}" if names else ""


def _known(values: Array) -> Array:
    return np.isfinite(values) & (values > 0.0)


def draw_ess(notes: Mapping[str, Columns], title: str, runs: range, colours: Mapping[str, str]) -> "Figure":
    """The effective sample size over time."""
    figure, (axes,) = new_figure(1, title, 3.0)
    for name, columns in notes.items():
        line(axes, columns, "mean", color=colours[name], lw=1.0, label=short(f"{name}, mean of {len(runs)} runs"))
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel(heading("ess", unit=unit_of("ess")))
    axes.set_xlabel("time [s]")
    legend_below(figure, axes)
    return figure


def noted(notes: Columns, name: str) -> dict[str, Array]:
    """The lines of notes.csv that are of one of the notes."""
    mine = notes["note"] == name
    return {key: notes[key][mine] for key in ("time", "mean")}


def consistency_of(by_filter: Mapping[str, Columns], column: str) -> dict[str, Columns]:
    """The filters of which there is anything to draw."""
    return {name: one for name, one in by_filter.items() if np.isfinite(np.asarray(one[column])).any()}
