"""The pictures of a run, drawn from its directory."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from estlab import rundir
from estlab.maths.space import Array, Space

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

_TRUTH, _ESTIMATE, _BAND, _ENSEMBLE = "black", "C0", "C3", "C2"
_WIDTH = 9.0  # inches
_DENSE = 1500  # steps from which a line would be a smear

Save = Callable[[str, Callable[[Any], object]], object]
Draw = Callable[["Axes", dict[str, Array]], None]


def draw_all(directory: Path, save: Save, space: Space, title: str, runs: int, draw: Draw) -> None:
    """Draw every picture of a run directory and hand each to ``save`` by its name.

    draw: adds the problem's own things to the trajectory, given the arrays of run 0.
    """
    import pandas as pd

    errors = pd.read_csv(directory / rundir.ERRORS)
    _save(save, "errors.png", draw_errors(errors, space, title, runs))
    for name, column, what in (
        (rundir.NEES, "anees", "NEES / n"),
        (rundir.NIS, "anis", "NIS / m"),
    ):
        table = pd.read_csv(directory / name)
        if table[column].notna().any():
            _save(save, f"{column[1:]}.png", draw_consistency(table, column, what, title, runs))
    if space.position:
        with np.load(directory / rundir.ESTIMATES) as arrays:
            _save(save, "trajectory.png", draw_trajectory(dict(arrays), space, title, draw))


def draw_errors(errors: "DataFrame", space: Space, title: str, runs: int) -> "Figure":
    """One panel a component: the error of run 0 inside its +-3 sigma, and the ensemble's RMSE."""
    figure, panels = _figure(space.size, title, 1.7)
    dense = errors["time"].nunique() > _DENSE
    for axes, name, unit in zip(panels, space.names, space.units, strict=True):
        rows = errors[errors["component"] == name]
        alpha = 0.35 if dense else 0.15
        axes.fill_between(
            rows["time"], rows["lower3"], rows["upper3"], color=_BAND, alpha=alpha, lw=0, label="±3 sigma, run 0"
        )
        if not dense:
            axes.plot(rows["time"], rows[["lower3", "upper3"]], color=_BAND, lw=0.8)
        axes.plot(rows["time"], rows["error"], color=_ESTIMATE, lw=0.7 if dense else 1.0, label="error, run 0")
        if runs > 1:
            axes.plot(rows["time"], rows["rmse"], color=_ENSEMBLE, lw=1.2, ls="--", label=f"RMSE of {runs} runs")
        _limit(axes, rows)
        axes.set_ylabel(f"{name} [{unit}]")
    panels[-1].set_xlabel("time [s]")
    _legend_below(figure, panels[0])
    return figure


def draw_consistency(table: "DataFrame", column: str, what: str, title: str, runs: int) -> "Figure":
    """A normalised statistic over time, on a logarithmic scale, with the 95 % band of a consistent filter."""
    figure, (axes,) = _figure(1, title, 3.6)
    time, values = table["time"], table[column]
    mean = "" if runs == 1 else f", mean of {int(table['runs_scored'].max())} runs"
    dense = runs == 1 and time.size > 600
    axes.plot(time, values, "." if dense else "-", ms=2, color=_ESTIMATE, lw=1.0, label=what + mean)
    axes.fill_between(
        time, table["lower"], table["upper"], color=_ENSEMBLE, alpha=0.25, lw=0, label="95 % of a consistent filter"
    )
    axes.axhline(1.0, color="0.4", lw=0.8)
    positive = values[values > 0.0]
    low = min(0.5 * float(table["lower"].min()), 0.8 * float(np.nanquantile(positive, 0.005 if dense else 0.0)))
    high = max(2.0 * float(table["upper"].max()), 1.25 * float(np.nanquantile(positive, 0.995 if dense else 1.0)))
    _logarithmic(axes, max(low, 1e-4), high)
    axes.set_ylabel(f"{what} (1 when consistent)")
    axes.set_xlabel("time [s]")
    _legend_below(figure, axes)
    return figure


def draw_trajectory(arrays: dict[str, Array], space: Space, title: str, draw: Draw) -> "Figure":
    """The path of run 0: truth, estimate, 3-sigma ellipses along it, and what the problem adds."""
    from matplotlib.figure import Figure

    i, j = space.position
    first = {name: arrays[name][..., 0] for name in ("truth", "mean", "cov", "values", "target")}
    first |= {name: arrays[name] for name in ("time", "step", "places")}
    truth, mean, cov = first["truth"], first["mean"], first["cov"]
    figure = Figure(layout="constrained")
    axes = figure.add_subplot()
    draw(axes, first)
    axes.plot(truth[i], truth[j], color=_TRUTH, lw=1.6, label="truth")
    axes.plot(mean[i], mean[j], color=_ESTIMATE, lw=1.1, label="estimate")
    steps = np.unique(np.linspace(0, first["time"].size - 1, 15).astype(int))
    outline = ellipses(mean[[i, j]][:, steps], cov[[i, j]][:, [i, j]][..., steps])
    axes.plot(outline[0], outline[1], color=_BAND, lw=0.8)
    axes.plot([], [], color=_BAND, lw=0.8, label="3 sigma of the position")
    known = np.flatnonzero(np.isfinite(truth[[i, j]]).all(axis=0))
    if known.size:
        axes.plot(*truth[[i, j], known[0]], "o", color=_TRUTH, mfc="white", ms=7, label="start of the truth")
    wide, high = axes.dataLim.size
    figure.set_size_inches(_WIDTH, 1.6 + _WIDTH * float(np.clip(1.1 * high / max(wide, 1e-9), 0.35, 1.0)))
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.06)
    axes.set_xlabel(f"{space.names[i]} [{space.units[i]}]")
    axes.set_ylabel(f"{space.names[j]} [{space.units[j]}]")
    axes.grid(alpha=0.3)
    figure.suptitle(f"{title} · run 0")
    _legend_below(figure, axes, columns=3)
    return figure


def ellipses(mean: Array, cov: Array, sigmas: float = 3.0) -> Array:
    """Outlines (2, 60, N) of the covariance ellipses of means (2, N) and covariances (2, 2, N)."""
    from estlab.maths.linalg import cholesky

    around = np.linspace(0.0, 2.0 * np.pi, 60)
    circle = sigmas * np.stack([np.cos(around), np.sin(around)])
    return np.asarray(mean[:, None] + np.einsum("ikn,kp->ipn", cholesky(cov), circle))


def _figure(rows: int, title: str, height: float) -> tuple["Figure", list["Axes"]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, height * rows + 1.0), layout="constrained")
    panels = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    for axes in panels:
        axes.grid(alpha=0.3)
    figure.suptitle(title)
    return figure, list(panels)


def _legend_below(figure: "Figure", axes: "Axes", columns: int = 4) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False, fontsize="small")


def _logarithmic(axes: "Axes", low: float, high: float) -> None:
    """A logarithmic scale whose ticks are plain numbers, closer together where it spans little."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set_yscale("log")
    axes.set_ylim(low, high)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high / low < 300.0 else (1.0,), numticks=20))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _limit(axes: "Axes", rows: "DataFrame") -> None:
    """A scale on which the settled part is seen: an opening ten times as uncertain may leave the panel."""
    settled = 1.25 * max(
        float(np.nanquantile(rows["upper3"], 0.9)), float(np.nanquantile(rows["error"].abs(), 0.99)), 1e-12
    )
    if np.isfinite(settled):
        axes.set_ylim(-settled, settled)


def _save(save: Save, name: str, figure: "Figure") -> None:
    save(f"{rundir.PLOTS}/{name}", lambda stream: figure.savefig(stream, format="png", dpi=110))
