"""One experiment from settings to a run directory. It assembles records, filter, metrics, report; it computes none."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from estlab import rundir
from estlab.config import Settings
from estlab.errors import UserError
from estlab.filters.loop import estimate
from estlab.maths.space import Array
from estlab.maths.streams import Streams
from estlab.metrics.tally import Tally
from estlab.record import Estimates, Record
from estlab.report import plots, tables, terminal
from estlab.rundir import RunDirectory
from estlab.scenarios.contract import History

log = logging.getLogger("estlab")


@dataclass(frozen=True)
class Names:
    """What the user chose, as he named it."""

    scenario: str
    filter: str


def check(settings: Settings) -> None:
    """Raise UserError where the parts do not fit together, before anything is made."""
    if settings.data.path is not None and settings.data.source == "simulated":
        raise UserError(f"data.path={settings.data.path} would not be read: add data=files")
    try:
        settings.filter.check(settings.scenario.motion(settings.noise.filter))
    except ValueError as error:
        raise UserError(f"filter.{error}") from error


def run(settings: Settings, names: Names, directory: RunDirectory, command: list[str]) -> None:
    """Run, write every file of the directory but its configuration and status, and print the summary.

    Raises UserError for data that cannot be used, OSError for a disk that cannot be written.
    """
    log.info("%s with %s, %d runs, seed %d", names.scenario, names.filter, settings.runs, settings.seed)
    directory.write_provenance(command, settings.seed, ())
    scenario = settings.scenario
    tally, kept, record = _ensemble(settings, names)
    ensemble = f"{settings.runs} run{'s' * (settings.runs > 1)} × {record.time.size} steps"
    title = f"{names.scenario} · {names.filter} · {ensemble} · seed {settings.seed}"
    for remark in record.remarks:
        log.warning(remark)
    log.info("%d of %d runs diverged", tally.diverged.sum(), settings.runs)
    if tally.diverged.any():
        log.warning("diverged runs: %s", " ".join(map(str, np.flatnonzero(tally.diverged)[:100])))

    rows = tally.metrics()
    first = kept["truth"][..., 0], kept["mean"][..., 0], kept["cov"][..., 0]
    _write_table(directory, rundir.ERRORS, tally.errors(first), names)
    _write_table(directory, rundir.NEES, tally.nees(), names)
    _write_table(directory, rundir.NIS, tally.nis(), names)
    _write_table(directory, rundir.METRICS, rows, names)
    directory.write(rundir.ESTIMATES, lambda stream: np.savez(stream, allow_pickle=False, **kept))
    if settings.plots:
        plots.draw_all(
            directory.path,
            directory.write,
            scenario.space,
            title,
            settings.runs,
            lambda axes, arrays: scenario.draw(axes, History(**arrays)),
        )
    directory.write_provenance(command, settings.seed, record.files, steps=record.time.size, runs=settings.runs)
    terminal.summary(title, rows, record.remarks, str(_short(directory.path)))


def simulate(settings: Settings, names: Names) -> list[Path]:
    """Write the simulated data of run 0 in the scenario's original file layout to data.path; the files written."""
    if settings.data.source != "simulated":
        raise UserError("estlab simulate makes data, so it takes data=simulated; data.path says where to write it")
    if settings.data.path is None:
        raise UserError(f"data.path must be given: the folder to write to, for example data.path=data/{names.scenario}")
    folder = Path(settings.data.path)
    record = _record(settings, names, range(1))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return settings.scenario.write(record, folder, settings.data.prefix)
    except OSError as error:
        raise UserError(f"{folder}: cannot be written ({error.strerror}); choose another data.path") from error


def _ensemble(settings: Settings, names: Names) -> tuple[Tally, dict[str, Array], Record]:
    """All runs block by block: the tally, the kept histories and the first block's record."""
    scenario = settings.scenario
    motion = scenario.motion(settings.noise.filter)
    scheme, pause = scenario.scheme
    blocks = list(_blocks(settings))
    first = _record(settings, names, blocks[0])
    sensor = scenario.sensor(settings.noise.filter, first.places)
    tally = Tally(scenario.space, first.time)
    kept: dict[str, Array] = {}
    with terminal.progress(len(blocks) * first.time.size, f"{names.scenario} {names.filter}") as tick:
        for block in blocks:
            record = first if block is blocks[0] else _record(settings, names, block)
            estimates = estimate(settings.filter, motion, sensor, record, scheme, pause, tick)
            tally.add(record, estimates)
            kept = kept or _histories(record, estimates, min(settings.keep_runs, settings.runs))
    return tally, kept, first


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


def _histories(record: Record, estimates: Estimates, count: int) -> dict[str, Array]:
    """The arrays of estimates.npz: the first runs whole, without readings that none of them has."""
    readings = record.readings
    taken = np.isfinite(readings.values[:, :, :count]).any(axis=(0, 2))
    return {
        "time": record.time,
        "truth": record.truth[:, :, :count],
        "mean": estimates.mean[:, :, :count],
        "cov": estimates.cov[:, :, :, :count],
        "step": readings.step[taken],
        "values": readings.values[:, taken, :count],
        "target": readings.target[taken, :count],
        "places": record.places,
    }


def _write_table(
    directory: RunDirectory, name: str, columns: Mapping[str, Any] | Sequence[Mapping[str, Any]], names: Names
) -> None:
    directory.write(name, lambda stream: tables.write_csv(stream, columns, names.filter))


def _short(path: Path) -> Path:
    """Relative to where the user stands, if it is below."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path
