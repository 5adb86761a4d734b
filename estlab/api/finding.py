"""Runs found on the disk: one as an object, many as a table."""

from collections.abc import Iterator, Sequence
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estlab.api.run import Run
from estlab.api.run_sources import Stored
from estlab.comparison.rows import ComparisonRow, rows_of
from estlab.errors import UserError
from estlab.rundir import finished
from estlab.rundir.search import run_directories

if TYPE_CHECKING:
    from pandas import DataFrame

_NAMED = 3  # directories that an error names

_TEXTS = ("path", "status", "scenario", "filter", "changes", "verdict", "estlab", "problem")
_COUNTS = ("runs", "steps", "seed")


def load(path: str | PathLike[str] = "latest", plugins: Sequence[str] = ()) -> Run:
    """A run from its directory, of this or an earlier version of estlab.

    path: the run directory, a link to it, a folder with only this run, or a shell pattern that only it matches;
    "latest" is the last run below ``runs/``.
    plugins: your packages that the run's configuration may name. It is always read as data; only
    :meth:`Run.figure` makes objects of it, and the pictures of a plugin's scenario need the plugin.

    Raises UserError if there is no such run, more than one, or one that cannot be read.

    >>> import estlab
    >>> run = estlab.load(folder)
    >>> run.scenario, run.filters
    ('landmark', ('ekf',))
    >>> run.metrics.query("metric == 'rmse' and component == 'position'")[["filter", "unit", "n"]]
      filter unit  n
    3    ekf    m  3
    """
    word = fspath(path)
    if word == "latest" and not Path(word).exists():
        word = "runs/latest"
    found = run_directories([word])
    if not found:
        raise UserError(f"{word}: contains no run")
    if len(found) > 1:
        named = ", ".join(map(str, found[:_NAMED])) + (", ..." if len(found) > _NAMED else "")
        raise UserError(f"{word}: contains {len(found)} runs ({named}); name one, or use estlab.runs for all of them")
    try:
        return Run(Stored(finished.read(found[0]), tuple(plugins)))
    except UserError:
        if why := finished.unfinished(finished.status(found[0])):
            raise UserError(f"{found[0]}: has no result ({why})") from None
        raise


def runs(*paths: str | PathLike[str]) -> "DataFrame":
    """A table of runs: a row for each filter of each run in these directories, folders or patterns; ``runs/`` if none.

    Its columns: path, began (a time with its zone), status, scenario, filter, changes (the other typed words),
    runs, steps, seed, verdict, estlab (the version), problem (why a run has no figures; empty where it has), then a
    column for each metric and component, such as ``rmse.position``, ``anees``, ``diverged``. :func:`load` takes a path.

    Raises UserError for a path that matches nothing.

    >>> import estlab
    >>> table = estlab.runs(folder)
    >>> table[["scenario", "filter", "runs", "status"]]
       scenario filter  runs status
    0  landmark    ekf     3     ok
    """
    import pandas as pd

    words = [fspath(path) for path in paths] or ["runs"]
    found = [line for path in run_directories(words) for line in _lines(path)]
    metrics = dict.fromkeys(name for line in found for name in line if name not in _FIXED)
    table = pd.DataFrame(found, columns=[*_FIXED, *metrics])
    table["began"] = pd.to_datetime(table["began"], utc=True, errors="coerce", format="ISO8601")
    types: dict[str, Any] = dict.fromkeys(_TEXTS, str) | dict.fromkeys(_COUNTS, "int64") | dict.fromkeys(metrics, float)
    return table.astype(types)


_FIXED = ("path", "began", *_TEXTS[1:5], *_COUNTS, *_TEXTS[5:])


def _lines(path: Path) -> Iterator[dict[str, Any]]:
    """A line for each filter of a run, or one that says why there is none."""
    line: dict[str, Any] = dict.fromkeys(_TEXTS, "") | dict.fromkeys(_COUNTS, 0) | {"path": str(path), "began": None}
    try:
        status = finished.status(path)
        line |= {"status": str(status["status"]), "began": status.get("began")}
        run = finished.read(path)
        facts = run.facts
        line |= {"scenario": run.scenario, "filter": run.filter, "changes": " ".join(run.changes)}
        line |= {"estlab": str(facts.get("estlab") or "")} | {name: _count(facts.get(name)) for name in _COUNTS}
        if problem := finished.unfinished(status):
            raise UserError(problem)
        rows = rows_of(run)
    except UserError as error:
        yield line | {"problem": str(error)}
    else:
        for row in rows:
            yield line | {"filter": row.filter, "verdict": row.verdict} | _metrics(row)


def _metrics(row: ComparisonRow) -> dict[str, float]:
    """Each metric's value by its name, with its component if it has one."""
    return {
        name if component == "all" else f"{name}.{component}": figure.found.value
        for (name, component), figure in row.metrics.items()
    }


def _count(fact: object) -> int:
    return fact if isinstance(fact, int) and 0 <= fact < 2**63 else 0
