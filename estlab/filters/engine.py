"""The filter loop as compiled code: the models traced, the whole step unrolled over vectors of runs."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from estlab.compiled import cache
from estlab.compiled.kernels import Piece, Steps, slots
from estlab.compiled.models import MotionModel, SensorModel
from estlab.compiled.programs import FIELDS, accesses, filtering, room, smoothing
from estlab.compiled.trace import Refused
from estlab.errors import UserError
from estlab.filters.contract import chi_square_quantile
from estlab.filters.loop import Loop
from estlab.filters.methods import method_of
from estlab.filters.stacks import Stack, one_by_one, stacked
from estlab.filters.tables import NoiseTable, noise_table
from estlab.maths.linalg import cholesky
from estlab.maths.space import Array
from estlab.maths.streams import Draws
from estlab.record import Estimates, Readings, Record

log = logging.getLogger("estlab")

_AT_ONCE = 200_000  # steps of runs between ticks, well under a second: compiled code hears no interruption


@dataclass(frozen=True)
class Shape:
    """What the text of a program depends on, besides filter and models.

    controls: components of a command. each_control, each_noise: whether runs have their own. noise: the entries of the
    process noise that are not zero. count: readings taken as one. lanes: runs at once.
    """

    controls: int
    each_control: bool
    noise: tuple[tuple[int, int], ...]
    each_noise: bool
    count: int
    lanes: int


class Given:
    """A record as compiled code takes it, with the belief at its start."""

    def __init__(self, loop: "CompiledLoop", record: Record, draws: Draws) -> None:
        method = method_of(loop.filter, loop.motion, loop.sensor)
        factors = method.transform == "factors" or (method.augmented and method.transform == "points")
        self.lapse = np.diff(record.time, prepend=record.start)
        pause = loop.pause if loop.scheme == "interleaved" else 0.0
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            start = loop.filter.start(record.prior, draws)
            self.table: NoiseTable = noise_table(loop.motion, record.control, self.lapse, pause, factors)
        self.mean, self.matrix = start
        self.runs = self.mean.shape[1]
        self.stack: Stack = (stacked if loop.scheme == "stacked" else one_by_one)(record.readings, self.runs)
        self.control = np.ascontiguousarray(record.control, dtype=float)
        lanes = loop.lanes or cache.lanes()
        while lanes > self.runs:
            lanes //= 2
        self.shape = Shape(
            record.control.shape[0],
            record.control.shape[2] > 1,
            self.table.places,
            self.table.entries.shape[2] > 1,
            self.stack.count,
            lanes,
        )


class CompiledLoop(Loop):
    """The same loop to the same numbers but for rounding.

    insist: raise UserError if filter or models cannot be compiled; else they run on NumPy. Runs in which something is
    beyond what the code is right for (a covariance without a factor, an angle of a million, a number that is not
    finite) are gone through by NumPy, each for itself.
    """

    insist = True
    lanes: int | None = None  # how many runs at once, at most; None: as many as the processor takes

    def check_engine(self) -> None:
        """Raise ValueError for a filter that is not compiled, if the engine is insisted on."""
        if self.insist:
            method_of(self.filter, self.motion, self.sensor)

    def prepare(self, record: Record, draws: Draws) -> None:
        """Trace and compile, or find it compiled."""
        if (given := self._given(record, draws)) is not None:
            self._built(given.shape, smooth=False)

    def estimate(self, record: Record, draws: Draws, tick: Callable[[], None] | None = None) -> Estimates:
        given = self._given(record, draws)
        program = None if given is None else self._built(given.shape, smooth=False)
        if given is None or program is None:
            return super().estimate(record, draws, tick or _unheard)
        found = self._through(program, given, record, tick)
        estimates = found.whole(record.runs)
        weak = found.weak(record.runs)
        if weak.any():
            _put(estimates, weak, super().estimate(_of(record, weak), draws))
        return estimates

    def estimate_and_smooth(
        self, record: Record, draws: Draws, tick: Callable[[], None] | None = None
    ) -> tuple[Estimates, Estimates]:
        given = self._given(record, draws)
        program = None if given is None else self._built(given.shape, smooth=False)
        back = None if given is None else self._built(given.shape, smooth=True)
        if given is None or program is None or back is None:
            return super().estimate_and_smooth(record, draws, tick or _unheard)
        found = self._through(program, given, record, tick)
        smoothed = found.back(back)
        weak = found.weak(record.runs) | smoothed.weak(record.runs)
        pair = found.whole(record.runs), smoothed.whole(record.runs)
        if weak.any():
            for mine, numpy in zip(pair, super().estimate_and_smooth(_of(record, weak), draws), strict=True):
                _put(mine, weak, numpy)
        return pair

    def _given(self, record: Record, draws: Draws) -> Given | None:
        """The record as compiled code takes it; None if there is none for this filter."""
        try:
            return Given(self, record, draws)
        except ValueError:
            if self.insist:
                raise
            return None

    @cached_property
    def _programs(self) -> "dict[tuple[Shape, bool], Program | None]":
        return {}

    def _built(self, shape: Shape, smooth: bool) -> "Program | None":
        """The program for data of this shape; None if the models are refused, and that is no error."""
        if (shape, smooth) not in self._programs:
            try:
                self._programs[shape, smooth] = Program(self, shape, smooth)
            except Refused as refusal:
                if self.insist:
                    raise UserError(f"engine=compiled cannot trace {refusal}; take engine=numpy") from refusal
                log.info("engine=numpy, since models cannot be traced: %s", refusal)
                self._programs[shape, smooth] = None
        return self._programs[shape, smooth]

    def _through(
        self, program: "Program", given: Given, record: Record, tick: Callable[[], None] | None
    ) -> "Through":
        found = Through(self, program, given, record)
        steps, size = record.time.size, max(1, _AT_ONCE // given.runs)
        for first in range(0, steps, size):
            last = min(first + size, steps)
            found.go(first, last)
            if tick is not None:  # it would take longer than a step does
                for _ in range(first, last):
                    tick()
        return found


def _unheard() -> None:
    """A tick that nobody counts."""


class Program:
    """Compiled code for a filter, its models and data of a shape, with its parameters."""

    def __init__(self, loop: CompiledLoop, shape: Shape, smooth: bool) -> None:
        motion, sensor, filter = loop.motion, loop.sensor, loop.filter
        m, coordinates = sensor.space.size, sensor.places.shape[0]
        cov = np.asarray(sensor.noise_cov, dtype=float)
        gate = getattr(filter, "gate", None)
        quantiles = np.full(m + 1, np.inf) if gate is None else chi_square_quantile(gate, np.arange(m + 1))
        steps = Steps(
            MotionModel(
                motion.space, motion.move, motion.noise_size, shape.controls, motion.jacobians, motion.hessians
            ),
            SensorModel(
                sensor.space, sensor.state, sensor.measure, coordinates, sensor.slope, sensor.hessians, shape.count
            ),
            method_of(filter, motion, sensor),
            shape.noise,
            (cov.tolist(), cholesky(cov).tolist()),
            quantiles.tolist(),
        )
        pieces: dict[str, Piece] = {}
        if smooth:
            pieces["smooth"], pieces["record"] = steps.smooth(), steps.record(gated=False)
        else:
            pieces["predict"], pieces["update"], pieces["record"] = steps.predict(), steps.update(), steps.record()
            if loop.scheme == "interleaved":
                pieces["pause"] = steps.predict(paused=True)
        access = accesses(shape.lanes, shape.each_control, shape.each_noise, coordinates)
        self.lanes, self.n = shape.lanes, motion.space.size
        self.text = (smoothing if smooth else filtering)(pieces, access, self.n, shape.lanes)
        self.parameters = np.array([*steps.parameters.values, 0.0])
        self._run = cache.program(self.text).function("run")

    def run(self, fields: dict[str, Any]) -> None:
        """Run it on arrays and numbers by name."""
        numbers = [
            value.ctypes.data if isinstance(value, np.ndarray) else value
            for value in (fields[name] for name in FIELDS)
        ]
        self._run(np.array(numbers, dtype=np.int64).ctypes.data)


class Through:
    """A record gone through by compiled code, with what it found."""

    def __init__(self, loop: CompiledLoop, program: Program, given: Given, record: Record) -> None:
        self.program, self.loop = program, loop
        steps, runs, n = record.time.size, given.runs, loop.motion.space.size
        i, j = np.tril_indices(n)
        belief = np.zeros((slots(n), runs))
        belief[:n], belief[n:-2] = given.mean, given.matrix[i, j]
        fits = np.full((2, *given.stack.values.shape), np.nan)
        gate = getattr(loop.filter, "gate", None)
        self.stack = given.stack
        # What only a gate fills is left to the system until it is looked at.
        gated = np.zeros((steps, runs))
        self.estimates = Estimates(
            np.empty((n, steps, runs)), np.empty((n, n, steps, runs)), fits[0], fits[1], None, {"gated": gated}, gate
        )
        pause = np.array([loop.pause if loop.scheme == "interleaved" else 0.0])
        places = np.ascontiguousarray(loop.sensor.places, dtype=float)
        self.fields: dict[str, Any] = {
            "runs": runs, "first": 0, "last": steps, "steps": steps, "readings": given.stack.values.shape[1],
            "controls": given.control.shape[2], "noises": given.table.entries.shape[2],
            "parameter": program.parameters, "lapse": given.lapse, "control": given.control,
            "noise": given.table.entries, "which": given.table.which, "noise_rows": given.table.entries.shape[1],
            "bounds": Readings(given.stack.step, fits, fits).bounds(steps).astype(np.int64),
            "value": given.stack.values, "target": given.stack.target, "place": places, "places": places.shape[1],
            "pause": int(pause.view(np.int64)[0]), "at_rest": np.zeros(max(program.lanes, 1)), "belief": belief,
            "room": np.empty(room(n, program.lanes)), "mean": self.estimates.mean, "cov": self.estimates.cov,
            "whitened": fits[0], "log_scale": fits[1], "gated": gated,
            "smooth_mean": np.empty(0), "smooth_cov": np.empty(0),
        }  # fmt: skip

    def go(self, first: int, last: int) -> None:
        """Over these steps."""
        self.program.run(self.fields | {"first": first, "last": last})

    def back(self, program: Program) -> "Through":
        """What is smoothed, from the last step to the first."""
        import copy

        found = copy.copy(self)
        mean, cov = self.estimates.mean.copy(), self.estimates.cov.copy()
        nothing = np.full_like(self.estimates.whitened, np.nan)
        found.estimates = Estimates(mean, cov, nothing, nothing, None, {})
        n = self.loop.motion.space.size
        i, j = np.tril_indices(n)
        belief = np.zeros_like(self.fields["belief"])
        belief[:n], belief[n:-2] = mean[:, -1], cov[i, j, -1]
        own = {"parameter": program.parameters, "belief": belief, "smooth_mean": mean, "smooth_cov": cov}
        found.fields = self.fields | own
        program.run(found.fields)
        return found

    def weak(self, runs: int) -> Array:
        """Runs in which something was beyond what the code is right for, all of them if they share a belief."""
        last = self.estimates.mean[:, -1], self.estimates.cov[:, :, -1]
        first = self.estimates.mean[:, 0], self.estimates.cov[:, :, 0]
        finite = [np.isfinite(part).all(axis=tuple(range(part.ndim - 1))) for part in (*last, *first)]
        weak = (self.fields["belief"][-2] != 0.0) | ~np.logical_and.reduce(finite)
        return np.broadcast_to(weak, (runs,)) if weak.size == 1 else weak

    def whole(self, runs: int) -> Estimates:
        """What was found, of all runs, also of those that share a belief, and of each reading by itself."""
        e = self.estimates
        whitened, log_scale = e.whitened, e.log_scale
        if self.loop.scheme == "stacked":
            whitened, log_scale = self.stack.apart(whitened), self.stack.apart(log_scale)
        mean, cov, notes = e.mean, e.cov, e.notes
        if (own := mean.shape[2]) < runs:  # they share a belief, and have no readings
            mean, cov, whitened, log_scale = (
                np.repeat(array, runs, axis=-1) if own == 1 else array for array in (mean, cov, whitened, log_scale)
            )
            notes = {name: np.repeat(array, runs, axis=-1) for name, array in notes.items()}
        return Estimates(mean, cov, whitened, log_scale, None, notes, e.gate)


def _of(record: Record, runs: Array) -> Record:
    """Some of the runs of a record."""
    from dataclasses import replace

    readings = record.readings
    control = record.control if record.control.shape[2] == 1 else record.control[:, :, runs]
    prior = record.prior.of(runs) if record.each_its_own else record.prior
    values, target = readings.values[:, :, runs], readings.target[:, runs]
    part = Readings(readings.step, values, target)
    return replace(record, truth=record.truth[:, :, runs], control=control, readings=part, prior=prior)


def _put(estimates: Estimates, runs: Array, part: Estimates) -> None:
    """Those of some runs in their place."""
    for name in ("mean", "cov", "whitened", "log_scale"):
        getattr(estimates, name)[..., runs] = getattr(part, name)
    for name, values in part.notes.items():
        estimates.notes[name][:, runs] = values
