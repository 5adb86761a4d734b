"""One experiment from settings to a run directory. It assembles records, filters, metrics, report; it computes none."""

import contextlib
import logging
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from estlab import expectations, rundir
from estlab.config import Settings
from estlab.errors import UserError
from estlab.expectations import Finding
from estlab.filters.contract import Filter
from estlab.filters.loop import Loop
from estlab.maths.space import Array
from estlab.maths.streams import Streams
from estlab.metrics.tally import Tally
from estlab.record import Estimates, Record
from estlab.report import expected, plots, tables, terminal
from estlab.rundir import RunDirectory
from estlab.scenarios.contract import History

log = logging.getLogger("estlab")

SMOOTHED = "_smoothed"


@dataclass(frozen=True)
class Names:
    """What the user chose, as he named it, and what he changed."""

    scenario: str
    filter: str
    changes: tuple[str, ...] = ()


@dataclass
class Ensemble:
    """All runs of all filters: a tally and the histories kept for each set of estimates, by name.

    record: of the first block. sums: those of the records of all blocks together.
    """

    record: Record
    tallies: dict[str, Tally]
    kept: dict[str, dict[str, Array]]
    sums: dict[str, Array]


def check(settings: Settings, names: Names) -> None:
    """Raise UserError where the parts do not fit together, before anything is made."""
    if settings.data.path is not None and settings.data.source == "simulated":
        raise UserError(f"data.path={settings.data.path} would not be read: add data=files")
    truth = settings.noise.truth
    if settings.data.source == "files" and (truth.process_scale, truth.measurement_scale) != (1.0, 1.0):
        raise UserError("noise.truth has no effect on a recording; leave it at 1, or take data=simulated")
    for name, filter in _filters(settings, names).items():
        key = f"filters.{name}" if settings.filters else "filter"
        loop = _loop(settings, filter, np.empty((0, 1)))
        try:
            loop.check()
        except ValueError as error:
            raise UserError(f"{key}.{error}") from error
        except ArithmeticError as error:
            raise UserError(f"{key} or noise.filter is so large or small that numbers end ({error})") from error
        if settings.smooth:
            try:
                loop.check_smoother()
            except ValueError as error:
                raise UserError(f"smooth=true with {name}: {error}") from error
    endings = ("", SMOOTHED) if settings.smooth else ("",)
    expectations.parse(settings.expect, [name + end for name in _filters(settings, names) for end in endings])


def run(settings: Settings, names: Names, directory: RunDirectory, command: list[str]) -> list[Finding]:
    """Run, write every file of the directory but its configuration and status, and print the summary.

    Returns what was found of what was expected.

    Raises UserError for data that cannot be used, OSError for a disk that cannot be written.
    """
    filters = _filters(settings, names)
    log.info("%s with %s, %d runs, seed %d", names.scenario, ", ".join(filters), settings.runs, settings.seed)
    directory.describe(command=command, seed=settings.seed, runs=settings.runs)
    ensemble = _ensemble(settings, names, filters, directory)
    record, tallies = ensemble.record, ensemble.tallies
    directory.describe(steps=record.time.size)
    size = f"{settings.runs} run{'s' * (settings.runs > 1)} × {record.time.size} step{'s' * (record.time.size > 1)}"
    title = " · ".join([names.scenario, ", ".join(filters), size, f"seed {settings.seed}", *names.changes])
    _log_outcome(ensemble, settings.runs)

    rows = {name: tally.metrics() for name, tally in tallies.items()}
    first = {name: (k["truth"][..., 0], k["mean"][..., 0], k["cov"][..., 0]) for name, k in ensemble.kept.items()}
    written: dict[str, Mapping[str, tables.Table]] = {
        rundir.ERRORS: {name: tally.errors(first[name]) for name, tally in tallies.items()},
        rundir.NEES: {name: tally.nees() for name, tally in tallies.items()},
        rundir.NIS: {name: tally.nis() for name, tally in tallies.items()},
        rundir.NOTES: {name: tally.notes() for name, tally in tallies.items()},
        rundir.METRICS: rows,
    }
    for file, by_filter in written.items():
        directory.write(file, partial(tables.write_csv, by_filter))
    histories = _histories(ensemble)
    directory.write(rundir.ESTIMATES, lambda stream: np.savez(stream, allow_pickle=False, **histories))
    scenario = settings.scenario
    own = scenario.table({name: _history(histories, name, len(tallies)) for name in tallies})
    if own:
        directory.write(f"{names.scenario}.csv", partial(tables.write_columns, own))
    if settings.plots:
        with warnings.catch_warnings():
            # An ensemble of which nothing is left has pictures without a curve.
            warnings.simplefilter("ignore", RuntimeWarning)
            plots.draw_all(
                directory.path,
                directory.write,
                scenario.space,
                title,
                settings.runs,
                lambda axes, name: scenario.draw(axes, _history(histories, name, len(tallies))),
                lambda: scenario.pictures({name: _history(histories, name, len(tallies)) for name in tallies}),
            )
    terminal.summary(title, rows, own, record.remarks, str(_short(directory.path)))
    return _hold_to(settings, rows, directory)


def _hold_to(
    settings: Settings, rows: Mapping[str, Sequence[expectations.Row]], directory: RunDirectory
) -> list[Finding]:
    """What was expected against the rows of metrics.csv: written and printed where anything was."""
    findings = expectations.check(expectations.parse(settings.expect, list(rows)), rows)
    if findings:
        log.info(expectations.unmet(findings) or "all expectations met")
        directory.write(rundir.EXPECTATIONS, partial(tables.write_columns, expectations.columns(findings)))
        expected.show(expected.HEADINGS, [finding.cells() for finding in findings])
    return findings


def simulate(settings: Settings, names: Names) -> list[Path]:
    """Write the simulated data of run 0 in the scenario's original file layout to data.path; the files written."""
    if settings.data.source != "simulated":
        raise UserError("estlab simulate makes data, so it takes data=simulated; data.path says where to write it")
    if settings.data.path is None:
        raise UserError(f"data.path must be given: the folder to write to, for example data.path=data/{names.scenario}")
    folder = Path(settings.data.path)
    record = _record(settings, names, range(1))
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


def _filters(settings: Settings, names: Names) -> dict[str, Filter]:
    return settings.filters or {names.filter: settings.filter}


def _loop(settings: Settings, filter: Filter, places: Array) -> Loop:
    scenario, noise = settings.scenario, settings.noise.filter
    return Loop(filter, scenario.motion(noise), scenario.sensor(noise, places), *scenario.scheme)


def _ensemble(settings: Settings, names: Names, filters: dict[str, Filter], directory: RunDirectory) -> Ensemble:
    """All runs block by block, every filter on the same record."""
    scenario, streams = settings.scenario, Streams(settings.seed, names.scenario)
    blocks = list(_blocks(settings))
    first = _record(settings, names, blocks[0])
    directory.describe(data=rundir.hashes(first.files))
    loops = {name: _loop(settings, filter, first.places) for name, filter in filters.items()}
    ensemble = Ensemble(first, {}, {}, {})
    ticks = len(blocks) * first.time.size * len(filters)
    with terminal.progress(ticks, f"{names.scenario} {' '.join(filters)}") as tick:
        for block in blocks:
            record = first if block is blocks[0] else _record(settings, names, block)
            ensemble.sums |= {name: ensemble.sums.get(name, 0) + array for name, array in record.sums.items()}
            for name, loop in loops.items():
                draws = streams.draws(f"filter/{name}", block if record.each_its_own else range(1))
                found = {}
                if settings.smooth:
                    found[name], found[name + SMOOTHED] = loop.estimate_and_smooth(record, draws, tick)
                else:
                    found[name] = loop.estimate(record, draws, tick)
                for label, estimates in found.items():
                    if label not in ensemble.tallies:
                        ensemble.tallies[label] = Tally(
                            scenario.space, first.time, scenario.found_within, first.repeated
                        )
                        ensemble.kept[label] = _kept(record, estimates, min(settings.keep_runs, settings.runs))
                    ensemble.tallies[label].add(record, estimates)
    return ensemble


def _blocks(settings: Settings) -> Iterator[range]:
    """Runs in blocks; the first holds all that are kept, so that these do not depend on the block's size."""
    begin, size = 0, max(settings.block_runs, settings.keep_runs)
    while begin < settings.runs:
        yield range(begin, min(begin + size, settings.runs))
        begin, size = begin + size, settings.block_runs


def _record(settings: Settings, names: Names, runs: Sequence[int]) -> Record:
    streams = Streams(settings.seed, names.scenario)
    data = settings.data
    if data.source == "files":
        record = settings.scenario.read(Path(data.path or "."), data.prefix, streams, runs)
    else:
        record = settings.scenario.simulate(streams, runs, settings.noise.truth)
    return record.first(settings.steps)


def _kept(record: Record, estimates: Estimates, count: int) -> dict[str, Array]:
    return {
        "truth": record.truth[:, :, :count],
        "mean": estimates.mean[:, :, :count],
        "cov": estimates.cov[:, :, :, :count],
    }


def _histories(ensemble: Ensemble) -> dict[str, Array]:
    """The arrays of estimates.npz: the first runs whole, without readings that none of them has.

    mean and cov for one filter, <filter>.mean and <filter>.cov for several.
    """
    readings, record = ensemble.record.readings, ensemble.record
    count = next(iter(ensemble.kept.values()))["truth"].shape[2]
    taken = np.isfinite(readings.values[:, :, :count]).any(axis=(0, 2))
    arrays = {
        "time": record.time,
        "truth": record.truth[:, :, :count],
        "step": readings.step[taken],
        "values": readings.values[:, taken, :count],
        "target": readings.target[taken, :count],
        "places": record.places,
    }
    for name, kept in ensemble.kept.items():
        prefix = f"{name}." if len(ensemble.kept) > 1 else ""
        arrays |= {f"{prefix}mean": kept["mean"], f"{prefix}cov": kept["cov"]}
    return arrays | {f"shown.{name}": array for name, array in (record.shown | ensemble.sums).items()}


def _history(arrays: dict[str, Array], name: str, filters: int) -> History:
    """Run 0 of a filter, from the arrays of estimates.npz."""
    prefix = f"{name}." if filters > 1 else ""
    shown = {key.removeprefix("shown."): array for key, array in arrays.items() if key.startswith("shown.")}
    return History(
        time=arrays["time"],
        truth=arrays["truth"][..., 0],
        mean=arrays[f"{prefix}mean"][..., 0],
        cov=arrays[f"{prefix}cov"][..., 0],
        step=arrays["step"],
        values=arrays["values"][..., 0],
        target=arrays["target"][..., 0],
        places=arrays["places"],
        shown=shown,
    )


def _log_outcome(ensemble: Ensemble, runs: int) -> None:
    for remark in ensemble.record.remarks:
        log.warning(remark)
    for name, tally in ensemble.tallies.items():
        log.info("%s: %d of %d runs diverged", name, tally.diverged.sum(), runs)
        if tally.diverged.any():
            log.warning("%s diverged in runs: %s", name, " ".join(map(str, np.flatnonzero(tally.diverged)[:100])))


def _short(path: Path) -> Path:
    """Relative to where the user stands, if it is below."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path
