"""A particle filter's cloud at six moments of its best and worst run; the runs over one recording side by side."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from estlab.maths.space import Array, Space
from estlab.report.figures import (
    WIDTH,
    cornered,
    drawable,
    escaped,
    headed,
    labelled,
    legend_below,
    line,
    named,
    new_figure,
    short,
)
from estlab.report.palette import TRUTH, colours
from estlab.report.trajectories import path_of, within

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FILTERS = 4  # repeats that are shown

Draw = Callable[["Axes", str, int], None]


def clouds_of(arrays: dict[str, Array], filters: Sequence[str]) -> list[str]:
    """The filters that have a cloud."""
    return [name for name in filters if _key(name, filters, "cloud.points") in arrays]


def draw_clouds(
    arrays: dict[str, Array], name: str, filters: Sequence[str], space: Space, title: str, draw: Draw
) -> "Figure":
    """The cloud in the plane at six moments, for the best and the worst of the kept runs by RMSE of the position.

    A particle's area is its share of the weight. The picture shows why a cluster in a wrong place persists: no
    reading distinguishes it from the right one.
    """
    from matplotlib.figure import Figure

    at = list(space.position[:2])
    steps = arrays[_key(name, filters, "cloud.step")]
    points, weights = (arrays[_key(name, filters, f"cloud.{part}")] for part in ("points", "weights"))
    error = _position_rmse(arrays, name, filters, space)[: points.shape[-1]]
    rows = _best_and_worst(error)
    across = (len(steps) + 1) // 2
    figure = Figure(figsize=(WIDTH, 0.9 + 4.9 * len(rows)), layout="constrained")
    headed(figure, f"{title} · the cloud of {name}, areas as weights")
    parts = figure.subfigures(len(rows), 1, squeeze=False)[:, 0]
    for part, (place, what) in zip(parts, rows.items(), strict=True):
        known = f", RMSE {error[place]:.3g} {space.units[at[0]]}" if np.isfinite(error[place]) else ""
        part.suptitle(escaped(f"run {arrays['run'][place]}, {what} of {error.size} kept{known}"), fontsize="medium")
        panels = part.subplots(2, across, sharex=True, sharey=True, squeeze=False).ravel()
        truth = drawable(arrays["truth"][at, :, place])
        mean = drawable(path_of(arrays, name, filters, "mean")[at, :, place])
        around: list[Array] = []
        for k, axes in enumerate(panels[: len(steps)]):
            draw(axes, name, place)
            around = [*around, axes.dataLim.get_points().T] if k == 0 else around
            _draw_cloud(axes, points[at][:, k, :, place], weights[k, :, place], colours(filters)[name])
            axes.plot(*truth[:, steps[k]], "o", color="C3", ms=9, mfc="none", mew=1.8, label="truth")
            axes.plot(*mean[:, steps[k]], "x", color=TRUTH, ms=7, mew=1.8, label="estimate")
            axes.set_title(f"{arrays['time'][steps[k]]:.4g} s", fontsize="medium")
            axes.set_aspect("equal")
        for axes in panels[len(steps) :]:
            axes.set_axis_off()
        for axes in panels[::across]:
            axes.set_ylabel(labelled(space.names[at[1]], space.units[at[1]], 12))
        for axes in panels[-across:]:
            axes.set_xlabel(labelled(space.names[at[0]], space.units[at[0]], 20))
        _frame(panels[0], [*around, truth], mean[:, steps], points[at][..., place].reshape(2, -1))
        for k, axes in enumerate(panels[: len(steps)]):
            cornered(axes, "" if _is_seen(axes, mean[:, steps[k]]) else "the estimate is outside the panel")
    legend_below(figure, figure.subfigs[0].axes[0])
    return figure


def _draw_cloud(axes: "Axes", points: Array, weights: Array, colour: str) -> None:
    share = np.nan_to_num(weights) * weights.size
    size = np.clip(6.0 * share, 0.3, 120.0)
    axes.scatter(drawable(points[0]), drawable(points[1]), s=size, color=colour, alpha=0.45, lw=0, zorder=2.5)
    axes.scatter([], [], s=25.0, color=colour, alpha=0.45, lw=0, label="particles")


def _is_seen(axes: "Axes", place: Array) -> bool:
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    return bool(left <= place[0] <= right and low <= place[1] <= high)


def _frame(axes: "Axes", around: Sequence[Array], estimates: Array, cloud: Array) -> None:
    """Limits around the problem's own drawing, the truth and nearby estimates; otherwise around most of the cloud."""
    places = np.concatenate(around, axis=1)
    places = places[:, np.isfinite(places).all(axis=0)]
    if places.shape[1] < 2 or np.ptp(places, axis=1).max() <= 0.0:
        known = cloud[:, np.isfinite(cloud).all(axis=0)]
        places = np.quantile(known, [0.01, 0.99], axis=1).T if known.size else places
    else:
        near = within(estimates, np.stack([places.min(axis=1), places.max(axis=1)], axis=1))
        places = np.concatenate([places, near[:, np.isfinite(near).all(axis=0)]], axis=1)
    if places.size and (room := 0.08 * float(np.ptp(places, axis=1).max())) > 0.0:
        axes.set_xlim(places[0].min() - room, places[0].max() + room)
        axes.set_ylim(places[1].min() - room, places[1].max() + room)


def _best_and_worst(error: Array) -> dict[int, str]:
    """The places of the best and the worst run, with their labels; one alone, or the first if no error is known."""
    known = np.flatnonzero(np.isfinite(error))
    if known.size < 2:
        return {int(known[0]) if known.size else 0: "the one" if error.size == 1 else "the first"}
    order = known[np.argsort(error[known], kind="stable")]
    return {int(order[0]): "the best", int(order[-1]): "the worst"}


def draw_repeats(arrays: dict[str, Array], filters: Sequence[str], space: Space, title: str) -> "Figure":
    """Every kept run over one recording: paths, or the first component, and the distance of each from the truth.

    If the truth is unknown, the distance from the mean of the runs. One row per filter.
    """
    drawn = list(filters[:_FILTERS])
    count = arrays["run"].size
    figure, panels = new_figure(len(drawn), f"{title} · {count} runs over one recording", 3.4, columns=2, shared=False)
    at = list(space.position[:2]) or [0]
    truth = drawable(arrays["truth"][..., :1])
    for row, name in enumerate(drawn):
        colour = colours(filters)[name]
        left, right = panels[2 * row : 2 * row + 2]
        mean = drawable(path_of(arrays, name, filters, "mean"))
        _draw_paths(left, arrays["time"], truth[at, :, 0], mean[at], colour, name)
        off, from_what = _distances(mean, truth, list(space.position) or [0], space)
        for run in range(off.shape[1]):
            line(right, {"time": arrays["time"], "off": off[:, run]}, "off", color=colour, lw=0.8, alpha=0.5)
        right.set_ylim(bottom=0.0)
        right.set_xlabel("time [s]")
        right.set_ylabel(labelled(f"distance from {from_what}", space.units[at[0]]))
        if len(at) == 2:
            left.set_xlabel(labelled(space.names[at[0]], space.units[at[0]]))
            named(left, space.names[at[1]], space.units[at[1]])
        else:
            left.set_xlabel("time [s]")
            named(left, space.names[at[0]], space.units[at[0]])
    legend_below(figure, panels[0])
    return figure


def _draw_paths(axes: "Axes", time: Array, truth: Array, mean: Array, colour: str, name: str) -> None:
    """Paths (2, T, runs) in the plane, or one component (1, T, runs) over time."""
    path = (lambda place: place) if len(mean) == 2 else (lambda place: (time, place[0]))
    if np.isfinite(truth).any():
        axes.plot(*path(truth), color=TRUTH, lw=1.6, label="truth", zorder=3)
        mean = within(mean, axes.dataLim.get_points().T) if len(mean) == 2 else mean
    for run in range(mean.shape[2]):
        label = short(f"{name}, {mean.shape[2]} runs") if run == 0 else None
        axes.plot(*path(mean[:, :, run]), color=colour, lw=0.8, alpha=0.5, label=label)


def _distances(mean: Array, truth: Array, at: list[int], space: Space) -> tuple[Array, str]:
    """Each run's distance (T, runs) from the truth in some components, or from the runs' mean; and from which."""
    known = np.isfinite(truth[at]).all(axis=0).any()
    about = truth if known else np.where(np.isfinite(mean), mean, 0.0).mean(axis=-1, keepdims=True)
    off = space.minus(mean, np.broadcast_to(about, mean.shape))[at]
    return np.sqrt((off**2).sum(axis=0)), "the truth" if known else "the runs' mean"


def _position_rmse(arrays: dict[str, Array], name: str, filters: Sequence[str], space: Space) -> Array:
    """(runs,) over known values; infinite for a run that is not finite somewhere, NaN without truth."""
    at = list(space.position)
    mean, truth = path_of(arrays, name, filters, "mean")[at], arrays["truth"][at]
    known = np.isfinite(truth).all(axis=0)
    square = np.where(known, ((drawable(mean) - np.where(known, truth, 0.0)) ** 2).sum(axis=0), 0.0)
    count = known.sum(axis=0)
    return np.sqrt(square.sum(axis=0) / np.where(count > 0, count, np.nan))


def _key(name: str, filters: Sequence[str], key: str) -> str:
    return f"{name}.{key}" if len(filters) > 1 else key
