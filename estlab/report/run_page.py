"""The page of a run, only from its directory."""

from collections.abc import Callable, Collection

from estlab import rundir
from estlab.metrics.tally import CAUSES
from estlab.metrics.verdict import CONSISTENT, LOST, UNDECIDED
from estlab.metrics.vocabulary import (
    HOLM_INTERVAL,
    HOLM_P,
    INTERVAL,
    METRICS,
    errors_beside,
    expected,
    heading,
    test_heading,
    with_unit,
)
from estlab.report import sections
from estlab.report.cells import (
    CsvRow,
    figure_cell,
    interval_cell,
    metric_cell,
    number_cell,
    p_cell,
    share_cell,
    share_interval_cell,
)
from estlab.report.contents import Contents, UnusableError, as_number
from estlab.report.markup import Cell, Html, folded, join, note, table, tag
from estlab.report.origin import configuration, files, provenance, status_of, title_of

Make = Callable[[], Html]


def run_page(contents: Contents) -> sections.Page:
    """Everything that a run left."""
    run = _Run(contents)
    title = title_of(contents)
    figures = any(map(contents.has, (rundir.METRICS, rundir.TESTS, rundir.VERDICTS, rundir.COVERAGE)))
    parts: list[tuple[str, str, Make, bool]] = [
        (
            "verdicts",
            "Verdicts",
            run.verdicts if figures else lambda: note("The run ended before it had figures."),
            True,
        ),
        ("warnings", "Warnings", run.warnings, bool(sections.warnings(contents))),
        ("errors", "Errors", run.errors, figures),
        ("tests", "Is it consistent?", run.tests, figures),
        ("comparison", "Who is better?", run.comparison, contents.has(rundir.COMPARISON)),
        ("coverage", "Coverage", run.coverage, figures),
        ("expectations", "Expectations", run.expectations, contents.has(rundir.EXPECTATIONS)),
        ("own", "The problem's own table", run.own, run.own_name is not None),
        ("plots", "Plots", lambda: sections.plots(contents, title), True),
        ("metrics", "All metrics", run.metrics, figures),
        ("configuration", "Configuration", lambda: configuration(contents), True),
        ("provenance", "Provenance", lambda: provenance(contents), True),
        ("files", "Files", lambda: files(contents), True),
    ]
    made = [(name, heading, sections.made(make)) for name, heading, make, there in parts if there]
    return sections.Page(title, join([tag("h1", title), status_of(contents)]), made)


class _Run:
    """The parts of the page that come of tables. Each raises UnusableError for a table that is no good."""

    def __init__(self, contents: Contents) -> None:
        self.contents = contents
        try:
            rows = contents.table(rundir.METRICS).rows
        except UnusableError:
            rows = []
        self.found = {(row.get("filter", ""), row.get("metric", ""), row.get("component", "")): row for row in rows}
        self.filters = list(dict.fromkeys(filter for filter, _, _ in self.found))
        # The heading of a column of filters, which there is if there are several.
        self.filter = ["filter"] if len(self.filters) != 1 else []

    def named(self, filter: str) -> list[str]:
        """The cell of a filter, under the heading of the filters."""
        return [filter] if self.filter else []

    @property
    def own_name(self) -> str | None:
        """The problem's own table, <scenario>.csv, if there is one."""
        try:
            name = f"{self.contents.record(rundir.RUN).get('scenario')}.csv"
        except UnusableError:
            return None
        return name if "/" not in name and self.contents.has(name) else None

    def verdicts(self) -> Html:
        items = [self._verdict(row) for row in self.contents.table(rundir.VERDICTS).rows]
        return tag("ul", items, class_="verdicts")

    def _verdict(self, row: CsvRow) -> Html:
        filter, word = row.get("filter", ""), row.get("word", "")
        kind, sign = {CONSISTENT: ("good", "✓"), UNDECIDED: ("doubt", "?")}.get(word, ("bad", "✗"))
        badge = tag("span", f"{sign} {word}", class_=f"word {kind}")
        sentence = tag("p", tag("strong", filter), f" is {row.get('sentence', '')}")
        return tag("li", badge, sentence, note("" if word == LOST else self._diverged(filter)))

    def _diverged(self, filter: str) -> str:
        row = self.found.get((filter, "diverged", "all"))
        if row is None:
            return ""
        causes = [(cause.replace("_", " "), self.found.get((filter, cause, "all"))) for cause in CAUSES]
        why = [f"{figure_cell(found).text} {cause}" for cause, found in causes if found and as_number(found["value"])]
        return f"{figure_cell(row).text} of {row.get('n', '')} runs diverged" + (f": {', '.join(why)}" if why else "")

    def warnings(self) -> Html:
        return tag("ul", [tag("li", line) for line in sections.warnings(self.contents)])

    def errors(self) -> Html:
        self.contents.table(rundir.METRICS)
        components = list(dict.fromkeys(component for _, metric, component in self.found if metric == "rmse"))
        found = [
            (filter, name) for name in components for filter in self.filters if (filter, "rmse", name) in self.found
        ]
        if not any(as_number(self.found[filter, "rmse", name].get("value")) > 0.0 for filter, name in found):
            return note("The truth is unknown, so there are no errors.")
        lost = any(as_number(row["value"]) for (_, metric, _), row in self.found.items() if metric == "diverged")
        bounded = any(metric == "efficiency" for _, metric, _ in self.found)
        beside = errors_beside(lost, bounded)
        headings = ["component", *self.filter, heading("rmse"), INTERVAL, *map(heading, beside)]
        rows = []
        for filter, name in found:
            at = {
                metric: row for (of, metric, component), row in self.found.items() if (of, component) == (filter, name)
            }
            unit = at["rmse"].get("unit", "")
            cells: list[str | Cell] = [with_unit(name, unit), *self.named(filter), metric_cell("rmse", at["rmse"])]
            rows.append([*cells, interval_cell(at["rmse"]), *(metric_cell(one, at.get(one)) for one in beside)])
        return table("Root mean square errors over runs, with 95 % intervals", headings, rows)

    def tests(self) -> Html:
        found = self.contents.table(rundir.TESTS)
        rows: list[list[str | Cell]] = []
        for row in found.rows:
            test, outcome = row.get("test", ""), row.get("outcome", "")
            should_be = Cell(expected(test, as_number(row.get("expected"))), as_number(row.get("expected")))
            rows.append([*self.named(row.get("filter", "")), test_heading(test, row.get("of", ""))])
            rows[-1] += [figure_cell(row), interval_cell(row), should_be]
            rows[-1] += [p_cell(row.get("p_holm")), f"✗ {outcome}" if outcome == "rejected" else outcome]
        headings = (*self.filter, "test", "found", HOLM_INTERVAL, "should be", HOLM_P, "outcome")
        return join([table("Tests of consistency over the runs", headings, rows), note(found.remark)])

    def comparison(self) -> Html:
        found = self.contents.table(rundir.COMPARISON)
        rows = [
            (
                row.get("filter", ""),
                row.get("against", ""),
                with_unit(row.get("component", ""), row.get("unit", "")),
                figure_cell(row, "difference"),
                interval_cell(row, "difference"),
                p_cell(row.get("p_holm")),
                {"True": "yes", "False": "no"}.get(row.get("real", ""), ""),
                share_cell(row, "wins"),
                number_cell(row.get("cost_ratio"), " ×"),
            )
            for row in found.rows
        ]
        headings = (
            "filter",
            "against",
            "component",
            "difference in RMSE",
            HOLM_INTERVAL,
            HOLM_P,
            "real?",
            "better in",
            "time to the other's",
        )
        caption = (
            "Each pair of filters on the same truth and readings; a difference above zero means that the first is worse"
        )
        return join([table(caption, headings, rows, filtered=len(rows) > 10), note(found.remark)])

    def coverage(self) -> Html:
        found = self.contents.table(rundir.COVERAGE)
        if not any(as_number(row.get("share")) >= 0.0 for row in found.rows):
            return note("The truth is unknown, so there are no shares of errors.")
        sigmas = list(dict.fromkeys((row.get("sigmas", ""), row.get("nominal", "")) for row in found.rows))
        lines: dict[tuple[str, ...], dict[str, CsvRow]] = {}
        for row in found.rows:
            key = tuple(row.get(column, "") for column in ("component", *self.filter, "when"))
            lines.setdefault(key, {})[row.get("sigmas", "")] = row
        rows: list[list[str | Cell]] = []
        for key, at in lines.items():
            rows.append([*key])
            for sigma, _ in sigmas:
                rows[-1] += [share_cell(at.get(sigma), "share"), share_interval_cell(at.get(sigma))]
        headings = ["component", *self.filter, "when"]
        for sigma, nominal in sigmas:
            headings += [f"{sigma} sigma ({share_cell({'value': nominal}).text})", INTERVAL]
        caption = "Shares within 1, 2 and 3 sigma; in brackets the value for a consistent filter; all: jointly"
        return join([table(caption, headings, rows, filtered=len(rows) > 10), note(found.remark)])

    def expectations(self) -> Html:
        found = self.contents.table(rundir.EXPECTATIONS)
        met = [row.get("met") == "True" for row in found.rows]
        rows = [
            (
                row.get("filter", ""),
                row.get("expectation", ""),
                row.get("expected", ""),
                figure_cell(row, "found"),
                interval_cell(row, "found"),
                "✓ met" if good else "✗ not met",
            )
            for row, good in zip(found.rows, met, strict=True)
        ]
        word = tag("span", f"{sum(met)} of {len(met)} met", class_=f"word {'good' if all(met) else 'bad'}")
        headings = ("filter", "expectation", "expected", "found", INTERVAL, "outcome")
        return join([tag("p", word), table("What the run was expected to find", headings, rows), note(found.remark)])

    def own(self) -> Html:
        name = str(self.own_name)
        found = self.contents.table(name)
        headings = list(found.rows[0]) if found.rows else []
        rows = [[number_cell(row.get(heading)) for heading in headings] for row in found.rows]
        return join([table(name, headings, rows, filtered=len(rows) > 10), note(found.remark)])

    def metrics(self) -> Html:
        found = self.contents.table(rundir.METRICS)
        columns = (*self.filter, "metric", "component", "unit")
        rows: list[list[str | Cell]] = []
        for row in found.rows:
            rows.append([*(row.get(column, "") for column in columns), figure_cell(row), interval_cell(row)])
            rows[-1].append(number_cell(row.get("n")))
        headings = (*columns, "value", INTERVAL, "runs")
        every = table("Every row of metrics.csv", headings, rows, filtered=True)
        return join([every, note(found.remark), _glossary({row.get("metric", "") for row in found.rows})])


def _glossary(metrics: Collection[str]) -> Html:
    """What each of these metrics is, in the order of the vocabulary."""
    rows = [(name, term.heading, term.meaning) for name, term in METRICS.items() if name in metrics]
    meanings = tag("div", table("What each metric is", ("metric", "called", "what it is"), rows), class_="prose")
    return folded("What each metric is", meanings) if rows else Html()
