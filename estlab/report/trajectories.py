"""The path of a run: in the plane, over time for a position of one component, in two views for one of three."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from estlab.maths.gaussian_belief import ellipses
from estlab.maths.space import Array, Space
from estlab.report.figures import WIDTH, drawable, headed, labelled, legend_below, short
from estlab.report.palette import BAND, TRUTH, colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Draw = Callable[["Axes", str], None]
_ELLIPSES = 15  # along a path


def draw_trajectory(arrays: dict[str, Array], filters: Sequence[str], space: Space, title: str, draw: Draw) -> "Figure":
    """The path of the first run: truth, estimates, 3-sigma ellipses along them, and the problem's own drawing.

    If the position has more than three components, the first three are shown.
    """
    from matplotlib.figure import Figure

    at = list(space.position[:3])
    figure = Figure(layout="constrained")
    headed(figure, f"{title} · run {arrays['run'][0]}")
    if len(at) == 1:
        axes = figure.add_subplot()
        draw(axes, filters[0])
        _draw_line(axes, arrays, filters, at[0])
        axes.set_xlabel("time [s]")
        axes.set_ylabel(labelled(space.names[at[0]], space.units[at[0]]))
        figure.set_size_inches(WIDTH, 4.6)
    else:
        views = [(at[0], at[other]) for other in range(1, len(at))]
        panels = figure.subplots(1, len(views), squeeze=False)[0]
        draw(panels[0], filters[0])
        shapes = [_draw_view(axes, arrays, filters, view) for axes, view in zip(panels, views, strict=True)]
        for axes, view in zip(panels, views, strict=True):
            axes.set_xlabel(labelled(space.names[view[0]], space.units[view[0]]))
            axes.set_ylabel(labelled(space.names[view[1]], space.units[view[1]]))
        height = 1.6 + WIDTH * float(np.clip(1.1 * shapes[0], 0.35, 1.0)) if len(views) == 1 else 5.4
        figure.set_size_inches(WIDTH, height)
    for axes in figure.axes:
        axes.grid(alpha=0.3)
    legend_below(figure, figure.axes[0])
    return figure


def path_of(arrays: dict[str, Array], name: str, filters: Sequence[str], key: str) -> Array:
    """The mean (n, T, runs) or cov (n, n, T, runs) of one of the filters, from the arrays of estimates.npz."""
    return arrays[f"{name}.{key}" if len(filters) > 1 else key]


def _draw_line(axes: "Axes", arrays: dict[str, Array], filters: Sequence[str], i: int) -> None:
    """A position of one component over time, with +-3 sigma about each estimate."""
    time, truth = arrays["time"], drawable(arrays["truth"][i, :, 0])
    if np.isfinite(truth).any():
        axes.plot(time, truth, color=TRUTH, lw=1.6, label="truth")
    seen = axes.dataLim.get_points().T[1].copy()
    for name, colour in colours(filters).items():
        mean = drawable(path_of(arrays, name, filters, "mean")[i, :, 0])
        wide = 3.0 * np.sqrt(np.maximum(drawable(path_of(arrays, name, filters, "cov")[i, i, :, 0]), 0.0))
        axes.plot(time, mean, color=colour, lw=1.1, label=short(name) if len(filters) > 1 else "estimate")
        label = "±3 sigma" if len(filters) == 1 else None
        axes.fill_between(time, mean - wide, mean + wide, color=colour, alpha=0.15, lw=0, label=label)
    # Truth and readings determine the scale: neither a diverging filter nor its uncertainty may shrink the picture.
    if np.isfinite(seen).all() and seen[1] > seen[0]:
        room = 0.25 * (seen[1] - seen[0])
        axes.set_ylim(seen[0] - room, seen[1] + room)


def _draw_view(axes: "Axes", arrays: dict[str, Array], filters: Sequence[str], at: tuple[int, int]) -> float:
    """A path in a plane; its height over its width."""
    pair = list(at)
    truth = drawable(arrays["truth"][pair, :, 0])
    if np.isfinite(truth).any():
        axes.plot(*truth, color=TRUTH, lw=1.6, label="truth")
    steps = np.unique(np.linspace(0, arrays["time"].size - 1, _ELLIPSES).astype(int))
    # Truth and readings determine the scale: neither a diverging filter nor its uncertainty may shrink the picture.
    box = axes.dataLim.get_points().T.copy()  # the limits at this moment: they move with what is drawn
    several = len(filters) > 1
    for name, colour in colours(filters).items():
        path = drawable(path_of(arrays, name, filters, "mean")[pair, :, 0])
        path = within(path, box) if np.isfinite(box).all() else path
        axes.plot(*path, color=colour, lw=1.1, label=short(name) if several else "estimate")
    low, high = axes.dataLim.get_points().copy()
    size = float((high - low).max()) if np.isfinite([low, high]).all() else 0.0
    left_out = 0
    for name, colour in colours(filters).items():
        mean = path_of(arrays, name, filters, "mean")[pair][:, steps, 0]
        cov = path_of(arrays, name, filters, "cov")[pair][:, pair][:, :, steps, 0]
        # An ellipse larger than the picture, such as a prior over the whole map, would hide everything else.
        known = np.isfinite(mean).all(axis=0) & np.isfinite(cov).all(axis=(0, 1))
        fits = np.maximum(cov[0, 0], cov[1, 1]) <= (size / 6.0) ** 2
        left_out += int((known & ~fits).sum())
        outline = ellipses(mean[:, known & fits], cov[..., known & fits])
        axes.plot(*outline, color=colour if several else BAND, lw=0.8, ls=":" if several else "-")
    label = "3 sigma of the position" + (f" ({left_out} too large to draw)" if left_out else "")
    axes.plot([], [], color="0.4" if several else BAND, lw=0.8, label=label)
    known_truth = np.flatnonzero(np.isfinite(truth).all(axis=0))
    if known_truth.size:
        axes.plot(*truth[:, known_truth[0]], "o", color=TRUTH, mfc="white", ms=7, label="start of the truth")
    if size > 0.0:
        margin = 0.08 * size
        axes.set_xlim(low[0] - margin, high[0] + margin)
        axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_aspect("equal")
    return float((high - low)[1] / (high - low)[0]) if size > 0.0 and high[0] > low[0] else 1.0


def within(place: Array, box: Array) -> Array:
    """A path (2, ...) where it is in a box (2, 2) of smallest and largest values, enlarged by half; NaN elsewhere."""
    shape = (2, *[1] * (place.ndim - 1))
    low, high = box[:, 0].reshape(shape), box[:, 1].reshape(shape)
    room = 0.25 * (high - low).max()
    return np.where(((place >= low - room) & (place <= high + room)).all(axis=0), place, np.nan)
