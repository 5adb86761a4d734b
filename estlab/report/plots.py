"""The pictures of a run: which there are, and what draws each."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from estlab import rundir
from estlab.maths.space import Array, Space
from estlab.report.clouds import clouds_of, draw_clouds, draw_repeats
from estlab.report.components import MOST, draw_components
from estlab.report.distribution import draw_distribution
from estlab.report.over_time import consistency_of, draw_consistency, draw_errors, draw_ess, noted
from estlab.report.trajectories import draw_trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MANY = 20  # runs from which their distribution has a shape

Draw = Callable[["Axes", str, int], None]
Make = Callable[[], "Figure"]


def pictures(
    tables: Mapping[str, Mapping[str, Any]],
    arrays: dict[str, Array],
    filters: Sequence[str],
    space: Space,
    title: str,
    runs: range,
    repeated: bool,
    draw: Draw,
) -> dict[str, Make]:
    """What draws each picture that the run has, by its name. A single step has none.

    tables: what is written of each filter, by file, as far as there is any. arrays: those of estimates.npz. repeated:
    whether all runs are of one recording. draw: adds the problem's own things to a picture of the plane, of a filter
    in the run that is at this place among those kept.
    """
    if arrays["time"].size < 2:
        return {}
    found: dict[str, Make] = {}
    errors, histograms = tables.get(rundir.ERRORS), tables.get(rundir.HISTOGRAMS)
    if errors:
        found["errors.png"] = lambda: draw_errors(errors, space, title, runs)
        if space.size > MOST:
            found["components.png"] = lambda: draw_components(errors, space, title)
    for file, column in ((rundir.NEES, "anees"), (rundir.NIS, "anis")):
        if shown := consistency_of(tables.get(file, {}), column):
            found[f"{column[1:]}.png"] = partial(draw_consistency, shown, column, title, runs)
    sizes = {name: noted(one, "ess") for name, one in tables.get(rundir.NOTES, {}).items() if "ess" in one["note"]}
    if sizes:
        found["ess.png"] = lambda: draw_ess(sizes, title, runs)
    if histograms and any(histograms.values()) and len(runs) >= _MANY:
        found["distribution.png"] = lambda: draw_distribution(histograms, space, title)
    if space.position:
        found["trajectory.png"] = lambda: draw_trajectory(
            arrays, filters, space, title, lambda axes, name: draw(axes, name, 0)
        )
    if repeated and arrays["run"].size > 1:
        found["repeats.png"] = lambda: draw_repeats(arrays, filters, space, title)
    if len(space.position) >= 2:
        for name in clouds_of(arrays, filters):
            picture = f"cloud_{name}.png" if len(filters) > 1 else "cloud.png"
            found[picture] = partial(draw_clouds, arrays, name, filters, space, title, draw)
    return found
