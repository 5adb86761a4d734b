"""An ensemble of runs through filters, block by block, every filter on the same truth and readings."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from estlab.config import Settings
from estlab.filters.contract import Filter
from estlab.filters.loop import Loop
from estlab.maths.space import Array
from estlab.maths.streams import Draws, Streams
from estlab.metrics.comparison import Comparison
from estlab.metrics.each_run import EachRun
from estlab.metrics.pairwise import Pairwise
from estlab.metrics.scores import Limits
from estlab.metrics.tally import Tally
from estlab.record import Estimates, Record
from estlab.scenarios.contract import History

SMOOTHED = "_smoothed"


@dataclass(frozen=True)
class Names:
    """What the user chose, as he named it, and what he changed."""

    scenario: str
    filter: str
    changes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Totals:
    """Of runs: a tally for each set of estimates by name, filters compared, the first runs one by one, further sums."""

    tallies: dict[str, Tally]
    comparison: Comparison
    each_run: EachRun
    sums: dict[str, Array]

    def plus(self, other: "Totals") -> "Totals":
        """Of the runs of both, those of the other coming after."""
        return Totals(
            {name: tally.plus(other.tallies[name]) for name, tally in self.tallies.items()},
            self.comparison.plus(other.comparison),
            self.each_run.plus(other.each_run),
            {name: array + other.sums[name] for name, array in self.sums.items()},
        )


@dataclass
class Ensemble:
    """All runs of all filters: totals, and for each set of estimates by name the histories kept and the seconds spent.

    record: of the first block.
    """

    record: Record
    blocks: Pairwise[Totals] = field(default_factory=Pairwise)
    kept: dict[str, dict[str, Array]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    @cached_property
    def total(self) -> Totals:
        """Of all blocks."""
        return self.blocks.total()

    def cost(self) -> dict[str, float]:
        """Seconds a run and step of each filter; a smoother's are in its filter's."""
        steps, tallies = self.record.time.size, self.total.tallies
        seconds = {name: self.seconds[name.removesuffix(SMOOTHED)] for name in tallies}
        return {name: spent / (tallies[name].runs * steps) for name, spent in seconds.items()}


def filters_of(settings: Settings, names: Names) -> dict[str, Filter]:
    """The filters by name."""
    return settings.filters or {names.filter: settings.filter}


def loop_of(settings: Settings, filter: Filter, places: Array) -> Loop:
    """A filter with the models as it assumes them."""
    scenario, noise = settings.scenario, settings.noise.filter
    kind = Loop
    if settings.engine == "numba":
        from estlab.filters.compiled.engine import CompiledLoop as kind  # noqa: N813
    return kind(filter, scenario.motion(noise), scenario.sensor(noise, places), *scenario.scheme)


def record_of(settings: Settings, names: Names, runs: Sequence[int]) -> Record:
    """Truth and readings of the runs with these numbers."""
    streams = Streams(settings.seed, names.scenario)
    data = settings.data
    if data.source == "files":
        record = settings.scenario.read(Path(data.path or "."), data.prefix, streams, runs)
    else:
        record = settings.scenario.simulate(streams, runs, settings.noise.truth)
    return record.first(settings.steps)


def estimated(
    settings: Settings, names: Names, first: Record, progress: Callable[[int], Callable[[], None]]
) -> Ensemble:
    """All runs of all filters, or those of a part. progress: told of all steps, gives what counts one.

    first: the record of the ensemble's first block.
    """
    streams = Streams(settings.seed, names.scenario)
    blocks = list(enumerate(blocks_of(settings)))
    if settings.part is not None:
        which, parts = settings.part
        blocks = blocks[which * len(blocks) // parts : (which + 1) * len(blocks) // parts]
    loops = {name: loop_of(settings, filter, first.places) for name, filter in filters_of(settings, names).items()}
    ensemble = Ensemble(first)
    tick = progress(len(blocks) * first.time.size * len(loops))
    for number, block in blocks:
        record = record_of(settings, names, block) if number else first
        found: dict[str, Estimates] = {}
        for name, loop in loops.items():
            draws = streams.draws(f"filter/{name}", block if record.each_its_own else range(1))
            loop.prepare(record, draws)
            began = time.perf_counter()
            found |= _found(loop, name, record, draws, tick, settings.smooth)
            ensemble.seconds[name] = ensemble.seconds.get(name, 0.0) + time.perf_counter() - began
        if number == 0:
            ensemble.kept = {name: _kept(record, one, settings.keep_runs) for name, one in found.items()}
        ensemble.blocks.add(0, number, _totals(settings, record, found, block))
    return ensemble


def empty_totals(settings: Settings, record: Record, names: Iterable[str]) -> Totals:
    """Totals of no runs yet, for these sets of estimates."""
    space, begin = settings.scenario.space, settings.run_numbers.start
    limits = Limits(settings.scenario.found_within, settings.scenario.lost_beyond)
    tallies = {name: Tally(space, record.time, limits, record.repeated, begin) for name in names}
    return Totals(tallies, Comparison(space, record.repeated), EachRun(space), record.sums)


def _totals(settings: Settings, record: Record, found: dict[str, Estimates], block: range) -> Totals:
    totals = empty_totals(settings, record, found)
    squares = {name: totals.tallies[name].add(record, estimates, block) for name, estimates in found.items()}
    totals.comparison.add(squares)
    totals.each_run.add(record, squares, block, settings.run_numbers.start)
    return totals


def blocks_of(settings: Settings) -> Iterator[range]:
    """Run numbers in blocks; the first holds all that are kept, so that these do not depend on the block's size."""
    runs = settings.run_numbers
    begin, size = runs.start, max(settings.block_runs, settings.keep_runs)
    while begin < runs.stop:
        yield range(begin, min(begin + size, runs.stop))
        begin, size = begin + size, settings.block_runs


def block_count(settings: Settings) -> int:
    """How many blocks :func:`blocks_of` gives."""
    first = max(settings.block_runs, settings.keep_runs)
    return 1 + max(0, -(-(len(settings.run_numbers) - first) // settings.block_runs))


def histories_of(ensemble: Ensemble, first: int) -> dict[str, Array]:
    """The arrays of estimates.npz: runs whole, from the first on, without readings that none of them has.

    mean and cov for one filter, <filter>.mean and <filter>.cov for several.
    """
    readings, record = ensemble.record.readings, ensemble.record
    count = next(iter(ensemble.kept.values()))["truth"].shape[2]
    taken = np.isfinite(readings.values[:, :, :count]).any(axis=(0, 2))
    arrays = {
        "run": np.arange(first, first + count),
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
    return arrays | {f"shown.{name}": array for name, array in (record.shown | ensemble.total.sums).items()}


def history_of(arrays: dict[str, Array], name: str, filters: int) -> History:
    """The first run of a filter, from the arrays of estimates.npz."""
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
        run=int(arrays["run"][0]),
    )


def _found(
    loop: Loop, name: str, record: Record, draws: Draws, tick: Callable[[], None], smooth: bool
) -> dict[str, Estimates]:
    if not smooth:
        return {name: loop.estimate(record, draws, tick)}
    filtered, smoothed = loop.estimate_and_smooth(record, draws, tick)
    return {name: filtered, name + SMOOTHED: smoothed}


def _kept(record: Record, estimates: Estimates, count: int) -> dict[str, Array]:
    return {
        "truth": record.truth[:, :, :count],
        "mean": estimates.mean[:, :, :count],
        "cov": estimates.cov[:, :, :, :count],
    }
