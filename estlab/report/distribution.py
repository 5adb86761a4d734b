"""The distribution over the runs of an ensemble: RMSE and NEES, in one picture."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from estlab.maths.space import Space
from estlab.metrics.vocabulary import heading
from estlab.report.figures import labelled, legend_below, logarithmic, new_figure, short

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Rows = Sequence[Mapping[str, Any]]


def draw_distribution(by_filter: Mapping[str, Rows], space: Space, title: str, colours: Mapping[str, str]) -> "Figure":
    """How many runs have which RMSE, and which mean NEES / n: a second heap is of runs that lost their way.

    Of what is known of any run: of files without truth there is neither.
    """
    chosen = "position" if space.position else space.names[0]
    unit = space.units[space.position[0] if space.position else 0]
    panels = {
        labelled(f"{heading('rmse')} of a run, {chosen}", unit, 60): _bins(by_filter, "rmse", chosen),
        f"{heading('anees')} of a run": _bins(by_filter, "anees", "all"),
    }
    panels = {what: bins for what, bins in panels.items() if any(bins.values())}
    figure, axes = new_figure(1, title, 3.6, columns=max(1, len(panels)))
    for panel, (what, bins) in zip(axes, panels.items(), strict=False):
        _draw(panel, bins, what, colours)
    axes[0].set_ylabel("runs")
    if len(by_filter) > 1:
        legend_below(figure, axes[0])
    return figure


def _bins(by_filter: Mapping[str, Rows], metric: str, component: str) -> dict[str, Rows]:
    return {
        name: [row for row in rows if (row["metric"], row["component"]) == (metric, component)]
        for name, rows in by_filter.items()
    }


def _draw(panel: "Axes", bins: Mapping[str, Rows], what: str, colours: Mapping[str, str]) -> None:
    """Bins on a logarithmic axis, which reaches neither zero nor infinity: runs beyond are counted in its name."""
    from matplotlib.ticker import MaxNLocator

    inside = {name: [row for row in rows if _has_ends(row)] for name, rows in bins.items()}
    for name, mine in inside.items():
        # A line at zero wherever bins without runs were left out.
        counts = {row["low"]: row["runs"] for row in mine}
        edges = np.unique([edge for row in mine for edge in (row["low"], row["high"])])
        heights = [counts.get(edge, 0) for edge in edges[:-1]]
        if mine:
            panel.stairs(heights, edges, color=colours[name], lw=1.3, label=short(name), fill=len(bins) == 1, alpha=0.9)
    every = [row for rows in inside.values() for row in rows]
    if every:
        panel.set_xscale("log")
        logarithmic(panel.xaxis, min(row["low"] for row in every), max(row["high"] for row in every))
    beyond = sum(row["runs"] for rows in bins.values() for row in rows if not _has_ends(row))
    panel.set_xlabel(what + (f"; {beyond} run{'s' * (beyond > 1)} beyond" if beyond else ""))
    panel.yaxis.set_major_locator(MaxNLocator(integer=True))


def _has_ends(row: Mapping[str, Any]) -> bool:
    return row["low"] > 0.0 and bool(np.isfinite(row["high"]))
