"""The statistics of an ensemble: the bound, figures, tests, verdicts and tables, each made separately."""

from collections.abc import Mapping
from functools import partial

from estlab.config.settings import Settings
from estlab.experiment.attempts import Attempts
from estlab.experiment.monte_carlo import Ensemble, record_of
from estlab.maths.space import Array
from estlab.metrics.bound import posterior_bound
from estlab.metrics.consistency import consistency_tests
from estlab.metrics.filter_tables import TABLES, FilterSums, Table
from estlab.metrics.tabulated import ERRORS, metric_groups
from estlab.metrics.verdict import judge
from estlab.record import SMOOTHED
from estlab.report.findings import Findings

_BOUND_RUNS = 200

ByFile = dict[str, dict[str, Table]]


def bounds_of(settings: Settings, ensemble: Ensemble, attempts: Attempts) -> dict[str, Array | None]:
    """The Cramer-Rao bound (n, n, T) for each set of estimates.

    A smoother has none, because the bound is for the readings so far.
    """
    bound = attempts.made("Cramér-Rao bound", lambda: _bound(settings, ensemble))
    return {name: None if name.endswith(SMOOTHED) else bound for name in ensemble.kept}


def _bound(settings: Settings, ensemble: Ensemble) -> Array | None:
    """From enough runs for its means; None if there is none."""
    if ensemble.record.origin is None:
        return None
    record = record_of(settings, range(_BOUND_RUNS))
    scenario, noise = settings.scenario, settings.noise.truth
    return posterior_bound(record, scenario.motion(noise), scenario.sensor(noise, record.landmarks))


def findings_of(settings: Settings, name: str, ensemble: Ensemble, bound: Array | None, attempts: Attempts) -> Findings:
    """The statistics of one set of estimates."""
    of = name if name in settings.filters else name.removesuffix(SMOOTHED)
    sampled_by = settings.filters[of].traits.sampled_by
    sampled = f"{settings.filter_key(of)}.{sampled_by}" if sampled_by else ""
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


def tables_of(
    ensemble: Ensemble, findings: Mapping[str, Findings], bounds: Mapping[str, Array | None], attempts: Attempts
) -> ByFile:
    """Every table with lines of each filter, by file and filter, as far as they can be made."""
    if ensemble.failure:
        return {}
    sums = {name: _sums(ensemble, name, findings[name], bounds[name]) for name in ensemble.kept}
    by_file: ByFile = {}
    for file, make in TABLES.items():
        made = {name: attempts.made(f"{name} in {file}", partial(make, of)) for name, of in sums.items()}
        by_file[file] = {name: table for name, table in made.items() if table is not None}
    return by_file


def _sums(ensemble: Ensemble, name: str, found: Findings, bound: Array | None) -> FilterSums:
    kept, total = ensemble.kept[name], ensemble.total
    first = kept["truth"][..., 0], kept["mean"][..., 0], kept["cov"][..., 0]
    runs = total.each_run.columns(name)
    return FilterSums(total.tallies[name], first, runs, bound, found.rows, found.tests, found.verdict)
