"""What a notebook shows of a run: its verdicts and a table of the most important figures."""

from collections.abc import Iterable
from html import escape
from typing import TYPE_CHECKING, Any

from estlab.errors import printable
from estlab.metrics.intervals import Estimate
from estlab.metrics.vocabulary import ALL, heading, written, written_with_interval

if TYPE_CHECKING:
    from estlab.api.run import Run

_BESIDE = ("anees", "anis", "diverged")  # metrics beside the errors


def of_run(run: "Run") -> str:
    """A run as HTML, every text in it escaped."""
    where = "not saved" if run.path is None else str(run.path)
    head = f"<p><b>{_text(run.title)}</b><br>{_text(run.status)} · <code>{_text(where)}</code></p>"
    verdicts = "".join(f"<li>{_text(name)} is {_text(one.sentence)}</li>" for name, one in run.verdict.items())
    unmet = f"<p>{_text(run.unmet)}</p>" if run.unmet else ""
    table = _table(run) if run.status in ("ok", "unmet") else ""
    return f"<div>{head}{table}{unmet}<ul>{verdicts}</ul></div>"


def _table(run: "Run") -> str:
    """A row for each filter: RMSE of each component, NEES, NIS, diverged runs."""
    metrics = run.metrics
    errors = metrics[metrics["metric"] == "rmse"].drop_duplicates("component")
    columns = [
        ("rmse", row.component, heading("rmse", str(row.component), str(row.unit))) for row in errors.itertuples()
    ]
    columns += [(name, ALL, heading(name)) for name in _BESIDE if (metrics["metric"] == name).any()]
    cells = {(row.filter, row.metric, row.component): _cell(row) for row in metrics.itertuples()}
    lines = [[name, *(cells.get((name, *column[:2]), "") for column in columns)] for name in run.filters]
    head = _row("th", ["", *(text for _, _, text in columns)])
    return f"<table><thead>{head}</thead><tbody>{''.join(_row('td', line) for line in lines)}</tbody></table>"


def _cell(row: Any) -> str:
    found = Estimate(row.value, row.ci_low, row.ci_high, row.n)
    return written_with_interval(row.metric, found) if row.metric in _BESIDE else written(row.metric, found)


def _row(tag: str, cells: Iterable[str]) -> str:
    made = "".join(f'<{tag} style="text-align: right">{_text(cell)}</{tag}>' for cell in cells)
    return f"<tr>{made}</tr>"


def _text(text: str) -> str:
    return escape(printable(text))
