"""Runs compiled code over a record: a filter's program, and its results."""

import copy
import math
from typing import Any

import numpy as np

from estlab.compiled import cache, kernels
from estlab.compiled.model_graphs import MotionModel, SensorModel
from estlab.compiled.programs import FIELDS, accesses, filtering, room, smoothing
from estlab.compiled.routines import Routine, Steps, slots
from estlab.filters.filter import chi_square_quantile
from estlab.filters.given import LINE, FilterSetup, Given, Shape
from estlab.maths.linalg import cholesky
from estlab.maths.space import Array
from estlab.record import Estimates, Readings


class FilterProgram:
    """Compiled code for a filter, its models and the shape of the data, with its parameters.

    Raises UntraceableError that names function, file and line, for models that cannot be traced.
    """

    def __init__(self, setup: FilterSetup, shape: Shape, smooth: bool) -> None:
        steps, gated = _steps(setup, shape), setup.filter.traits.gate is not None
        routines: dict[str, Routine]
        if smooth:
            routines = {"smooth": kernels.smooth(steps), "record": kernels.record(steps, gated=False)}
        else:
            routines = {"predict": kernels.predict(steps), "update": kernels.update(steps)}
            routines["record"] = kernels.record(steps, gated)
            if setup.scheme == "interleaved":
                routines["pause"] = kernels.predict(steps, paused=True)
        coordinates = setup.sensor.landmarks.shape[0]
        each = shape.each_control, shape.each_noise, shape.each_landmark
        access = accesses(shape.lanes, *each, coordinates, shape.streamed and not smooth)
        self.lanes = shape.lanes
        self.text = (smoothing if smooth else filtering)(routines, access, steps.n, shape.lanes)
        self.parameters = np.array([*steps.parameters.values, 0.0])
        self._program = cache.program(self.text)
        self._run = self._program.function("run")

    def run(self, fields: dict[str, Any]) -> None:
        """Run it on arrays and numbers by name."""
        numbers = [
            value.ctypes.data if isinstance(value, np.ndarray) else value for value in (fields[name] for name in FIELDS)
        ]
        self._run(np.array(numbers, dtype=np.int64).ctypes.data)


def _steps(setup: FilterSetup, shape: Shape) -> Steps:
    motion, sensor, gate = setup.motion, setup.sensor, setup.filter.traits.gate
    m, coordinates = sensor.space.size, sensor.landmarks.shape[0]
    cov = np.asarray(sensor.noise_cov, dtype=float)
    quantiles = np.full(m + 1, np.inf) if gate is None else chi_square_quantile(gate, np.arange(m + 1))
    return Steps(
        MotionModel(motion.space, motion.move, motion.noise_size, shape.controls, motion.jacobians, motion.hessians),
        SensorModel(
            sensor.space, sensor.state, sensor.measure, coordinates, sensor.jacobian, sensor.hessians, shape.count
        ),
        setup.method(),
        shape.noise,
        (cov.tolist(), cholesky(cov).tolist()),
        quantiles.tolist(),
        shape.masked,
    )


def _in_lines(shape: tuple[int, ...]) -> Array:
    """Room for numbers that begins with a line of the caches."""
    size = math.prod(shape)
    room = np.empty(size + LINE)
    begin = -(room.ctypes.data // 8) % LINE
    return room[begin : begin + size].reshape(shape)


class Through:
    """A record processed by compiled code, with its results."""

    def __init__(self, setup: FilterSetup, program: FilterProgram, given: Given, steps: int) -> None:
        self.program, self.stack, self.stacked = program, given.stack, setup.scheme == "stacked"
        self.n = n = setup.motion.space.size
        runs, (i, j) = given.runs, np.tril_indices(n)
        belief = np.zeros((slots(n), runs))
        belief[:n], belief[n:-2] = given.mean, given.matrix[i, j]
        whitened, log_scale = _in_lines((2, *given.stack.values.shape))
        if not setup.filter.traits.reads:  # else the code fills all of it
            whitened[:] = log_scale[:] = np.nan
        mean, cov, gated = _in_lines((n, steps, runs)), _in_lines((n, n, steps, runs)), np.zeros((steps, runs))
        gate = setup.filter.traits.gate
        self.estimates = Estimates(mean, cov, whitened, log_scale, None, {"gated": gated}, gate)
        bounds = Readings(given.stack.step, given.stack.values, given.stack.landmark_number).bounds(steps)
        landmarks, entries = np.ascontiguousarray(setup.sensor.landmarks, dtype=float), given.table.entries
        self.fields: dict[str, Any] = {
            "runs": runs, "first": 0, "last": steps, "steps": steps, "readings": given.stack.values.shape[1],
            "reading_stride": given.stack.values.strides[0] // 8, "control_stride": given.control.strides[0] // 8,
            "controls": given.control.shape[2], "noises": entries.shape[2], "parameter": program.parameters,
            "lapse": given.lapse, "control": given.control, "noise": entries, "which": given.table.which,
            "noise_rows": entries.shape[1], "bounds": bounds.astype(np.int64), "value": given.stack.values,
            "landmark_number": given.stack.landmark_number, "landmark": landmarks, "landmarks": landmarks.shape[1],
            "pause": int(np.float64(given.pause).view(np.int64)), "at_rest": np.zeros(program.lanes),
            "belief": belief, "room": np.empty(room(n, program.lanes)), "mean": mean, "cov": cov,
            "whitened": whitened, "log_scale": log_scale, "gated": gated,
            "smooth_mean": np.empty(0), "smooth_cov": np.empty(0),
        }  # fmt: skip

    def go(self, first: int, last: int) -> None:
        """Run over these steps."""
        self.program.run(self.fields | {"first": first, "last": last})

    def back(self, program: FilterProgram) -> "Through":
        """Run the smoother, from the last step to the first."""
        found = copy.copy(self)
        mean, cov = self.estimates.mean.copy(), self.estimates.cov.copy()
        nothing = np.full_like(self.estimates.whitened, np.nan)
        found.estimates = Estimates(mean, cov, nothing, nothing, None, {})
        i, j = np.tril_indices(self.n)
        belief = np.zeros_like(self.fields["belief"])
        belief[: self.n], belief[self.n : -2] = mean[:, -1], cov[i, j, -1]
        own = {"parameter": program.parameters, "belief": belief, "smooth_mean": mean, "smooth_cov": cov}
        found.fields = self.fields | own
        program.run(found.fields)
        return found

    def weak(self, runs: int) -> Array:
        """Runs that left the range in which the code is correct; all runs if they share a belief."""
        found = self.estimates
        ends = [part for k in (0, -1) for part in (found.mean[:, k], found.cov[:, :, k])]
        finite = [np.isfinite(part).all(axis=tuple(range(part.ndim - 1))) for part in ends]
        weak = np.asarray((self.fields["belief"][-2] != 0.0) | ~np.logical_and.reduce(finite))
        return np.broadcast_to(weak, (runs,)) if weak.size == 1 else weak

    def whole(self, runs: int) -> Estimates:
        """The results for all runs, even if they share a belief, and for each reading separately."""
        e = self.estimates
        mean, cov, notes, whitened, log_scale = e.mean, e.cov, e.notes, e.whitened, e.log_scale
        if self.stacked:
            whitened, log_scale = self.stack.apart(whitened), self.stack.apart(log_scale)
        if mean.shape[2] < runs:  # they share a belief, and have no readings
            mean, cov, whitened, log_scale = (np.repeat(array, runs, -1) for array in (mean, cov, whitened, log_scale))
            notes = {name: np.repeat(array, runs, -1) for name, array in notes.items()}
        return Estimates(mean, cov, whitened, log_scale, None, notes, e.gate)
