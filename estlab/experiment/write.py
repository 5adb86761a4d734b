"""The result of an experiment into a run directory: arrays and tables first, then pictures."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from estlab import rundir
from estlab.experiment.result import Result
from estlab.report import csv_tables, plots
from estlab.report.figures import png
from estlab.rundir import RunDirectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def write(result: Result, directory: RunDirectory) -> None:
    """Write every file of a result. What cannot be written is added to what is missing, and loses nothing else.

    Raises OSError for a disk that cannot be written.
    """
    attempts = result.attempts

    def put(name: str, write: Callable[[BinaryIO], object], needed: bool = False) -> None:
        attempts.put(name, partial(directory.write, name, write), needed)

    put(rundir.ESTIMATES, lambda stream: np.savez(stream, allow_pickle=False, **result.arrays), needed=True)
    for file in result.tables:
        put(file, partial(_write_table, result, file), needed=file == rundir.METRICS)
    if result.settings.plots:
        for name, make in _pictures(result).items():
            if content := attempts.made(name, partial(_drawn, make)):
                put(name, partial(_write_bytes, content))


def _write_table(result: Result, file: str, stream: BinaryIO) -> None:
    csv_tables.write(result.table(file), stream)


def _write_bytes(content: bytes, stream: BinaryIO) -> None:
    stream.write(content)


def _pictures(result: Result) -> dict[str, plots.Make]:
    """What draws each picture, the problem's own last, by its file."""
    attempts, scenario = result.attempts, result.settings.scenario

    def draw(axes: "Axes", name: str, place: int) -> None:
        attempts.made("what the problem adds to pictures", lambda: result.add_to_picture(axes, name, place))

    found = plots.pictures(result.plot_data(draw))
    own = attempts.made("the problem's own pictures", lambda: scenario.pictures(result.histories)) or {}
    found |= {name: partial(_same, figure) for name, figure in own.items()}
    return {f"{rundir.PLOTS}/{name}": make for name, make in found.items()}


def _same(figure: "Figure") -> "Figure":
    return figure


def _drawn(make: plots.Make) -> bytes | None:
    figure = make()
    return None if figure is None else png(figure)
