"""The filter loop as compiled code: traces the models and unrolls the whole step over vectors of runs."""

import logging
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

from estlab.compiled.trace import UntraceableError
from estlab.errors import UserError
from estlab.filters.given import FilterSetup, Given, Shape
from estlab.filters.loop import Loop
from estlab.filters.through import FilterProgram, Through
from estlab.maths.space import Array
from estlab.maths.streams import Generators
from estlab.record import Estimates, Readings, Record

log = logging.getLogger("estlab")

_AT_ONCE = 200_000  # steps of runs between calls of on_step, well under a second: compiled code cannot be interrupted


class CompiledLoop(Loop):
    """The same loop with the same results, except for rounding.

    insist: raise UserError if filter or models cannot be compiled; otherwise they run on NumPy. lanes: the largest
    number of runs at once; None: as many as the processor allows. Runs that leave the range in which the code is
    correct (a covariance without a factor, an angle of a million, a number that is not finite) run on NumPy, each
    separately.
    """

    def __init__(self, *parts: Any, insist: bool = True, lanes: int | None = None) -> None:
        super().__init__(*parts)
        self.insist, self.lanes = insist, lanes
        self.setup = FilterSetup(self.filter, self.motion, self.sensor, self.scheme, self.pause)

    @property
    def compiles(self) -> bool:
        try:
            self.setup.method()
        except ValueError:
            return False
        return True

    def check_engine(self) -> None:
        """Raise ValueError for a filter that cannot be compiled, if compilation is required."""
        if self.insist:
            self.setup.method()

    def prepare(self, record: Record, generators: Generators) -> None:
        """Trace and compile, or find the code compiled earlier."""
        if not self._programs and (given := self._given(record, generators)) is not None:
            self._built(given.shape, smooth=False)

    def estimate(
        self, record: Record, generators: Generators, on_step: Callable[[], None] | None = None, watched: int = 0
    ) -> Estimates:
        given = self._given(record, generators)
        program = None if given is None else self._built(given.shape, smooth=False)
        if given is None or program is None:
            return super().estimate(record, generators, on_step or _nothing, watched)
        found = self._through(program, given, record, on_step)
        estimates, weak = found.whole(record.runs), found.weak(record.runs)
        if weak.any():
            replace_runs(estimates, weak, super().estimate(take_runs(record, weak), generators))
        return estimates

    def estimate_and_smooth(
        self, record: Record, generators: Generators, on_step: Callable[[], None] | None = None
    ) -> tuple[Estimates, Estimates]:
        given = self._given(record, generators)
        program = None if given is None else self._built(given.shape, smooth=False)
        back = None if given is None else self._built(given.shape, smooth=True)
        if given is None or program is None or back is None:
            return super().estimate_and_smooth(record, generators, on_step or _nothing)
        found = self._through(program, given, record, on_step)
        smoothed = found.back(back)
        weak = found.weak(record.runs) | smoothed.weak(record.runs)
        pair = found.whole(record.runs), smoothed.whole(record.runs)
        if weak.any():
            for mine, numpy in zip(pair, super().estimate_and_smooth(take_runs(record, weak), generators), strict=True):
                replace_runs(mine, weak, numpy)
        return pair

    def _given(self, record: Record, generators: Generators) -> Given | None:
        """The record in the form that compiled code takes; None if this filter has none."""
        try:
            return Given(self.setup, record, generators, self.lanes)
        except ValueError:
            if self.insist:
                raise
        except (ImportError, OSError) as error:
            no_compiler(error, self.insist)
        return None

    @cached_property
    def _programs(self) -> dict[tuple[Shape, bool], FilterProgram | None]:
        return {}

    def _built(self, shape: Shape, smooth: bool) -> FilterProgram | None:
        """The program for data of this shape; None if the models cannot be traced and that is no error."""
        if (shape, smooth) not in self._programs:
            try:
                self._programs[shape, smooth] = FilterProgram(self.setup, shape, smooth)
            except UntraceableError as refusal:
                untraceable(refusal, self.insist)
                self._programs[shape, smooth] = None
        return self._programs[shape, smooth]

    def _through(
        self, program: FilterProgram, given: Given, record: Record, on_step: Callable[[], None] | None
    ) -> Through:
        steps, size = record.time.size, max(1, _AT_ONCE // given.runs)
        found = Through(self.setup, program, given, steps)
        for first in range(0, steps, size):
            last = min(first + size, steps)
            found.go(first, last)
            if on_step is not None:  # it would take longer than a step does
                for _ in range(first, last):
                    on_step()
        return found


def untraceable(refusal: UntraceableError, insist: bool) -> None:
    """Say that models are refused: as an error if compiled code is insisted on."""
    if insist:
        raise UserError(f"engine=compiled cannot trace {refusal}; set engine=numpy") from refusal
    log.info("engine=numpy, because the models cannot be traced: %s", refusal)


def no_compiler(error: ImportError | OSError, insist: bool) -> None:
    """Say that the compiler cannot be loaded: as an error if compiled code is insisted on."""
    reason = f"llvmlite cannot be loaded ({' '.join(str(error).split())})"
    if insist:
        raise UserError(f"engine=compiled: {reason}; reinstall it, or set engine=numpy") from error
    log.warning("engine=numpy, because %s", reason)


def _nothing() -> None:
    """For steps that nobody counts."""


def take_runs(record: Record, runs: Array) -> Record:
    """Some of the runs of a record."""
    readings = record.readings
    control = record.control if record.control.shape[2] == 1 else record.control[:, :, runs]
    prior = record.prior.take(runs) if record.each_its_own else record.prior
    part = Readings(readings.step, readings.values[:, :, runs], readings.landmark_number[:, runs])
    return replace(record, truth=record.truth[:, :, runs], control=control, readings=part, prior=prior)


def replace_runs(estimates: Estimates, runs: Array, part: Estimates) -> None:
    """Replace those of some runs."""
    for name in ("mean", "cov", "whitened", "log_scale"):
        getattr(estimates, name)[..., runs] = getattr(part, name)
    for name, values in part.notes.items():
        estimates.notes[name][:, runs] = values
    if estimates.sample is not None and part.sample is not None:
        estimates.sample[..., runs] = part.sample
    for name in part.cloud.keys() - {"step"}:  # of the first runs alone
        kept = part.cloud[name]
        estimates.cloud[name][..., runs[: kept.shape[-1]]] = kept
