"""Where a run comes from and how it ended: title, status, configuration, provenance, files."""

import shlex
from typing import Any

from estlab import rundir
from estlab.report import sections
from estlab.report.contents import Contents, UnusableError, as_number
from estlab.report.markup import Html, join, table, tag

_HELD = {
    rundir.METRICS: "means over runs with 95 % intervals, and the verdict",
    rundir.VERDICTS: "each filter's verdict: word, sentence and key",
    rundir.TESTS: "NEES, NIS, bias and whiteness with p-values",
    rundir.COMPARISON: "each pair of filters",
    rundir.COVERAGE: "shares within 1, 2, 3 sigma",
    rundir.HISTOGRAMS: "how many runs have which RMSE and NEES",
    rundir.ERRORS: "errors, sigmas and RMSE over time",
    rundir.NEES: "NEES / n over time with its band",
    rundir.NIS: "NIS / m over time with its band",
    rundir.NOTES: "a filter's notes at each step",
    rundir.EXPECTATIONS: "expectations and results",
    rundir.ESTIMATES: "truth, estimates and readings of the runs kept",
    rundir.CONFIG: "the whole configuration",
    rundir.OVERRIDES: "the typed words",
    rundir.RUN: "versions, machine, command line, data files, time",
    rundir.STATUS: "how it ended",
    rundir.LOG: "the log",
}


def title_of(contents: Contents) -> str:
    """Problem, filters, size and seed; as much as is known if the run ended early."""
    record = _record(contents, rundir.RUN)
    if isinstance(title := record.get("title"), str) and title:
        return title[:500]
    filters = record.get("filters")
    words = [
        str(record.get("scenario") or "a run"),
        *([", ".join(map(str, filters))] if isinstance(filters, list) else []),
    ]
    words += [
        f"{record[key]} {key.removesuffix('s') if record[key] == 1 else key}"
        for key in ("runs", "steps")
        if key in record
    ]
    return " · ".join([*words, *([f"seed {record['seed']}"] if "seed" in record else [])])[:500]


def status_of(contents: Contents) -> Html:
    """How the run ended, when, how long it took, and what went wrong."""
    record = _record(contents, rundir.RUN)
    try:
        stamp = contents.record(rundir.STATUS)
        word, error = rundir.state_of(stamp), str(stamp.get("error") or "")
    except UnusableError as unusable:
        word, error = "unknown", str(unusable)
    took = as_number(str(record.get("wall_time_s")))
    facts = [str(record["began"])[:19].replace("T", " ")] if "began" in record else []
    facts += [f"{took:.3g} s"] if took == took else []
    facts += [f"estlab {record['estlab']}"] if "estlab" in record else []
    line = tag("p", sections.status(word), " ", tag("span", " · ".join(facts), class_="facts"))
    return join([line, tag("p", error, class_="error") if error else None])


def configuration(contents: Contents) -> Html:
    """The typed words, the same as Hydra received them, and the whole configuration."""
    typed = _command(_record(contents, rundir.RUN).get("command"))
    as_taken = sections.made(lambda: sections.file_text(contents, rundir.OVERRIDES))
    whole = sections.made(lambda: sections.file_text(contents, rundir.CONFIG))
    return join([tag("p", "Typed: ", tag("code", typed)) if typed else None, as_taken, whole])


def _command(words: Any) -> str:
    """A command line as a shell accepts it."""
    return shlex.join(words) if isinstance(words, list) and all(isinstance(word, str) for word in words) else ""


def provenance(contents: Contents) -> Html:
    """run.json as tables, and the log."""
    return join([sections.made(lambda: _record_table(contents)), sections.made(lambda: _log(contents))])


def _record_table(contents: Contents) -> Html:
    record = contents.record(rundir.RUN)
    data, plugins = record.pop("data", None), record.pop("plugins", None)
    if command := _command(record.get("command")):
        record["command"] = command
    return join([sections.facts(record, "What ran, on what, and how long"), _data(data), _plugins(plugins)])


def _data(data: Any) -> Html:
    if not isinstance(data, list):
        return Html()
    if not data:
        return tag("p", "No data file was read.")
    rows = [(str(entry.get("file")), str(entry.get("sha256"))) for entry in data[:500] if isinstance(entry, dict)]
    return tag("div", table("Data files that were read", ("file", "SHA-256"), rows), class_="prose")


def _plugins(plugins: Any) -> Html:
    modules = [one for one in plugins[:500] if isinstance(one, dict)] if isinstance(plugins, list) else []
    if not modules:
        return Html()
    rows = [tuple(str(one.get(key)) for key in ("module", "file", "sha256")) for one in modules]
    return tag("div", table("Modules of plugins that took part", ("module", "file", "SHA-256"), rows), class_="prose")


def _log(contents: Contents) -> Html:
    return sections.file_text(contents, rundir.LOG, last=True)


def files(contents: Contents) -> Html:
    """The content of the directory."""
    return sections.files(contents, _HELD)


def _record(contents: Contents, name: str) -> dict[str, Any]:
    """A record, empty if there is none."""
    try:
        return contents.record(name)
    except UnusableError:
        return {}
