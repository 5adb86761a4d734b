"""The result of an experiment, in memory: it is written to a directory, printed and drawn."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from estlab import rundir
from estlab.config import expectations
from estlab.config.expectations import Finding
from estlab.config.settings import Settings
from estlab.experiment.attempts import Attempts
from estlab.experiment.histories import history_of
from estlab.maths.space import Array
from estlab.metrics.filter_tables import Table
from estlab.report import csv_tables
from estlab.report.findings import Findings
from estlab.report.plots import Draw, PlotData
from estlab.scenarios.scenario import History


@dataclass(frozen=True)
class Result:
    """Arrays, tables and verdicts of all filters, as far as they could be made.

    facts: the content of run.json. arrays: those of estimates.npz. by_filter: the tables with lines of each filter,
    by file and filter. findings: the statistics of each set of estimates, a filter's or a smoother's. comparison: a
    row for each pair of filters. own: the problem's own table, by column. expected: the findings about expectations.
    repeated: whether all runs share one recording. remarks: for a reader of the results. attempts: what could not be
    made, and why.
    """

    settings: Settings
    facts: dict[str, Any]
    arrays: dict[str, Array]
    by_filter: Mapping[str, Mapping[str, Table]]
    findings: Mapping[str, Findings]
    comparison: list[dict[str, Any]]
    own: Mapping[str, list[Any]]
    expected: list[Finding]
    repeated: bool
    remarks: list[str]
    attempts: Attempts

    @property
    def title(self) -> str:
        """One line that describes the run."""
        return str(self.facts["title"])

    @property
    def filters(self) -> list[str]:
        """The names of the sets of estimates."""
        return list(self.findings)

    @cached_property
    def histories(self) -> dict[str, History]:
        """The first run of each set of estimates."""
        return {name: history_of(self.arrays, name, self.filters) for name in self.filters}

    @property
    def own_name(self) -> str:
        """The file of the problem's own table."""
        return f"{self.settings.names.scenario}.csv"

    @property
    def tables(self) -> list[str]:
        """The files of all existing tables."""
        others = {self.own_name: self.own, rundir.COMPARISON: self.comparison, rundir.EXPECTATIONS: self.expected}
        return [file for file, table in {**self.by_filter, **others}.items() if table]

    def table(self, file: str) -> Mapping[str, Any]:
        """The columns of a table as in its file. Raises KeyError if there is no such table."""
        if file not in self.tables:
            raise KeyError(file)
        if file == self.own_name:
            return self.own
        if file == rundir.EXPECTATIONS:
            return expectations.columns(self.expected)
        if file == rundir.COMPARISON:
            return csv_tables.by_column([row | {"seed": self.settings.seed} for row in self.comparison])
        return csv_tables.of_filters(self.by_filter[file], self.settings.seed)

    def add_to_picture(self, axes: Any, name: str, place: int) -> None:
        """Draw the problem's additions to a picture of the plane, for a filter in one of the runs kept."""
        self.settings.scenario.draw(axes, history_of(self.arrays, name, self.filters, place))

    def plot_data(self, draw: Draw | None = None) -> PlotData:
        """The data for its pictures. draw: in place of :meth:`add_to_picture`."""
        return PlotData(
            tables=self.by_filter,
            arrays=self.arrays,
            filters=self.filters,
            space=self.settings.scenario.space,
            title=self.title,
            runs=self.settings.run_numbers,
            repeated=self.repeated,
            draw=draw or self.add_to_picture,
        )
