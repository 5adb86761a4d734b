"""One experiment from settings to its result, in memory: it reads data files, and writes and prints nothing."""

import importlib
import logging
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

from estlab import rundir
from estlab.config import expectations
from estlab.config.expectations import Finding
from estlab.config.settings import Names, Settings
from estlab.experiment import parts
from estlab.experiment.attempts import Attempts
from estlab.experiment.blocks import block
from estlab.experiment.histories import histories_of, history_of
from estlab.experiment.monte_carlo import Ensemble, check_answers, estimated, record_of, workers
from estlab.experiment.plugin_errors import plugins_named
from estlab.experiment.result import Result
from estlab.experiment.statistics import bounds_of, findings_of, tables_of
from estlab.report.findings import Findings

log = logging.getLogger("estlab")

Progress = Callable[[], AbstractContextManager[Callable[[int], Callable[[int], None]]]]


def unseen() -> AbstractContextManager[Callable[[int], Callable[[int], None]]]:
    """No progress bar."""
    return nullcontext(lambda total: lambda steps: None)


def unheard(**facts: Any) -> None:
    """For callers that do not need the facts."""


@plugins_named
def compute(settings: Settings, describe: Callable[..., object] = unheard, progress: Progress = unseen) -> Result:
    """Run all filters and make every table. Anything that cannot be made is missing in the result.

    describe: receives the content of run.json, as soon as it is known. progress: a context that takes the number of
    all steps and returns the counter of those done.

    Raises UserError for invalid data, WorkerLostError if a process that shared the work died.
    """
    facts: dict[str, Any] = {}

    def note(**more: Any) -> None:
        facts.update(more)
        describe(**more)

    ensemble = _ensemble(settings, note, progress)
    note(seconds_per_run_and_step=ensemble.cost(len(settings.run_numbers)))
    _log_outcome(ensemble, len(settings.run_numbers))
    return result_of(settings, ensemble, facts)


@plugins_named
def compute_part(
    settings: Settings, describe: Callable[..., object] = unheard, progress: Progress = unseen
) -> Ensemble:
    """Run all filters over a part of the runs, which has no tables of its own; raises like :func:`compute`."""
    return _ensemble(settings, describe, progress)


def _ensemble(settings: Settings, describe: Callable[..., object], progress: Progress) -> Ensemble:
    """The runs through all filters."""
    runs, names = settings.run_numbers, ", ".join(settings.filters)
    log.info("%s with %s, runs %d to %d, seed %d", settings.names.scenario, names, runs[0], runs[-1], settings.seed)
    # For the statistics: imported before workers are forked, so that not each of them imports it, and none finds out
    # halfway that there is no room for it.
    importlib.import_module("scipy.special")
    with workers(settings) as pool:
        first = record_of(settings, block(settings, 0))
        check_answers(settings, first)
        title = _title(settings, first.time.size)
        describe(title=title, data=rundir.hashes(first.files), steps=first.time.size)
        if settings.parts:
            ensemble = parts.put_together(settings, first, [Path(folder) for folder in settings.parts])
        else:
            with progress() as begin:
                ensemble = estimated(settings, first, pool, begin)
    describe(cores=pool.cores)
    return ensemble


def _title(settings: Settings, steps: int) -> str:
    names, runs = settings.names, settings.run_numbers
    ensemble = f"run {runs[0]} alone" if runs[0] else f"{len(runs)} run{'s' * (len(runs) > 1)}"
    size = f"{ensemble} × {steps} step{'s' * (steps > 1)}"
    return " · ".join([names.scenario, ", ".join(settings.filters), size, f"seed {settings.seed}", *names.changes])


def result_of(settings: Settings, ensemble: Ensemble, facts: dict[str, Any]) -> Result:
    """Every figure and table of an ensemble, each made separately."""
    attempts = Attempts(settings.plugins)
    bounds = bounds_of(settings, ensemble, attempts)
    findings = {name: findings_of(settings, name, ensemble, bounds[name], attempts) for name in ensemble.kept}
    arrays = histories_of(ensemble, settings.run_numbers[0])
    histories = {name: history_of(arrays, name, list(findings)) for name in findings}
    own = attempts.made(f"{settings.names.scenario}.csv", lambda: settings.scenario.table(histories)) or {}
    by_filter = tables_of(ensemble, findings, bounds, attempts)
    cost = facts["seconds_per_run_and_step"]
    comparison = attempts.made(rundir.COMPARISON, lambda: ensemble.total.comparison.rows(cost)) or []
    known = expectations.of_recording(settings.expect_files, [one["sha256"] for one in facts["data"]])
    return Result(
        settings,
        facts,
        arrays,
        by_filter,
        findings,
        comparison,
        own,
        expected=_held_to(expectations.over(known, settings.expect), findings, own, attempts),
        repeated=ensemble.record.repeated,
        remarks=[*ensemble.record.remarks, *_left_out(settings.names, bool(known))],
        attempts=attempts,
    )


def _left_out(names: Names, others: bool) -> list[str]:
    """A remark if an experiment's expectations are left out. others: whether these data have their own."""
    instead = "those of this recording apply" if others else "this recording has none"
    return [f"the experiment's expectations apply to its simulation and were left out; {instead}"] * names.set_aside


def _held_to(
    expect: Any, findings: Mapping[str, Findings], own: Mapping[str, list[Any]], attempts: Attempts
) -> list[Finding]:
    """The expectations, checked against the rows of metrics.csv and the own table."""
    rows = {name: [row._asdict() for row in one.rows] for name, one in findings.items()}
    parsed = expectations.parse(expect, list(rows))
    found = attempts.made(rundir.EXPECTATIONS, lambda: expectations.check(parsed, rows, own), needed=True) or []
    if found:
        log.info(expectations.unmet(found) or "all expectations met")
    return found


def _log_outcome(ensemble: Ensemble, runs: int) -> None:
    for remark in ensemble.record.remarks:
        log.warning(remark)
    for name, tally in {} if ensemble.failure else ensemble.total.tallies.items():
        log.info("%s: %d of %d runs diverged", name, sum(tally.diverged.values()), runs)
        for cause, first in tally.diverged_first.items():
            if first:
                more = " and more" if tally.diverged[cause] > len(first) else ""
                log.warning("%s %s in runs: %s%s", name, cause.replace("_", " "), " ".join(map(str, first)), more)
