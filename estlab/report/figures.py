"""What all pictures share: figures with panels, legends, axes, lines of many points, and output to files."""

import io
import textwrap
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from estlab.errors import printable
from estlab.maths.space import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

WIDTH = 9.0  # inches
_DPI = 110
_COMPRESSION = 3  # a tenth larger than the usual 6, in two thirds of the time
_BUCKETS = 1500  # points of a line, more than a picture has columns of pixels
_LABEL = 60  # letters of a name that fit in a legend


def new_figure(
    rows: int, title: str, height: float, columns: int = 1, shared: bool = True
) -> tuple["Figure", list["Axes"]]:
    """A figure with panels of a given height [inches]; the panels of a single column may share one time axis."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, height * rows + 1.0), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=shared and columns == 1, squeeze=False).ravel()
    for axes in panels:
        axes.grid(alpha=0.3)
    headed(figure, title)
    return figure, list(panels)


def escaped(text: str) -> str:
    """A name as drawn: a dollar starts no formula, and an invisible character is no glyph."""
    return printable(text).replace("$", r"\$")


def short(text: str, most: int = _LABEL) -> str:
    """A name shortened for little space; matplotlib leaves out a label that begins with an underscore."""
    text = " ".join(printable(text).split())
    text = text if len(text) <= most else f"{text[: most - 2]} …"
    return escaped(f" {text}" if text.startswith("_") else text)


def headed(figure: "Figure", title: str) -> None:
    """A title over all panels, in as many lines as it needs."""
    lines = textwrap.wrap(printable(title), 90, max_lines=6, placeholder=" …")
    figure.suptitle("\n".join(map(escaped, lines)), fontsize="large")


def labelled(name: str, unit: str, letters: int = 40, lines: int = 1) -> str:
    """A quantity and its unit as an axis label, broken into lines of so many letters."""
    parts = textwrap.wrap(printable(name), letters, max_lines=lines, placeholder=" …")
    return "\n".join(map(escaped, parts)) + (f" [{escaped(unit)}]" if unit else "")


def named(axes: "Axes", name: str, unit: str) -> None:
    """The name and unit of a panel's component, in as many lines as the panel has room for."""
    axes.set_ylabel(labelled(name, unit, 20, 2))


def legend_below(figure: "Figure", axes: "Axes") -> None:
    """A legend below the panels, in as many columns as its longest entry allows."""
    handles, labels = axes.get_legend_handles_labels()
    columns = max(1, int(14.0 * WIDTH / (max(map(len, labels), default=1) + 8)))
    figure.legend(handles, labels, loc="outside lower center", ncols=min(columns, 5), frameon=False, fontsize="small")


def cornered(axes: "Axes", text: str) -> None:
    """A line in small letters in the upper left corner of a panel; nothing without text."""
    if text:
        style: dict[str, Any] = {"ha": "left", "va": "top", "fontsize": "x-small", "zorder": 9}
        box = {"facecolor": "white", "alpha": 0.7, "lw": 0, "pad": 1.5}
        axes.text(0.01, 0.96, escaped(text), transform=axes.transAxes, bbox=box, **style)


def logarithmic(axis: "Axis", low: float, high: float) -> None:
    """Ticks of a logarithmic axis as plain numbers, denser on a short axis."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    span = high / low
    subs = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if span < 10.0 else (1.0, 2.0, 5.0) if span < 300.0 else (1.0,)
    axis.set_major_locator(LogLocator(subs=subs, numticks=20))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def within_reach(sizes: Mapping[str, float], times: float) -> tuple[float, list[str]]:
    """The largest of the sizes that determine a scale, and the names of those beyond it.

    A filter that is many times as far off as the best would flatten all others. NaN if no size is known.
    """
    known = {name: size for name, size in sizes.items() if np.isfinite(size) and size > 0.0}
    if not known:
        return np.nan, []
    reach = times * min(known.values())
    gone = [name for name, size in sizes.items() if not size <= reach and not np.isnan(size)]
    return max(size for size in known.values() if size <= reach), gone


def broken_at_gaps(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Columns with an empty entry wherever their time jumps by many steps, so that no line crosses a gap."""
    time = columns["time"]
    lapse = np.diff(time)
    gaps = np.flatnonzero(lapse > 10.0 * np.median(lapse)) if lapse.size else np.empty(0, dtype=int)
    middle = 0.5 * (time[gaps] + time[gaps + 1]) if gaps.size else np.empty(0)
    return {
        name: np.insert(np.asarray(column, dtype=float), gaps + 1, middle if name == "time" else np.nan)
        for name, column in columns.items()
    }


def telling(values: Array) -> Array:
    """Which of the values over time (T,) are needed for the same line, if a pixel contains many.

    From each bucket the smallest, the largest, and the first missing one, so that gaps remain.
    """
    size = -(-values.size // _BUCKETS)
    if size < 4:
        return np.arange(values.size)
    padded = np.full(size * _BUCKETS, np.nan)
    padded[: values.size] = values
    buckets = padded.reshape(_BUCKETS, size)
    missing = np.isnan(buckets)
    least = np.where(missing, np.inf, buckets).argmin(axis=1)
    greatest = np.where(missing, -np.inf, buckets).argmax(axis=1)
    chosen = np.stack([least, greatest, missing.argmax(axis=1)]) + size * np.arange(_BUCKETS)
    chosen = np.unique(chosen)
    return chosen[chosen < values.size]


def line(axes: "Axes", columns: Mapping[str, Array], key: str, **style: Any) -> None:
    """A column over time, with as many points as are visible."""
    kept = telling(columns[key])
    axes.plot(columns["time"][kept], drawable(columns[key][kept]), **style)


def drawable(values: Array) -> Array:
    """The same values, with NaN where a number is too large for a picture's coordinates."""
    values = np.asarray(values, dtype=float)
    return np.where(np.abs(values) < 1e100, values, np.nan)


def png(figure: "Figure") -> bytes:
    """A figure as a PNG file, drawn once: savefig draws twice for the layout."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure.set_dpi(_DPI)
    canvas = FigureCanvasAgg(figure)
    options: dict[str, Any] = {"compress_level": _COMPRESSION}
    stream = io.BytesIO()
    with boxes_for_letters():
        canvas.print_png(stream, pil_kwargs=options)
    return stream.getvalue()


@contextmanager
def boxes_for_letters() -> Iterator[None]:
    """Draw a name in letters that the font lacks as boxes, without a warning: every table has the name itself."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        yield
