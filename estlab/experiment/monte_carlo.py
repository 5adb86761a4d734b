"""An ensemble of runs through filters, block by block, every filter on the same truth and readings."""

import logging
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from estlab.config.settings import Settings
from estlab.errors import UserError
from estlab.experiment.blocks import block, block_count
from estlab.filters.filter import AnyFilter
from estlab.filters.loop import Loop
from estlab.filters.particle_engine import compiled_loop
from estlab.maths.space import Array
from estlab.maths.streams import Generators, Streams
from estlab.metrics.each_run import EachRun
from estlab.metrics.paired import Comparison
from estlab.metrics.pairwise import Pairwise
from estlab.metrics.scores import Limits, quietly
from estlab.metrics.tally import Tally
from estlab.parallel.pool import OnStep, Workers
from estlab.record import SMOOTHED, Estimates, Record
from estlab.validation import problem
from estlab.validation.user_filter import try_filter

_CLOUDS = 100  # runs for which a sample of the cloud is kept at most, 40 kB each for a state of three numbers

log = logging.getLogger("estlab")


@dataclass(frozen=True)
class Totals:
    """Totals over runs: a tally for each set of estimates, comparisons of filters, the first runs, further sums."""

    tallies: dict[str, Tally]
    comparison: Comparison
    each_run: EachRun
    sums: dict[str, Array]

    def plus(self, other: "Totals") -> "Totals":
        """The totals of the runs of both; those of the other come after."""
        return Totals(
            {name: tally.plus(other.tallies[name]) for name, tally in self.tallies.items()},
            self.comparison.plus(other.comparison),
            self.each_run.plus(other.each_run),
            {name: array + other.sums[name] for name, array in self.sums.items()},
        )


@dataclass(frozen=True)
class Block:
    """What remains of a block of runs: totals, seconds that each filter took and, for the first block, histories.

    totals: or the reason why there are none.
    """

    totals: Totals | str
    seconds: dict[str, float]
    kept: dict[str, dict[str, Array]]


@dataclass
class Ensemble:
    """All runs of all filters: totals, and for each set of estimates by name the histories kept and the seconds
    spent.

    record: of the first block. failure: why there is no total of all runs, if there is none.
    """

    record: Record
    failure: str = ""
    blocks: Pairwise[Totals] = field(default_factory=Pairwise)
    kept: dict[str, dict[str, Array]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    @quietly
    def add(self, number: int, block: Block) -> None:
        """Add a block, once."""
        if isinstance(block.totals, str):
            self.failure = self.failure or block.totals
        else:
            self.blocks.add(0, number, block.totals)
        self.kept |= block.kept
        for name, spent in block.seconds.items():
            self.seconds[name] = self.seconds.get(name, 0.0) + spent

    @cached_property
    @quietly
    def total(self) -> Totals:
        """The total of all blocks. Raises RuntimeError if a block's could not be computed."""
        if self.failure:
            raise RuntimeError(self.failure)
        return self.blocks.total()

    def cost(self, runs: int) -> dict[str, float]:
        """Seconds per run and step of each filter, for so many runs; a smoother's are included in its filter's."""
        seconds = {name: self.seconds[name.removesuffix(SMOOTHED)] for name in self.kept}
        return {name: spent / (runs * self.record.time.size) for name, spent in seconds.items()}


def loop_of(settings: Settings, filter: AnyFilter, landmarks: Array) -> Loop:
    """A filter with the models that it assumes."""
    scenario, noise = settings.scenario, settings.noise.filter
    parts = filter, *problem.models_of(scenario, noise, landmarks), *problem.scheme_of(scenario)
    return Loop(*parts) if settings.engine == "numpy" else compiled_loop(*parts, insist=settings.engine == "compiled")


_loops: dict[str, tuple[Settings, Array, Loop]] = {}  # for this process, so that models are traced for its first block


def _kept_loop(settings: Settings, name: str, filter: AnyFilter, landmarks: Array) -> Loop:
    """The loop of the previous block, if it had the same settings; otherwise a new one."""
    known = _loops.get(name)
    if known is None or known[0] is not settings or not np.array_equal(known[1], landmarks):
        known = _loops[name] = settings, landmarks, loop_of(settings, filter, landmarks)
    return known[2]


def check_answers(settings: Settings, first: Record) -> None:
    """Raise AnswerError that names function and field, for models or filters that cannot handle the first record."""
    streams = Streams(settings.seed, settings.names.scenario)
    filters = settings.filters
    models = problem.models_of(settings.scenario, settings.noise.filter, first.landmarks)
    problem.check(settings.scenario, *models, first, list(filters.values()))
    for name, filter in filters.items():
        if not type(filter).__module__.startswith("estlab."):
            generators = streams.generators(f"filter/{name}", range(first.runs if first.each_its_own else 1))
            try_filter(problem.name_of(filter), filter, *models, first, generators)


def record_of(settings: Settings, runs: Sequence[int]) -> Record:
    """Truth and readings of the runs with these numbers. Raises AnswerError for an invalid record."""
    streams = Streams(settings.seed, settings.names.scenario)
    scenario, data = settings.scenario, settings.data
    if data.source == "files":
        options = (data.options,) if scenario.file_names else ()
        make = partial(scenario.read, Path(data.path or "."), data.prefix, streams, runs, *options)
    else:
        make = partial(scenario.simulate, streams, runs, settings.noise.truth)
    record = problem.recorded(scenario, make, len(runs)).first(settings.steps)
    if settings.dropped == 0.0:
        return record
    if record.readings.step.size == 0:
        raise UserError(
            f"dropped={settings.dropped:g}: {settings.names.scenario} has no readings to drop; leave it out"
        )
    return record.thinned(settings.dropped, streams, runs)


def workers(settings: Settings) -> Workers[Block]:
    """Processes for the blocks of all runs, or of a part; none if parts are merged."""
    count = block_count(settings)
    which, parts = settings.part or (0, 1)
    blocks = range(which * count // parts, (which + 1) * count // parts)
    return Workers(partial(block_of, settings, None), blocks[: 0 if settings.parts else None], settings.cores)


def estimated(
    settings: Settings,
    first: Record,
    workers: Workers[Block],
    progress: Callable[[int], Callable[[int], None]],
) -> Ensemble:
    """All runs of all filters, or those of a part. progress: takes the number of all steps, returns the counter of
    some.

    first: the record of the ensemble's first block.
    """
    ensemble = Ensemble(first)
    steps = progress(len(workers.tasks) * first.time.size * len(settings.filters))
    for number, found in workers.results(partial(block_of, settings, first), steps):
        ensemble.add(number, found)
    taken = sum(1 << level for level, _ in ensemble.blocks.nodes)
    if taken != len(workers.tasks) and not ensemble.failure:
        raise RuntimeError(f"{taken} blocks came back of {len(workers.tasks)}")
    return ensemble


def block_of(settings: Settings, first: Record | None, number: int, on_step: OnStep) -> Block:
    """A block of runs through all filters. first: the record of the first block, if it already exists."""
    runs = block(settings, number)
    record = first if first and number == 0 else record_of(settings, runs)
    streams = Streams(settings.seed, settings.names.scenario)
    found: dict[str, Estimates] = {}
    seconds: dict[str, float] = {}
    for name, filter in settings.filters.items():
        loop = _kept_loop(settings, name, filter, record.landmarks)
        generators = streams.generators(f"filter/{name}", runs if record.each_its_own else range(1))
        loop.prepare(record, generators)
        began = time.perf_counter()
        watched = min(settings.keep_runs, _CLOUDS) if number == 0 else 0
        found |= _found(loop, name, record, generators, on_step, settings.smooth, watched)
        seconds[name] = time.perf_counter() - began
    kept = {name: _kept(record, one, settings.keep_runs) for name, one in found.items()} if number == 0 else {}
    try:
        totals: Totals | str = _totals(settings, record, found, runs)
    except Warning:
        raise
    except Exception as error:
        log.warning("no statistics of runs %d to %d", runs[0], runs[-1], exc_info=True)
        totals = f"{type(error).__name__} in the statistics of runs {runs[0]} to {runs[-1]}: {error}"
    return Block(totals, seconds, kept)


def empty_totals(settings: Settings, record: Record, names: Iterable[str]) -> Totals:
    """Totals of no runs, for these sets of estimates."""
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


def _found(
    loop: Loop, name: str, record: Record, generators: Generators, on_step: OnStep, smooth: bool, watched: int
) -> dict[str, Estimates]:
    if not smooth:
        return {name: loop.estimate(record, generators, on_step, watched)}
    filtered, smoothed = loop.estimate_and_smooth(record, generators, on_step)
    return {name: filtered, name + SMOOTHED: smoothed}


def _kept(record: Record, estimates: Estimates, count: int) -> dict[str, Array]:
    return {
        "truth": record.truth[:, :, :count],
        "mean": estimates.mean[:, :, :count],
        "cov": estimates.cov[:, :, :, :count],
        **{f"cloud.{key}": array for key, array in estimates.cloud.items()},
    }
