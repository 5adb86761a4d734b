"""The page of a sweep, only from its directory."""

from collections import Counter
from collections.abc import Callable
from typing import Any

from estlab import rundir
from estlab.metrics.vocabulary import INTERVAL, column_heading, usual_columns
from estlab.report import sections
from estlab.report.cells import CsvRow, figure_cell, interval_cell, number_cell
from estlab.report.contents import Contents, UnusableError
from estlab.report.markup import Cell, Html, join, link, note, table, tag
from estlab.rundir.layout import FAILURES, GROUPS, PLAN, REPORT, SWEEP, TUNING

_HELD = {
    PLAN: "the plan: the words typed and the jobs",
    SWEEP: "a row for each job and filter: swept values, status, every metric with its interval",
    GROUPS: "means over repeats with intervals",
    FAILURES: "each attempt that failed",
    TUNING: "the trials of a tuning: values, objective, the best so far",
}


def sweep_page(contents: Contents) -> sections.Page:
    """Everything that a sweep left."""
    sweep = _Sweep(contents)
    title = f"sweep · {len(sweep.counts)} jobs" + (f" · {' × '.join(sweep.keys)}" if sweep.keys else "")
    head = [tag("h1", title), tag("p", [[sections.status(word), f" {count} "] for word, count in sweep.tallied()])]
    parts: list[tuple[str, str, Callable[[], Html], bool]] = [
        ("swept", "What was swept", sweep.swept, True),
        ("failures", "Failures", sweep.failures, True),
        ("trials", "Trials", sweep.trials, contents.has(TUNING)),
        ("jobs", "Jobs", sweep.jobs, True),
        ("groups", "Repeats", sweep.groups, contents.has(GROUPS)),
        ("plots", "Plots", lambda: sections.plots(contents, title), True),
        ("files", "Files", lambda: sections.files(contents, _HELD), True),
    ]
    made = [(name, heading, sections.made(make)) for name, heading, make, there in parts if there]
    return sections.Page(title, join(head), made)


class _Sweep:
    """The parts of the page. Each raises UnusableError for a file that is no good."""

    def __init__(self, contents: Contents) -> None:
        self.contents = contents
        self.planned = _planned(contents)
        self.keys = list(dict.fromkeys(key for _, values in self.planned for key in values))
        # Each job's status: the table's, or of a sweep that was cut off, the job's own.
        try:
            self.counts = {row.get("job", ""): row.get("status", "") for row in contents.table(SWEEP).rows}
        except UnusableError:
            self.counts = {name: _status(contents, name) for name, _ in self.planned}

    def tallied(self) -> list[tuple[str, int]]:
        """How many jobs have which status, the good ones first."""
        order = ("ok", "unmet", "failed", "left")
        return sorted(
            Counter(self.counts.values()).items(), key=lambda pair: (*(pair[0] != word for word in order), pair)
        )

    def swept(self) -> Html:
        plan = self.contents.record(PLAN)
        arguments = plan.get("arguments")
        words = [word for word in arguments if isinstance(word, str)] if isinstance(arguments, list) else []
        rows = []
        for key in self.keys:
            values = list(dict.fromkeys(found[key] for _, found in self.planned if key in found))
            rows.append((key, ", ".join(values), Cell(str(len(values)), len(values))))
        typed = [tag("p", "Typed:"), tag("ul", [tag("li", tag("code", word)) for word in words])] if words else None
        swept = tag("div", table("Keys with several values", ("key", "values", "how many"), rows), class_="prose")
        return join([swept if rows else note("No key has several values."), typed])

    def jobs(self) -> Html:
        if not self.contents.has(SWEEP):
            rows = [
                (self._job(name), *(values.get(key, "") for key in self.keys), self.counts[name])
                for name, values in self.planned
            ]
            there = table("Jobs of the plan", ("job", *self.keys, "status"), rows, filtered=len(rows) > 10)
            return join([note(f"{SWEEP} is missing: the sweep did not finish."), there])
        found = self.contents.table(SWEEP)
        columns = list(found.rows[0]) if found.rows else []
        keys = [column for column in columns if column in (*self.keys, "filter", "status") and column != "job"]
        figures = usual_columns(columns)
        headings = ["job", *keys, *["time [s]"] * ("wall_time_s" in columns)]
        for column in figures:
            headings += [column_heading(column), *[INTERVAL] * (f"{column}.low" in columns)]
        rows_ = []
        for row in found.rows:
            cells: list[str | Cell] = [self._job(row.get("job", "")), *(_value(row.get(key, "")) for key in keys)]
            cells += [number_cell(row.get("wall_time_s"))] * ("wall_time_s" in columns)
            rows_.append([*cells, *_metrics(row, columns, figures)])
        caption = f"Jobs; every metric is in {SWEEP}"
        return join([table(caption, headings, rows_, filtered=len(rows_) > 10), note(found.remark)])

    def trials(self) -> Html:
        found = self.contents.table(TUNING)
        keys = [column for column in self.keys if found.rows and column in found.rows[0]]
        rows: list[list[str | Cell]] = []
        for row in found.rows:
            rows.append([self._job(row.get("job", "")), *(_value(row.get(key, "")) for key in keys)])
            rows[-1] += [number_cell(row.get("objective")), number_cell(row.get("best")), row.get("state", "")]
        headings = ("job", *keys, "objective", "best so far", "outcome")
        caption = "Trials in order; a smaller objective is better"
        return join([table(caption, headings, rows, filtered=len(rows) > 10), note(found.remark)])

    def groups(self) -> Html:
        found = self.contents.table(GROUPS)
        columns = list(found.rows[0]) if found.rows else []
        figures = usual_columns(columns)
        keys = [column for column in columns if column in (*self.keys, "filter", "repeats")]
        headings = list(keys)
        for column in figures:
            headings += [column_heading(column), *[INTERVAL] * (f"{column}.low" in columns)]
        rows = [[*(_value(row.get(key, "")) for key in keys), *_metrics(row, columns, figures)] for row in found.rows]
        return join([table("Means over repeats", headings, rows, filtered=len(rows) > 10), note(found.remark)])

    def failures(self) -> Html:
        if not self.contents.has(FAILURES) and "failed" not in self.counts.values():
            return tag("p", "No job failed.")
        found = self.contents.table(FAILURES)
        if not found.rows:
            return tag("p", "No job failed.")
        rows = [
            (self._job(row.get("job", "")), row.get("error", ""), row.get("status", ""), _value(row.get("attempt", "")))
            for row in found.rows
        ]
        failed = table("Each attempt that failed, with its error", ("job", "error", "status", "attempt"), rows)
        return join([tag("div", failed, class_="prose"), note(found.remark)])

    def _job(self, name: str) -> Html:
        """A job's name, linked to its own page or to its directory, if it has one."""
        if not self.contents.is_folder(name):
            return join(name)
        page = f"{name}/{REPORT}"
        return link(page if self.contents.has(page) else f"{name}/", name)


def _planned(contents: Contents) -> list[tuple[str, dict[str, str]]]:
    """Name and swept values of each job of the plan; none where the plan is no good."""
    try:
        jobs: Any = contents.record(PLAN).get("jobs")
    except UnusableError:
        return []
    found = []
    for job in jobs if isinstance(jobs, list) else []:
        if isinstance(job, dict):
            values = job.get("values")
            pairs = values.items() if isinstance(values, dict) else ()
            found.append((str(job.get("name")), {key: str(value) for key, value in pairs}))
    return found


def _status(contents: Contents, job: str) -> str:
    """What a job's own directory says of it."""
    if not contents.is_folder(job):
        return "left"
    try:
        return rundir.state_of(contents.record(f"{job}/{rundir.STATUS}"))
    except UnusableError:
        return "left"


def _metrics(row: CsvRow, columns: list[str], figures: list[str]) -> list[Cell]:
    cells = []
    for name in figures:
        ends = (name, f"{name}.low", f"{name}.high")
        cells += [figure_cell(row, *ends), *[interval_cell(row, *ends)] * (ends[1] in columns)]
    return cells


def _value(text: str) -> Cell:
    """A swept value as it was typed, sorted as a number if it is one."""
    return number_cell(text)._replace(text=text)
