"""The picture of a tuning, drawn from its table: the objective of each trial in turn, and over each key."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from estlab.report.figures import escaped, short

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

_WIDTH, _HEIGHT = 3.4, 2.6  # inches of a panel over a key
_ACROSS = 3
_MANY = 12  # words on an axis


def draw(path: Path, keys: "Sequence[str]", objective: str) -> "Figure":
    """A panel of the trials in order with the best so far, and one of the objective over each key.

    path: tuning.csv. Trials without a finite objective are crosses at the top.
    """
    import pandas as pd
    from matplotlib.figure import Figure

    table = pd.read_csv(path)
    table["objective"] = table["objective"].where(table["objective"].abs() < 1e100)
    rows = math.ceil(len(keys) / _ACROSS)
    across = min(_ACROSS, len(keys))
    figure = Figure(figsize=(max(6.0, _WIDTH * across), 0.4 + _HEIGHT * (1 + rows)), layout="constrained")
    grid = figure.add_gridspec(1 + rows, across)
    history = figure.add_subplot(grid[0, :])
    _history(history, table)
    for i, key in enumerate(keys):
        axes = figure.add_subplot(grid[1 + i // _ACROSS, i % _ACROSS], sharey=history)
        _slice(axes, table, key)
        if i % _ACROSS == 0:
            axes.set_ylabel(escaped(objective))
    history.set_ylabel(escaped(objective))
    _scale(history, table)
    return figure


def _history(axes: "Axes", table: "DataFrame") -> None:
    axes.plot(table["trial"], table["objective"], "o", ms=4, color="C0", label="each trial")
    axes.step(table["trial"], table["best"], where="post", lw=1.3, color="C1", label="best so far")
    without = table[table["objective"].isna()]
    if len(without):
        top = axes.get_xaxis_transform()  # in units of the axis' height, whatever the objective
        axes.plot(without["trial"], np.full(len(without), 0.97), "x", color="C3", transform=top, label="failed")
    axes.set_xlabel("trial")
    axes.grid(alpha=0.3, lw=0.5)
    axes.legend(fontsize=8)


def _slice(axes: "Axes", table: "DataFrame", key: str) -> None:
    """The later a trial, the darker its point."""
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

    numeric = table[key].dtype.kind in "if"
    words = [] if numeric else sorted(table[key].astype(str).unique())
    values = table[key] if numeric else table[key].astype(str).map(words.index)
    axes.scatter(values, table["objective"], c=table["trial"], cmap="Blues", vmin=-0.4 * len(table), s=16)
    if table["objective"].notna().any():
        best = int(np.nanargmin(table["objective"]))
        axes.plot(values.iloc[best], table["objective"].iloc[best], "o", ms=8, mfc="none", mec="C1")
    if numeric and values.min() > 0.0 and values.max() >= 10.0 * values.min():
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
        axes.xaxis.set_minor_formatter(NullFormatter())
    if words:
        axes.set_xticks(
            range(len(words)),
            [short(word, 20) for word in words] if len(words) <= _MANY else [""] * len(words),
            rotation=30,
        )
    axes.set_xlabel(escaped(key))
    axes.grid(alpha=0.3, lw=0.5)


def _scale(axes: "Axes", table: "DataFrame") -> None:
    """Logarithmic if a few bad trials would flatten all the good ones."""
    known = table["objective"].dropna()
    if known.min() > 0.0 and known.max() > 30.0 * known.min():
        axes.set_yscale("log")
