"""What a run leaves of its ensemble: statistics, tables and pictures, each made by itself (see attempts)."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np

from estlab import rundir
from estlab.config.build import Settings
from estlab.experiment.attempts import Attempts
from estlab.experiment.monte_carlo import SMOOTHED, Ensemble, Names, histories_of, history_of, record_of
from estlab.maths.space import Array
from estlab.metrics import series
from estlab.metrics.bound import posterior_bound
from estlab.metrics.consistency import consistency_tests
from estlab.metrics.tabulated import ERRORS, coverage_rows, histogram_rows, metric_groups, test_rows
from estlab.metrics.tally import Tally
from estlab.metrics.verdict import judge
from estlab.report import csv_tables, plots
from estlab.report.figures import png
from estlab.report.findings import Findings
from estlab.scenarios.scenario import History

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BOUND_RUNS = 200

ByFile = dict[str, dict[str, csv_tables.Table]]


class Results(NamedTuple):
    """What the summary shows: findings by filter, filters compared, the problem's own table."""

    findings: dict[str, Findings]
    compared: list[dict[str, Any]]
    own: Mapping[str, list[Any]]


def written(settings: Settings, names: Names, ensemble: Ensemble, title: str, attempts: Attempts) -> Results:
    """Compute and write all that comes of an ensemble. Raises OSError for a disk that cannot be written."""
    runs, scenario = settings.run_numbers, settings.scenario
    arrays = histories_of(ensemble, runs[0])
    filters = list(ensemble.kept)
    attempts.write(rundir.ESTIMATES, lambda s: np.savez(s, allow_pickle=False, **arrays), needed=True)
    bound = attempts.made("Cramér-Rao bound", lambda: _bound(settings, names, ensemble))
    # It is of the readings so far, and a smoother has those to come too.
    bounds = {name: None if name.endswith(SMOOTHED) else bound for name in filters}
    findings = {name: _findings(settings, name, ensemble, bounds[name], attempts) for name in filters}
    histories = {name: history_of(arrays, name, len(filters)) for name in filters}
    own_name = f"{names.scenario}.csv"
    own = attempts.made(own_name, lambda: scenario.table(histories)) or {}
    if own:
        attempts.write(own_name, partial(csv_tables.write, own))
    by_file = _tables(ensemble, findings, bounds, attempts)
    for file, by_filter in by_file.items():
        if by_filter:
            table = csv_tables.of_filters(by_filter, settings.seed)
            attempts.write(file, partial(csv_tables.write, table), needed=file == rundir.METRICS)
    cost = ensemble.cost(len(runs))
    compared = attempts.made(rundir.COMPARISON, lambda: ensemble.total.comparison.rows(cost)) or []
    if compared:
        rows = [row | {"seed": settings.seed} for row in compared]
        attempts.write(rundir.COMPARISON, partial(csv_tables.write, rows))
    if settings.plots:
        _draw(settings, by_file, arrays, histories, title, ensemble.record.repeated, attempts)
    return Results(findings, compared, own)


def _bound(settings: Settings, names: Names, ensemble: Ensemble) -> Array | None:
    """The Cramer-Rao bound (n, n, T), of runs enough for its means; None where there is none."""
    if ensemble.record.origin is None:
        return None
    record = record_of(settings, names, range(_BOUND_RUNS))
    scenario, noise = settings.scenario, settings.noise.truth
    return posterior_bound(record, scenario.motion(noise), scenario.sensor(noise, record.landmarks))


def _findings(settings: Settings, name: str, ensemble: Ensemble, bound: Array | None, attempts: Attempts) -> Findings:
    """What the statistics say of a filter."""
    filter = settings.filters.get(name, settings.filter)
    group = f"filters.{name}" if settings.filters else "filter"
    sampled = next((f"{group}.{key}" for key in ("particles", "members") if hasattr(filter, key)), "")
    tally = attempts.made(f"statistics of {name}", lambda: ensemble.total.tallies[name], needed=True)
    if tally is None:
        return Findings([], [], None)
    tests = attempts.made(f"tests of {name}", lambda: consistency_tests(tally)) or []
    verdict = None
    if tests:
        verdict = attempts.made(f"verdict on {name}", lambda: judge(tally, tests, settings.verdict, sampled))
    rows = []
    for group, make in metric_groups(tally, tests, verdict, bound).items():
        rows += attempts.made(f"{group} of {name}", make, needed=group == ERRORS) or []
    return Findings(rows, tests, verdict)


def _tables(
    ensemble: Ensemble, findings: dict[str, Findings], bounds: Mapping[str, Array | None], attempts: Attempts
) -> ByFile:
    """Every table that has lines of each filter, by file and filter, as far as they can be made."""
    if ensemble.failure:
        return {}
    kept, total = ensemble.kept, ensemble.total
    first = {name: (k["truth"][..., 0], k["mean"][..., 0], k["cov"][..., 0]) for name, k in kept.items()}
    of_tally: dict[str, Callable[[str, Tally], csv_tables.Table | None]] = {
        rundir.ERRORS: lambda name, tally: series.errors(tally, first[name], bounds[name]),
        rundir.NEES: lambda name, tally: series.nees(tally),
        rundir.NIS: lambda name, tally: series.nis(tally),
        rundir.NOTES: lambda name, tally: series.notes(tally),
        rundir.COVERAGE: lambda name, tally: coverage_rows(tally),
        rundir.HISTOGRAMS: lambda name, tally: histogram_rows(tally),
        rundir.TESTS: lambda name, tally: test_rows(findings[name].tests) or None,
        rundir.RUNS: lambda name, tally: total.each_run.columns(name),
    }
    by_file: ByFile = {}
    for file, make in of_tally.items():
        made = {
            name: attempts.made(f"{name} in {file}", partial(make, name, tally))
            for name, tally in total.tallies.items()
        }
        by_file[file] = {name: table for name, table in made.items() if table is not None}
    by_file[rundir.VERDICTS] = {name: [found.verdict._asdict()] for name, found in findings.items() if found.verdict}
    by_file[rundir.METRICS] = {name: [row._asdict() for row in found.rows] for name, found in findings.items()}
    return by_file


def _draw(
    settings: Settings,
    by_file: ByFile,
    arrays: dict[str, Array],
    histories: dict[str, History],
    title: str,
    repeated: bool,
    attempts: Attempts,
) -> None:
    """Draw every picture and write it."""
    scenario = settings.scenario

    def draw(axes: "Axes", name: str, place: int) -> None:
        history = history_of(arrays, name, len(histories), place)
        attempts.made("what the problem adds to pictures", lambda: scenario.draw(axes, history))

    runs, filters = settings.run_numbers, list(histories)
    pictures = plots.pictures(by_file, arrays, filters, scenario.space, title, runs, repeated, draw)
    own = attempts.made("the problem's own pictures", lambda: scenario.pictures(histories)) or {}
    for name, figure in own.items():
        pictures[name] = partial(lambda figure: figure, figure)
    for name, make in pictures.items():
        picture = f"{rundir.PLOTS}/{name}"
        content = attempts.made(picture, partial(_drawn, make))
        if content:
            attempts.write(picture, partial(_put, content))


def _drawn(make: Callable[[], "Figure"]) -> bytes:
    return png(make())


def _put(content: bytes, stream: BinaryIO) -> None:
    stream.write(content)
