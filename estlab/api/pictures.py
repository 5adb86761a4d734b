"""The pictures of a run as matplotlib figures, drawn from its tables and arrays."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from estlab.api.run_sources import Source
from estlab.config.build import nearest
from estlab.errors import UserError
from estlab.experiment.histories import history_of
from estlab.report import plots
from estlab.report.figures import png

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def names(source: Source) -> tuple[str, ...]:
    """The names of the pictures of a run."""
    return tuple(name for name, make in _makers(source).items() if _made(make) is not None)


def drawn(source: Source, name: str) -> "Figure":
    """A picture by its name, which a notebook shows whether or not pyplot is imported.

    Raises UserError for a picture that the run does not have.
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
    """The function that draws each picture that a run may have, by its name."""
    data = source.plot_data()
    histories = {name: history_of(data.arrays, name, data.filters) for name in data.filters}
    own = source.settings.scenario.pictures(histories)
    makers: dict[str, plots.Make] = {**plots.pictures(data), **{name: partial(_same, own[name]) for name in own}}
    return {name.removesuffix(".png"): make for name, make in makers.items()}


def _same(figure: "Figure") -> "Figure":
    return figure
