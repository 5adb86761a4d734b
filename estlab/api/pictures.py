"""The pictures of a run as matplotlib figures, drawn from its tables and arrays."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from estlab import rundir
from estlab.api.run_sources import Source
from estlab.config.build import nearest
from estlab.errors import UserError
from estlab.experiment.monte_carlo import history_of
from estlab.report import plots
from estlab.report.figures import png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_TABLES = (rundir.ERRORS, rundir.NEES, rundir.NIS, rundir.NOTES)


def names(source: Source) -> tuple[str, ...]:
    """The names of the pictures of a run."""
    return tuple(_makers(source))


def drawn(source: Source, name: str) -> "Figure":
    """A picture by its name, which a notebook shows whether or not pyplot is imported.

    Raises UserError for one that the run does not have.
    """
    makers = _makers(source)
    if name not in makers:
        listed = f"one of {', '.join(makers)}" if makers else "a run of a single step has none"
        raise UserError(f"there is no figure {name}{nearest(name, list(makers))} ({listed})")
    with np.errstate(all="ignore"):
        figure = makers[name]()
    figure._repr_png_ = partial(png, figure)  # type: ignore[attr-defined]
    return figure


def _makers(source: Source) -> dict[str, Callable[[], "Figure"]]:
    """What draws each picture, by its name."""
    scenario, arrays, filters = source.settings.scenario, source.arrays(), list(source.filters)
    histories = {name: history_of(arrays, name, len(filters)) for name in filters}

    def draw(axes: "Axes", name: str, place: int) -> None:
        scenario.draw(axes, history_of(arrays, name, len(filters), place))

    found = plots.pictures(
        _tables(source),
        arrays,
        filters,
        scenario.space,
        source.title,
        source.settings.run_numbers,
        _is_repeated(arrays),
        draw,
    )
    own = scenario.pictures(histories)
    makers: dict[str, Callable[[], Figure]] = {**found, **{name: partial(_same, own[name]) for name in own}}
    return {name.removesuffix(".png"): make for name, make in makers.items()}


def _same(figure: "Figure") -> "Figure":
    return figure


def _is_repeated(arrays: dict[str, Any]) -> bool:
    """Whether all runs are of one recording."""
    truth, values = arrays["truth"], arrays["values"]
    return all(np.array_equal(one, np.broadcast_to(one[..., :1], one.shape), equal_nan=True) for one in (truth, values))


def _tables(source: Source) -> dict[str, dict[str, Any]]:
    """By file and filter: columns of what goes over time, rows of histograms."""
    found: dict[str, dict[str, Any]] = {}
    for file in _TABLES:
        found[file] = {
            str(name): {str(column): lines[column].to_numpy() for column in lines}
            for name, lines in source.table(file).groupby("filter", sort=False)
        }
    histograms = source.table(rundir.HISTOGRAMS).groupby("filter", sort=False)
    found[rundir.HISTOGRAMS] = {str(name): lines.to_dict("records") for name, lines in histograms}
    return found
