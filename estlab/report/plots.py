"""The pictures of a run: a function for each, which draws it or returns None if the run has none."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from estlab import rundir
from estlab.maths.space import Array, Space
from estlab.report.clouds import clouds_of, draw_clouds, draw_repeats
from estlab.report.components import MOST, draw_components
from estlab.report.distribution import draw_distribution
from estlab.report.over_time import consistency_of, draw_consistency, draw_errors, draw_ess, noted
from estlab.report.palette import colours
from estlab.report.trajectories import draw_trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MANY = 20  # runs from which their distribution has a shape

Draw = Callable[["Axes", str, int], None]
Make = Callable[[], "Figure | None"]


@dataclass(frozen=True)
class PlotData:
    """The data for a run's pictures.

    tables: by file and filter, as far as they exist. arrays: those of estimates.npz. repeated: whether all runs share
    one recording. draw: adds the problem's own drawing to a picture of the plane, for a filter in the run at this
    place among those kept.
    """

    tables: Mapping[str, Mapping[str, Any]]
    arrays: dict[str, Array]
    filters: Sequence[str]
    space: Space
    title: str
    runs: range
    repeated: bool
    draw: Draw

    @property
    def colours(self) -> dict[str, str]:
        """One for each filter."""
        return colours(self.filters)


_PICTURES: dict[str, Callable[[PlotData], "Figure | None"]] = {}
_OF_EACH_FILTER: dict[str, Callable[[PlotData, str], "Figure | None"]] = {}


def picture(draw: Callable[[PlotData], "Figure | None"]) -> Callable[[PlotData], "Figure | None"]:
    """Declare a picture; its file has the function's name. If it returns None, the run has none."""
    _PICTURES[draw.__name__] = draw
    return draw


def picture_of_filter(draw: Callable[[PlotData, str], "Figure | None"]) -> Callable[[PlotData, str], "Figure | None"]:
    """The same for each filter; with several filters, the file's name ends with the filter's."""
    _OF_EACH_FILTER[draw.__name__] = draw
    return draw


def pictures(data: PlotData) -> dict[str, Make]:
    """The function that draws each picture, by its file's name; it may return None. A run of one step has none."""
    if data.arrays["time"].size < 2:
        return {}
    found: dict[str, Make] = {f"{name}.png": partial(draw, data) for name, draw in _PICTURES.items()}
    for name, draw in _OF_EACH_FILTER.items():
        for filter in data.filters:
            ending = f"_{filter}" if len(data.filters) > 1 else ""
            found[f"{name}{ending}.png"] = partial(draw, data, filter)
    return found


@picture
def errors(data: PlotData) -> "Figure | None":
    table = data.tables.get(rundir.ERRORS)
    return draw_errors(table, data.space, data.title, data.runs, data.colours) if table else None


@picture
def components(data: PlotData) -> "Figure | None":
    table = data.tables.get(rundir.ERRORS)
    if not table or data.space.size <= MOST:
        return None
    return draw_components(table, data.space, data.title, data.colours)


@picture
def nees(data: PlotData) -> "Figure | None":
    return _consistency(data, rundir.NEES, "anees")


@picture
def nis(data: PlotData) -> "Figure | None":
    return _consistency(data, rundir.NIS, "anis")


def _consistency(data: PlotData, file: str, column: str) -> "Figure | None":
    table = consistency_of(data.tables.get(file, {}), column)
    return draw_consistency(table, column, data.title, data.runs, data.colours) if table else None


@picture
def ess(data: PlotData) -> "Figure | None":
    notes = data.tables.get(rundir.NOTES, {})
    sizes = {name: noted(one, "ess") for name, one in notes.items() if np.any(one["note"] == "ess")}
    return draw_ess(sizes, data.title, data.runs, data.colours) if sizes else None


@picture
def distribution(data: PlotData) -> "Figure | None":
    table = data.tables.get(rundir.HISTOGRAMS)
    if not table or not any(table.values()) or len(data.runs) < _MANY:
        return None
    return draw_distribution(table, data.space, data.title, data.colours)


@picture
def trajectory(data: PlotData) -> "Figure | None":
    if not data.space.position:
        return None
    return draw_trajectory(
        data.arrays, data.filters, data.space, data.title, lambda axes, name: data.draw(axes, name, 0)
    )


@picture
def repeats(data: PlotData) -> "Figure | None":
    several = data.repeated and data.arrays["run"].size > 1
    return draw_repeats(data.arrays, data.filters, data.space, data.title) if several else None


@picture_of_filter
def cloud(data: PlotData, filter: str) -> "Figure | None":
    if len(data.space.position) < 2 or filter not in clouds_of(data.arrays, data.filters):
        return None
    return draw_clouds(data.arrays, filter, data.filters, data.space, data.title, data.draw)
