"""One experiment: computed, written to its directory, told on the terminal."""

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path

from estlab import rundir
from estlab.config.expectations import Finding
from estlab.config.settings import Settings
from estlab.errors import IncompleteError
from estlab.experiment import parts
from estlab.experiment.compute import Progress, compute, compute_part
from estlab.experiment.plugin_errors import plugins_named
from estlab.experiment.result import Result
from estlab.experiment.write import write
from estlab.report import console, grids, terminal
from estlab.report.expected import HEADINGS, expected_grid
from estlab.rundir import RunDirectory

Show = Callable[[Result, Path], object]


@plugins_named
def run(
    settings: Settings,
    directory: RunDirectory,
    command: list[str],
    progress: Progress | None = None,
    show: Show | None = None,
) -> list[Finding]:
    """Compute, write every file of the directory except its configuration and status, and show the result.

    Returns the findings about expectations. A statistic, table or picture that cannot be made is missing, with a
    remark.

    progress: see :func:`compute`; None: a bar on the terminal. show: is given the result and where it was written;
    None: prints the summary.

    Raises UserError for invalid data, OSError for a disk that cannot be written, IncompleteError if metrics.csv,
    estimates.npz or a filter's errors are missing; everything else is kept.
    """
    names, filters, runs = settings.names, settings.filters, settings.run_numbers
    directory.describe(
        names=asdict(names), scenario=names.scenario, filters=list(filters), command=command, seed=settings.seed,
        runs=len(runs), first_run=runs[0],
    )  # fmt: skip
    directory.keep_sources(settings.plugins)
    progress = progress or partial(console.progress, f"{names.scenario} {' '.join(filters)}")
    if settings.part is not None:
        ensemble = compute_part(settings, directory.describe, progress)
        directory.keep_sources(settings.plugins)
        if ensemble.failure:
            raise IncompleteError(f"this part of the ensemble has no sums ({ensemble.failure})")
        directory.describe(part=settings.part)
        directory.write(rundir.PART, partial(parts.save, ensemble))
        return []
    result = compute(settings, directory.describe, progress)
    directory.keep_sources(settings.plugins)  # modules that were imported on the way
    write(result, directory)
    (show or _print)(result, _short(directory.path))
    directory.describe(missing=result.attempts.missing)
    result.attempts.complete(directory.path)
    return result.expected


def _print(result: Result, where: Path) -> None:
    """Tables, verdicts and remarks, the path, and the expectations."""
    attempts, findings = result.attempts, result.findings
    attempts.put(
        "tables on the terminal",
        lambda: terminal.summary(result.title, findings, result.comparison, result.own),
    )
    attempts.put(
        "verdicts on the terminal",
        lambda: terminal.ending(findings, [*result.remarks, *attempts.remarks()], str(where)),
    )
    if result.expected:
        attempts.put(
            "expectations", lambda: grids.show(expected_grid(HEADINGS, [one.cells() for one in result.expected]))
        )


def _short(path: Path) -> Path:
    """The path relative to the current folder, if it is below it."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path
