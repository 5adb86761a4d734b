"""The filter loop of particles with compiled work on clouds."""

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from estlab.compiled import cache
from estlab.compiled.trace import UntraceableError
from estlab.errors import UserError
from estlab.filters.compiled_particles import CompiledParticleFilter
from estlab.filters.engine import CompiledLoop, no_compiler, replace_runs, take_runs, untraceable
from estlab.filters.filter import AnyFilter
from estlab.filters.loop import Loop
from estlab.filters.methods import MOST_STATES
from estlab.filters.particle import ParticleFilter
from estlab.filters.particle_code import CompiledGenerators, ParticleCode
from estlab.maths.space import Array
from estlab.maths.streams import Generators
from estlab.record import Estimates, Readings, Record

log = logging.getLogger("estlab")


class ParticleLoop(Loop):
    """The same loop with the same results, except for rounding: the random numbers are the same.

    insist, lanes: as for estlab.filters.engine.CompiledLoop, with lanes as particles at once. Runs with an angle
    beyond the range in which the code is correct run on NumPy, each separately.
    """

    def __init__(self, *parts: Any, insist: bool = True, lanes: int | None = None) -> None:
        super().__init__(*parts)
        self.particle_filter: ParticleFilter = parts[0]
        self.insist, self.lanes = insist, lanes
        self._code: ParticleCode | None = None
        self._refused = False

    @property
    def compiles(self) -> bool:
        return self.motion.space.size <= MOST_STATES

    def check_engine(self) -> None:
        """Raise ValueError for states too large to be unrolled, if compilation is required."""
        if self.insist and not self.compiles:
            n = self.motion.space.size
            raise ValueError(f"it unrolls states of {MOST_STATES} components at most, not {n}; set engine=numpy")

    def prepare(self, record: Record, generators: Generators) -> None:
        """Trace and compile, or find the code compiled earlier, by the first step with a reading in a run."""
        if self._code is None:
            has = np.asarray(~np.isnan(record.readings.values).all(axis=0))
            first = int(np.argmax(has.any(axis=1))) if has.any() else None
            run = np.array([0 if first is None else np.argmax(has[first])])
            step = 0 if first is None else int(record.readings.step[first])
            self._compiled(_one_step(take_runs(record, run), step), generators.take(run), lambda: None, 0)

    def estimate(
        self, record: Record, generators: Generators, on_step: Callable[[], None] = lambda: None, watched: int = 0
    ) -> Estimates:
        found = self._compiled(record, generators, on_step, watched)
        if found is None:
            return super().estimate(record, generators, on_step, watched)
        estimates, weak = found
        if weak.size == 0:
            return estimates
        if not record.each_its_own:
            return super().estimate(record, generators, watched=watched)
        again = super().estimate(
            take_runs(record, weak), generators.take(weak), watched=int(np.count_nonzero(weak < watched))
        )
        replace_runs(estimates, weak, again)
        return estimates

    def _compiled(
        self, record: Record, generators: Generators, on_step: Callable[[], None], watched: int
    ) -> tuple[Estimates, Array] | None:
        """The results of compiled code, and the runs that need NumPy; None if all do."""
        if self._refused:
            return None
        try:
            if (streams := self._streams(generators)) is not None:
                filter = CompiledParticleFilter.of(self.particle_filter, streams.code)
                loop = Loop(filter, self.motion, self.sensor, self.scheme, self.pause)
                estimates = loop.estimate(record, streams, on_step, watched)
                return estimates, np.flatnonzero(streams.flags.any(axis=1))
        except UntraceableError as refusal:
            untraceable(refusal, self.insist)
        except (ImportError, OSError) as error:
            no_compiler(error, self.insist)
        self._refused = True
        return None

    def _streams(self, generators: Generators) -> CompiledGenerators | None:
        """The generators in the form that compiled code continues; None if it does not support them."""
        try:
            self.check_engine()
            self._code = self._code or ParticleCode(self.motion, self.sensor, self.lanes or cache.lanes())
            return CompiledGenerators.at_start(self._code, generators) if self.compiles else None
        except ValueError as error:
            if self.insist:
                raise UserError(f"engine=compiled: {error}") from error
            log.info("engine=numpy, because %s", error)
            return None


def compiled_loop(filter: AnyFilter, *parts: Any, insist: bool) -> Loop:
    """The loop of a filter on the compiled engine. parts, insist: as for both kinds."""
    kind = ParticleLoop if type(filter) is ParticleFilter else CompiledLoop
    return kind(filter, *parts, insist=insist)


def _one_step(record: Record, step: int) -> Record:
    """A record of this step only."""
    one, readings = slice(step, step + 1), record.readings
    taken = readings.step == step
    values, numbers = readings.values[:, taken], readings.landmark_number[taken]
    return replace(
        record,
        start=float(record.time[step - 1]) if step else record.start,
        time=record.time[one],
        truth=record.truth[:, one],
        control=record.control[:, one],
        readings=Readings(np.zeros(values.shape[1], dtype=int), values, numbers),
    )
