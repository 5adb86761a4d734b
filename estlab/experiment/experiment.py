"""One experiment from settings to a run directory. It assembles records, filters, metrics, report; it computes none."""

import contextlib
import importlib
import logging
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import asdict
from functools import partial, wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np

from estlab import rundir
from estlab.config import expectations
from estlab.config.build import Settings
from estlab.config.expectations import Finding
from estlab.errors import IncompleteError, UserError, plugins_answer
from estlab.experiment import parts, results
from estlab.experiment.attempts import Attempts
from estlab.experiment.blocks import block
from estlab.experiment.monte_carlo import (
    SMOOTHED,
    Ensemble,
    Names,
    check_answers,
    estimated,
    filters_of,
    loop_of,
    record_of,
    workers,
)
from estlab.parallel import cores
from estlab.report import console, csv_tables, grids, terminal
from estlab.report.expected import HEADINGS, expected_grid
from estlab.rundir import RunDirectory

_CROWDED = 4  # processes a core that may be asked for

P = ParamSpec("P")
R = TypeVar("R")

log = logging.getLogger("estlab")


def _plugins_named(function: Callable[Concatenate[Settings, P], R]) -> Callable[Concatenate[Settings, P], R]:
    """The function, which raises PluginError in place of what the code of one of the user's plugins raises."""

    @wraps(function)
    def named(settings: Settings, /, *arguments: P.args, **keys: P.kwargs) -> R:
        with plugins_answer(settings.plugins):
            return function(settings, *arguments, **keys)

    return named


@_plugins_named
def check(settings: Settings, names: Names) -> None:
    """Raise UserError where the parts do not fit together, before anything is made."""
    data = settings.data
    if data.source == "simulated" and (data.path is not None or data.prefix):
        key = f"data.prefix={data.prefix}" if data.path is None else f"data.path={data.path}"
        raise UserError(f"{key} would not be read: add data=files")
    _check_file_names(settings)
    truth = settings.noise.truth
    if settings.data.source == "files" and (truth.process_scale, truth.measurement_scale) != (1.0, 1.0):
        raise UserError("noise.truth has no effect on a recording; leave it at 1, or take data=simulated")
    if settings.cores is not None and settings.cores > _CROWDED * cores.usable():
        raise UserError(
            f"cores={settings.cores} is far more than the {cores.usable()} that this process may use, and each is a "
            "process with a memory of its own; leave it out to take all that there are"
        )
    for name, filter in filters_of(settings, names).items():
        key = f"filters.{name}" if settings.filters else "filter"
        loop = loop_of(settings, filter, np.empty((0, 1)))
        try:
            loop.check()
        except ValueError as error:
            raise UserError(f"{key}.{error}") from error
        except ArithmeticError as error:
            raise UserError(f"{key} or noise.filter is so large or small that numbers end ({error})") from error
        if loop.compiles:
            cores.enough_memory("engine=compiled")
        try:
            loop.check_engine()
        except ValueError as error:
            raise UserError(f"engine={settings.engine} with {name}: {error}") from error
        if settings.smooth:
            try:
                loop.check_smoother()
            except ValueError as error:
                raise UserError(f"smooth=true with {name}: {error}") from error
    endings = ("", SMOOTHED) if settings.smooth else ("",)
    estimates = [name + end for name in filters_of(settings, names) for end in endings]
    expectations.parse(settings.expect, estimates)
    expectations.parse_sets(settings.expect_files, estimates)


def _check_file_names(settings: Settings) -> None:
    kinds = list(settings.scenario.file_names)
    for kind, name in settings.data.files.items():
        if settings.data.source == "simulated":
            raise UserError(f"data.files.{kind}={name} would not be read: add data=files")
        if kind not in kinds:
            raise UserError(f"data.files.{kind}: the scenario has no such file; it has {', '.join(kinds) or 'none'}")


@_plugins_named
def run(settings: Settings, names: Names, directory: RunDirectory, command: list[str]) -> list[Finding]:
    """Run, write every file of the directory but its configuration and status, and print the summary.

    Returns what was found of what was expected. A statistic, table or picture that cannot be made is said and missing.

    Raises UserError for data that cannot be used, OSError for a disk that cannot be written, IncompleteError if
    metrics.csv or estimates.npz, or a filter's errors, are missing, all else being kept.
    """
    filters = filters_of(settings, names)
    runs = settings.run_numbers
    log.info("%s with %s, runs %d to %d, seed %d", names.scenario, ", ".join(filters), runs[0], runs[-1], settings.seed)
    directory.describe(names=asdict(names), scenario=names.scenario, filters=list(filters))
    directory.describe(command=command, seed=settings.seed, runs=len(runs), first_run=runs[0])
    # The statistics' own: before workers are forked, so that each need not import it, and none finds out halfway that
    # there is no room for it.
    importlib.import_module("scipy.special")
    directory.keep_sources(settings.plugins)
    with workers(settings, names) as pool:
        first = record_of(settings, names, block(settings, 0))
        check_answers(settings, names, first)
        title = _title(names, filters, runs, first.time.size, settings.seed)
        hashes = rundir.hashes(first.files)
        directory.describe(title=title, data=hashes, steps=first.time.size)
        if settings.parts:
            ensemble = parts.put_together(settings, first, [Path(folder) for folder in settings.parts])
        else:
            with console.progress(f"{names.scenario} {' '.join(filters)}") as progress:
                ensemble = estimated(settings, names, first, pool, progress)
    directory.describe(cores=pool.cores)
    directory.keep_sources(settings.plugins)  # what was imported on the way
    if settings.part is not None:
        if ensemble.failure:
            raise IncompleteError(f"this part of the ensemble has no sums ({ensemble.failure})")
        directory.describe(part=settings.part)
        directory.write(rundir.PART, partial(parts.save, ensemble))
        return []
    directory.describe(seconds_per_run_and_step=ensemble.cost(len(runs)))
    _log_outcome(ensemble, len(runs))
    attempts = Attempts(directory, settings.plugins)
    found = results.written(settings, names, ensemble, title, attempts)
    where = str(_short(directory.path))
    attempts.show("tables on the terminal", partial(terminal.summary, title, found.findings, found.compared, found.own))
    known = expectations.of_recording(settings.expect_files, [one["sha256"] for one in hashes])
    remarks = [*first.remarks, *_set_aside(names, bool(known))]
    attempts.show(
        "verdicts on the terminal", lambda: terminal.ending(found.findings, [*remarks, *attempts.remarks()], where)
    )
    held = _hold_to(expectations.over(known, settings.expect), found, attempts)
    directory.describe(missing=attempts.missing)
    attempts.complete()
    return held


def _title(names: Names, filters: Iterable[str], runs: range, steps: int, seed: int) -> str:
    ensemble = f"run {runs[0]} alone" if runs[0] else f"{len(runs)} run{'s' * (len(runs) > 1)}"
    size = f"{ensemble} × {steps} step{'s' * (steps > 1)}"
    return " · ".join([names.scenario, ", ".join(filters), size, f"seed {seed}", *names.changes])


def _set_aside(names: Names, others: bool) -> list[str]:
    """A remark where an experiment's expectations are not held. others: whether there are any of these data."""
    instead = "those of this recording hold" if others else "none are known of this recording"
    return [f"the experiment's expectations are of its simulation and were left out; {instead}"] * names.set_aside


def _hold_to(expect: Any, found: results.Results, attempts: Attempts) -> list[Finding]:
    """What was expected against the rows of metrics.csv and the own table: written and printed where anything was."""
    rows = {name: [row._asdict() for row in one.rows] for name, one in found.findings.items()}
    parsed = expectations.parse(expect, list(rows))
    held = attempts.made(rundir.EXPECTATIONS, lambda: expectations.check(parsed, rows, found.own), needed=True) or []
    if held:
        log.info(expectations.unmet(held) or "all expectations met")
        attempts.write(rundir.EXPECTATIONS, partial(csv_tables.write, expectations.columns(held)))
        attempts.show("expectations", lambda: grids.show(expected_grid(HEADINGS, [found.cells() for found in held])))
    return held


@_plugins_named
def simulate(settings: Settings, names: Names) -> list[Path]:
    """Write the simulated data of run 0 in the scenario's original file layout to data.path; the files written."""
    if settings.data.source != "simulated":
        raise UserError("estlab simulate makes data, so it takes data=simulated; data.path says where to write it")
    if settings.dropped:
        raise UserError(f"dropped={settings.dropped:g} is of a run: the files hold every reading; leave it out")
    if not settings.data.path:
        raise UserError(f"data.path must be given: the folder to write to, for example data.path=data/{names.scenario}")
    folder = Path(settings.data.path)
    record = record_of(settings, names, range(1))
    ours = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # All files beside their places first: a full disk or a file that is there already leaves nothing half done.
        with tempfile.TemporaryDirectory(dir=folder, prefix=".simulated-") as aside:
            written = settings.scenario.write(record, Path(aside), settings.data.prefix)
            taken = [path.name for path in written if (folder / path.name).exists()]
            if taken:
                raise UserError(
                    f"{folder / taken[0]}: is there already; remove it, or choose another data.path or data.prefix"
                )
            return [path.rename(folder / path.name) for path in written]
    except OSError as error:
        raise UserError(f"{folder}: cannot be written ({error.strerror}); choose another data.path") from error
    finally:
        if ours:
            with contextlib.suppress(OSError):
                folder.rmdir()  # nothing came of it: else it is not empty, and stays


def _log_outcome(ensemble: Ensemble, runs: int) -> None:
    for remark in ensemble.record.remarks:
        log.warning(remark)
    for name, tally in {} if ensemble.failure else ensemble.total.tallies.items():
        log.info("%s: %d of %d runs diverged", name, sum(tally.diverged.values()), runs)
        for cause, first in tally.diverged_first.items():
            if first:
                more = " and more" if tally.diverged[cause] > len(first) else ""
                log.warning("%s %s in runs: %s%s", name, cause.replace("_", " "), " ".join(map(str, first)), more)


def _short(path: Path) -> Path:
    """Relative to where the user stands, if it is below."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path
