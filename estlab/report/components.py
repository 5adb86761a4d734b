"""Which components of a large state are shown, and the RMSE of all of them in one picture."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from estlab.maths.space import Array, Space
from estlab.metrics.vocabulary import heading
from estlab.report.figures import escaped, labelled, legend_below, logarithmic, new_figure, short

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST = 8  # panels, or lines of a table, that a person reads
_NAMED = 40  # panels, or lines of a table, that are readable
_WIDE = 30.0  # components whose names fit on an axis

Columns = Mapping[str, Array]


def chosen(worst: Array, position: Sequence[int] = ()) -> list[int]:
    """All components; of more than a person reads, those of the position and the ones that do worst, in their order.

    worst: (n,) how badly each does, NaN where that is not known.
    """
    if worst.size <= MOST:
        return list(range(worst.size))
    first = list(position[: MOST // 2]) or [0]
    others = [int(i) for i in np.argsort(-np.nan_to_num(worst), kind="stable") if i not in first]
    return sorted([*first, *others[: MOST - len(first)]])


def selection(some: Sequence[int], size: int, what: str = "RMSE over mean sigma") -> str:
    """What is to be said where only some of so many components are shown; empty where all are."""
    note = f"{len(some)} of {size} components are shown, those with the largest {what} among them"
    return note if len(some) < size else ""


def ratios(errors: Mapping[str, Columns], size: int) -> Array:
    """RMSE over mean sigma (n,) of each component over all time, the largest of all filters."""
    found = [root_mean(one, "rmse", size) / positive(root_mean(one, "mean_sigma", size)) for one in errors.values()]
    return np.asarray(np.nan_to_num(found, nan=0.0, posinf=0.0).max(axis=0))


def root_mean(columns: Columns, key: str, size: int) -> Array:
    """The root mean square (n,) over time of a column of errors.csv, of what is finite; NaN where nothing is."""
    values = np.asarray(columns[key], dtype=float).reshape(-1, size)
    known = np.isfinite(values) & (np.abs(values) < 1e150)
    count = known.sum(axis=0)
    total = (np.where(known, values, 0.0) ** 2).sum(axis=0)
    return np.sqrt(total / np.where(count > 0, count, np.nan))


def positive(values: Array) -> Array:
    """The same, NaN for what is not above zero."""
    return np.where(values > 0.0, values, np.nan)


def draw_components(errors: Mapping[str, Columns], space: Space, title: str, colours: Mapping[str, str]) -> "Figure":
    """RMSE and mean sigma of every component over all time and runs, a panel a unit."""
    units = list(dict.fromkeys(space.units))[:MOST]
    figure, panels = new_figure(len(units), title, 2.6, shared=False)
    for axes, unit in zip(panels, units, strict=True):
        mine = [i for i, of in enumerate(space.units) if of == unit]
        at, drawn = np.arange(len(mine)), []
        for name, columns in errors.items():
            for key, style in (("rmse", "o-"), ("mean_sigma", ":")):
                values = root_mean(columns, key, space.size)[mine]
                label = short(heading(key) if len(errors) == 1 else f"{name}, {heading(key)}")
                axes.plot(at, values, style, ms=3, lw=1.0, color=colours[name], label=label)
                drawn.append(values[np.isfinite(values) & (values > 0.0)])
        seen = np.concatenate(drawn)
        if seen.size and seen.max() > _WIDE * seen.min():
            axes.set_yscale("log")
            logarithmic(axes.yaxis, seen.min(), seen.max())
        if len(mine) <= _NAMED:
            names = [short(space.names[i], 14) for i in mine]
            axes.set_xticks(at, names, rotation=90 if len(mine) > MOST else 0, fontsize="small")
        else:
            axes.set_xlabel(
                f"component, by its index among those in {escaped(unit)}" if len(units) > 1 else "component"
            )
        axes.set_ylabel(labelled(heading("rmse"), unit))
    legend_below(figure, panels[0])
    return figure
