"""A run as an object: its tables, estimates, verdicts and pictures."""

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estlab import rundir
from estlab.api import estimates, notebook, pictures
from estlab.api.estimates import FilterEstimates
from estlab.api.run_sources import Source
from estlab.errors import printable
from estlab.metrics.verdict import Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


class Run:
    """A run: filters on a problem over an ensemble, from :func:`estlab.run` or :func:`estlab.load`.

    Its tables are pandas DataFrames, each with the columns and types of docs/python.md for every run. They are read
    on first use; a table that the run does not have is empty.

    A notebook shows the verdicts and the most important figures.

    >>> import estlab
    >>> run = estlab.load(folder)
    >>> run.verdict["ekf"].word
    'consistent'
    >>> run.estimates["ekf"]
    FilterEstimates(x [m], y [m], heading [rad]; 25 times, 3 runs)
    >>> run.estimates["ekf"]["heading"].error.shape
    (25, 3)
    >>> run.figure("errors")
    <Figure size 900x610 with 3 Axes>
    """

    def __init__(self, source: Source) -> None:
        self._source = source

    @property
    def path(self) -> Path | None:
        """The run directory; None for a run that was not saved."""
        return self._source.path

    @property
    def title(self) -> str:
        """The run in one line."""
        return self._source.title

    @property
    def scenario(self) -> str:
        """The name of the problem."""
        return self._source.scenario

    @property
    def filters(self) -> tuple[str, ...]:
        """The names of the sets of estimates: the filters, and with ``smooth=true`` their smoothers."""
        return self._source.filters

    @property
    def status(self) -> str:
        """ok, unmet (complete, but an expectation was not met), failed, interrupted or running."""
        return str(self._source.status["status"])

    @property
    def unmet(self) -> str:
        """The expectations that were not met, in one line; empty if all were."""
        return str(self._source.status.get("error") or "") if self.status == "unmet" else ""

    @property
    def missing(self) -> Mapping[str, str]:
        """Tables and pictures that could not be made, each with the reason."""
        return dict(self._source.facts.get("missing") or {})

    @property
    def facts(self) -> Mapping[str, Any]:
        """The content of run.json: versions, machine, data files with their hashes, seconds per run and step."""
        return dict(self._source.facts)

    @property
    def config(self) -> Mapping[str, Any]:
        """The whole configuration as nested dicts and lists."""
        return dict(self._source.config)

    @cached_property
    def metrics(self) -> "DataFrame":
        """A row for each filter, metric and component: the value over all runs with its 95 % interval.

        Raises UserError for a run without a complete result.
        """
        return self._source.table(rundir.METRICS)

    @cached_property
    def errors(self) -> "DataFrame":
        """A row for each filter, time and component: the first run's error and sigma, the RMSE, the bound."""
        return self._source.table(rundir.ERRORS)

    @cached_property
    def nees(self) -> "DataFrame":
        """A row for each filter and time: NEES / n over the runs, with the band of a consistent filter."""
        return self._source.table(rundir.NEES)

    @cached_property
    def nis(self) -> "DataFrame":
        """A row for each filter and time with a reading: NIS / m over the runs, with its band."""
        return self._source.table(rundir.NIS)

    @cached_property
    def tests(self) -> "DataFrame":
        """A row for each filter and test of consistency, with p-values before and after Holm's correction."""
        return self._source.table(rundir.TESTS)

    @cached_property
    def runs(self) -> "DataFrame":
        """A row for each filter and run: its RMSE of each component and its mean NEES / n."""
        return self._source.table(rundir.RUNS)

    @cached_property
    def comparison(self) -> "DataFrame":
        """A row for each pair of filters and component: the difference of their RMSE, tested run by run."""
        return self._source.table(rundir.COMPARISON)

    @cached_property
    def coverage(self) -> "DataFrame":
        """A row for each filter, component and number of sigmas: the share of errors inside."""
        return self._source.table(rundir.COVERAGE)

    @cached_property
    def own(self) -> "DataFrame":
        """The problem's own table, such as that of the scenario radar; its columns are the problem's."""
        return self._source.own()

    @cached_property
    def expectations(self) -> "DataFrame":
        """A row for each expectation (``expect.*``): what was expected, what was found, and whether it was met."""
        return self._source.table(rundir.EXPECTATIONS)

    @cached_property
    def verdict(self) -> Mapping[str, Verdict]:
        """The result of the tests for each filter: ``word`` (consistent, lost, ...), ``sentence``, ``key``, ``p``."""
        table = self._source.table(rundir.VERDICTS)
        columns = (table[name].tolist() for name in ("filter", *Verdict._fields))
        return {name: Verdict(*of) for name, *of in zip(*columns, strict=True)}

    @cached_property
    def estimates(self) -> Mapping[str, FilterEstimates]:
        """Each filter's estimates in the first ``keep_runs`` runs, as arrays.

        Raises UserError if estimates.npz is missing or damaged.
        """
        arrays = self._source.arrays()
        return {name: estimates.of_arrays(self._source.space, arrays, name) for name in self.filters}

    @property
    def figures(self) -> tuple[str, ...]:
        """The names of the pictures that :meth:`figure` draws."""
        return pictures.names(self._source)

    def figure(self, name: str) -> "Figure":
        """A picture as a matplotlib figure that belongs to you: change it, save it, or let a notebook show it.

        name: one of :attr:`figures`, such as "errors", "nees", "nis", "trajectory".

        Raises UserError for a picture that the run does not have, and for the scenario of a plugin that you did not
        pass to :func:`estlab.load`.
        """
        return pictures.drawn(self._source, name)

    def __repr__(self) -> str:
        where = "not saved" if self.path is None else str(self.path)
        verdicts = [f"\n  {name} is {verdict.sentence}" for name, verdict in self.verdict.items()]
        return printable(f"Run({self.title}; {self.status}; {where})") + "".join(map(_line, verdicts))

    def _repr_html_(self) -> str:
        return notebook.of_run(self)


def _line(text: str) -> str:
    return f"\n  {printable(text.strip())}"
