"""The statistics of one filter, as they are reported."""

from collections.abc import Sequence
from typing import NamedTuple

from estlab.metrics.consistency import Test
from estlab.metrics.tabulated import MetricRow
from estlab.metrics.verdict import Verdict


class Findings(NamedTuple):
    """Rows of figures, tests and the verdict, as far as they could be made."""

    rows: Sequence[MetricRow]
    tests: Sequence[Test]
    verdict: Verdict | None

    def row(self, metric: str, component: str = "all") -> MetricRow | None:
        """The row of a metric and component, if it exists and has a value."""
        found = next((row for row in self.rows if row.metric == metric and row.component == component), None)
        return None if found is None or found.value != found.value else found
