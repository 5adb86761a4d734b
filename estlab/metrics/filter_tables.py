"""The tables with lines of each filter: a function for each, named after its file."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from estlab.maths.space import Array
from estlab.metrics import series
from estlab.metrics.consistency import Test
from estlab.metrics.tabulated import Columns, MetricRow, coverage_rows, histogram_rows, test_rows
from estlab.metrics.tally import Tally
from estlab.metrics.verdict import Verdict

Table = Mapping[str, Any] | Sequence[Mapping[str, Any]]  # by column or by row


class FilterSums(NamedTuple):
    """The sums of one filter over all runs.

    first: the first run's truth (n, T), mean (n, T), cov (n, n, T). runs: the results of each of the first runs.
    bound: (n, n, T), the Cramer-Rao bound, if there is one.
    """

    tally: Tally
    first: tuple[Array, Array, Array]
    runs: Columns
    bound: Array | None
    rows: Sequence[MetricRow]
    tests: Sequence[Test]
    verdict: Verdict | None


Make = Callable[[FilterSums], Table | None]

TABLES: dict[str, Make] = {}  # by file, in the order in which they are made


def table(make: Make) -> Make:
    """Declare a table of every run. If it returns None, the filter has no such table."""
    TABLES[f"{make.__name__}.csv"] = make
    return make


@table
def errors(of: FilterSums) -> Table | None:
    return series.errors(of.tally, of.first, of.bound)


@table
def nees(of: FilterSums) -> Table | None:
    return series.nees(of.tally)


@table
def nis(of: FilterSums) -> Table | None:
    return series.nis(of.tally)


@table
def notes(of: FilterSums) -> Table | None:
    return series.notes(of.tally)


@table
def coverage(of: FilterSums) -> Table | None:
    return coverage_rows(of.tally)


@table
def histograms(of: FilterSums) -> Table | None:
    return histogram_rows(of.tally)


@table
def tests(of: FilterSums) -> Table | None:
    return test_rows(of.tests) or None


@table
def runs(of: FilterSums) -> Table | None:
    return of.runs


@table
def verdicts(of: FilterSums) -> Table | None:
    return [of.verdict._asdict()] if of.verdict else None


@table
def metrics(of: FilterSums) -> Table | None:
    return [row._asdict() for row in of.rows]
