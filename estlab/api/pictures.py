"""The pictures of a run as matplotlib figures, drawn from its tables and arrays."""

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
    return tuple(name for name, make in _makers(source).items() if _made(make) is not None)


def drawn(source: Source, name: str) -> "Figure":
    """A picture by its name, which a notebook shows whether or not pyplot is imported.

    Raises UserError for one that the run does not have.
    """
    makers = _makers(source)
    figure = _made(makers[name]) if name in makers else None
    if figure is None:
        known = names(source)
        listed = f"one of {', '.join(known)}" if known else "a run of a single step has none"
        raise UserError(f"there is no figure {name}{nearest(name, known)} ({listed})")
    figure._repr_png_ = partial(png, figure)  # type: ignore[attr-defined]
    return figure


@np.errstate(all="ignore")
def _made(make: plots.Make) -> "Figure | None":
    return make()


def _makers(source: Source) -> dict[str, plots.Make]:
    """What draws each picture that a run may have, by its name."""
    scenario, arrays, filters = source.settings.scenario, source.arrays(), list(source.filters)
    histories = {name: history_of(arrays, name, len(filters)) for name in filters}

    def draw(axes: "Axes", name: str, place: int) -> None:
        scenario.draw(axes, history_of(arrays, name, len(filters), place))

    data = plots.PlotData(
        tables=_tables(source),
        arrays=arrays,
        filters=filters,
        space=scenario.space,
        title=source.title,
        runs=source.settings.run_numbers,
        repeated=_is_repeated(arrays),
        draw=draw,
    )
    own: dict[str, plots.Make] = {name: partial(_same, one) for name, one in scenario.pictures(histories).items()}
    return {name.removesuffix(".png"): make for name, make in {**plots.pictures(data), **own}.items()}


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
