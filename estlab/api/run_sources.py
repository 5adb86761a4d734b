"""Where a Run gets its tables and arrays: from a directory, or from the memory of this process."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from estlab import rundir
from estlab.api import tables
from estlab.config.build import build
from estlab.config.earlier import completed
from estlab.config.settings import Names, Settings
from estlab.errors import UserError, printable
from estlab.experiment.histories import history_of
from estlab.experiment.result import Result
from estlab.maths.space import Array, Space
from estlab.record import SMOOTHED
from estlab.report import csv_tables
from estlab.report.plots import PlotData
from estlab.rundir import files, finished

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame


class Source(Protocol):
    """The data behind a Run."""

    @property
    def path(self) -> Path | None:
        """The run directory, if there is one."""

    @property
    def scenario(self) -> str:
        """The name of the scenario."""

    @property
    def filters(self) -> tuple[str, ...]:
        """The names of the sets of estimates."""

    @property
    def title(self) -> str:
        """The run in one line."""

    @property
    def facts(self) -> Mapping[str, Any]:
        """The content of run.json."""

    @property
    def status(self) -> Mapping[str, Any]:
        """The content of status.json."""

    @property
    def config(self) -> Mapping[str, Any]:
        """The configuration as plain data."""

    @property
    def settings(self) -> Settings:
        """The same as objects."""

    @property
    def space(self) -> Space:
        """The space of the state."""

    def table(self, file: str) -> "DataFrame":
        """A table by the name of its file, empty if there is none."""

    def own(self) -> "DataFrame":
        """The problem's own table, without lines where it has none."""

    def arrays(self) -> dict[str, Array]:
        """The arrays of estimates.npz."""

    def plot_data(self) -> PlotData:
        """The data for its pictures."""


@dataclass(frozen=True)
class Computed:
    """A result in memory. facts, status: as in run.json and status.json. path: where it is saved, if it is."""

    result: Result
    config: Mapping[str, Any]
    facts: Mapping[str, Any]
    status: Mapping[str, Any]
    path: Path | None = None

    @property
    def scenario(self) -> str:
        return self.result.settings.names.scenario

    @property
    def filters(self) -> tuple[str, ...]:
        return tuple(self.result.filters)

    @property
    def title(self) -> str:
        return printable(self.result.title)

    @property
    def settings(self) -> Settings:
        return self.result.settings

    @property
    def space(self) -> Space:
        return self.settings.scenario.space

    def table(self, file: str) -> "DataFrame":
        return tables.of_columns(file, self.result.table(file) if file in self.result.tables else {})

    def own(self) -> "DataFrame":
        stream = io.BytesIO()
        csv_tables.write(self.result.own, stream)
        return tables.of_text(stream.getvalue().decode() if self.result.own else "row\n")

    def arrays(self) -> dict[str, Array]:
        return self.result.arrays

    def plot_data(self) -> PlotData:
        return self.result.plot_data()


@dataclass(frozen=True)
class Stored:
    """A run directory, read as data. plugins: the reader's packages whose classes it may name."""

    run: finished.Finished
    plugins: Sequence[str] = ()

    @property
    def path(self) -> Path:
        return self.run.path

    @property
    def scenario(self) -> str:
        return self.run.scenario

    @property
    def filters(self) -> tuple[str, ...]:
        endings = ("", SMOOTHED) if self.config.get("smooth") is True else ("",)
        return tuple(name + end for name in self.run.filters for end in endings)

    @property
    def title(self) -> str:
        told = self.facts.get("title")
        return printable(str(told or " · ".join([self.scenario, ", ".join(self.run.filters)])))

    @property
    def facts(self) -> Mapping[str, Any]:
        return self.run.facts

    @property
    def status(self) -> Mapping[str, Any]:
        return self.run.status

    @property
    def config(self) -> Mapping[str, Any]:
        return self.run.config

    def table(self, file: str) -> "DataFrame":
        if file == rundir.METRICS and (why := finished.unfinished(self.status)):
            raise UserError(f"{self.path}: has no complete result ({why})")
        return tables.of_file(self.path, file)

    def own(self) -> "DataFrame":
        file = f"{self.scenario}.csv"
        return tables.of_text(finished.text(self.path, file) if files.has(self.path, file) else "row\n")

    def arrays(self) -> dict[str, Array]:
        return finished.stored(self.path, rundir.ESTIMATES)

    @cached_property
    def settings(self) -> Settings:
        """The configuration as objects, of estlab's own classes and those of the plugins.

        Raises UserError for a class of another package.
        """
        config = dict(self.config) | {"plugins": list(self.plugins)}
        try:
            names = Names(self.run.scenario, self.run.filter)
            return build(completed(config, self.run.scenario, self.run.filter)[0], names)
        except UserError as error:
            theirs = self.config.get("plugins")
            hint = f"; if you trust its plugins, load(..., plugins={theirs})" if theirs and not self.plugins else ""
            raise UserError(f"{self.path / rundir.CONFIG}: {error}{hint}") from error

    @cached_property
    def space(self) -> Space:
        """The scenario's space; for an untrusted plugin's scenario, from errors.csv, with angles in rad."""
        try:
            return self.settings.scenario.space
        except UserError:
            errors = self.table(rundir.ERRORS).drop_duplicates("component")
            names, units = tuple(errors["component"]), tuple(errors["unit"])
            return Space(names, units, tuple(i for i, unit in enumerate(units) if unit == "rad"))

    def plot_data(self) -> PlotData:
        """From its tables and arrays. Raises UserError like :attr:`settings`."""
        scenario, arrays = self.settings.scenario, self.arrays()

        def draw(axes: "Axes", name: str, place: int) -> None:
            scenario.draw(axes, history_of(arrays, name, self.filters, place))

        return PlotData(
            tables=self._drawn_tables(),
            arrays=arrays,
            filters=self.filters,
            space=scenario.space,
            title=self.title,
            runs=self.settings.run_numbers,
            repeated=_is_repeated(arrays),
            draw=draw,
        )

    def _drawn_tables(self) -> dict[str, dict[str, Any]]:
        """By file and filter: columns of tables over time, rows of histograms."""
        found: dict[str, dict[str, Any]] = {}
        for file in (rundir.ERRORS, rundir.NEES, rundir.NIS, rundir.NOTES):
            found[file] = {
                str(name): {str(column): lines[column].to_numpy() for column in lines}
                for name, lines in self.table(file).groupby("filter", sort=False)
            }
        histograms = self.table(rundir.HISTOGRAMS).groupby("filter", sort=False)
        found[rundir.HISTOGRAMS] = {str(name): lines.to_dict("records") for name, lines in histograms}
        return found


def _is_repeated(arrays: Mapping[str, Array]) -> bool:
    """Whether all runs share one recording."""
    truth, values = arrays["truth"], arrays["values"]
    return all(np.array_equal(one, np.broadcast_to(one[..., :1], one.shape), equal_nan=True) for one in (truth, values))
