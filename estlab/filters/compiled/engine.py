"""The filter loop as compiled code: what ``engine=numba`` runs."""

from collections.abc import Callable
from typing import Any

import numpy as np

from estlab.errors import UserError
from estlab.filters.compiled.models import name_of
from estlab.filters.compiled.source import Plan
from estlab.filters.contract import chi_square_quantile
from estlab.filters.gaussian import DeadReckoning, GaussianFilter
from estlab.filters.loop import Loop
from estlab.maths.linalg import cholesky
from estlab.maths.sigma_points import Cubature, GaussHermite, Julier, Scaled, SigmaPoints, Simplex
from estlab.maths.space import Array
from estlab.maths.streams import Draws
from estlab.maths.transforms import Linearised
from estlab.models.contract import Motion
from estlab.record import Estimates, Record

_TRANSFORMS = (Linearised, Scaled, Julier, Cubature, Simplex, GaussHermite)
_AT_ONCE = 200_000  # points of steps of runs between ticks, under a second: compiled code hears no interruption


def _unheard() -> None:
    """A tick that nobody counts."""


class CompiledLoop(Loop):
    """The same loop to the same numbers but for rounding, for filters of the Gaussian family.

    It is compiled once for each motion, sensor and kind of transform, and kept between starts.
    """

    def check_engine(self) -> None:
        """Raise ValueError for a filter, models or a scheme that are not compiled; UserError if there is no Numba."""
        known = type(self.filter) in (GaussianFilter, DeadReckoning)
        if not known or type(getattr(self.filter, "transform", None)) not in _TRANSFORMS:
            raise ValueError("it compiles ekf, ukf, ckf, ghkf and dead_reckoning, not this filter; take engine=numpy")
        if self.scheme == "stacked":
            raise ValueError("it compiles no scenario.update=stacked; take sequential, interleaved or engine=numpy")
        for function in (self.motion.move, self.motion.jacobians, self.sensor.measure, self.sensor.slope):
            try:
                name_of(function) if function is not None else None
            except ValueError as error:
                raise ValueError(f"{error}; take engine=numpy") from error
        check_installed()

    def check_smoother(self) -> None:
        raise ValueError("engine=numba has no smoother; take engine=numpy")

    def prepare(self, record: Record, draws: Draws) -> None:
        """Compile the loop, or find it compiled, by going one step."""
        self.estimate(record.first(1), draws)

    def estimate(
        self, record: Record, draws: Draws, tick: Callable[[], None] = _unheard, watched: int = 0
    ) -> Estimates:
        from estlab.filters.compiled import cache

        filter = self.filter
        assert isinstance(filter, GaussianFilter)
        plan = self._plan(filter, record)
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            belief = filter.start(record.prior, draws)
            given = self._given(plan, filter, record)
        steps, runs, n = record.time.size, belief.mean.shape[1], self.motion.space.size
        state = _whole(belief.mean).copy(), _whole(belief.cov).copy()
        mean, cov, gated = np.empty((n, steps, runs)), np.empty((n, n, steps, runs)), np.zeros((steps, runs))
        whitened, log_scale = np.full((2, *record.readings.values.shape), np.nan)
        points = given[-1]
        first, size = 0, max(1, _AT_ONCE // (runs * (1 + points[1].size)))
        while first < steps:
            last = min(first + size, steps)
            arguments = (first, last, *given, *state, mean, cov, whitened, log_scale, gated)
            cache.loop(plan, arguments)(*arguments)
            if tick is not _unheard:  # it would take a quarter as long as the steps do
                for _ in range(first, last):
                    tick()
            first = last
        if runs < record.runs:  # they share a belief, and have no readings
            mean, cov, gated = (np.repeat(array, record.runs, axis=-1) for array in (mean, cov, gated))
        return Estimates(mean, cov, whitened, log_scale, None, {"gated": gated}, filter.gate)

    def _plan(self, filter: GaussianFilter, record: Record) -> Plan:
        motion, sensor = self.motion, self.sensor
        linearised = isinstance(filter.transform, Linearised)
        return Plan(
            motion.move,
            motion.jacobians,
            sensor.measure,
            sensor.slope,
            motion.space,
            sensor.space,
            motion.noise_size,
            record.control.shape[0],
            record.places.shape[0],
            linearised,
            # Along a tangent both are the same.
            filter.noise == "augmented" and not linearised,
        )

    def _given(self, plan: Plan, filter: GaussianFilter, record: Record) -> tuple[Any, ...]:
        """What the loop is given, in its order: time line, commands, noises, readings, gate, points."""
        lapse = np.diff(record.time, prepend=record.start)
        pause = self.pause if self.scheme == "interleaved" else 0.0
        noise, which = noises(self.motion, record.control, lapse, pause)
        reading_noise = np.asarray(self.sensor.noise_cov, dtype=float)
        if plan.augmented:
            noise, reading_noise = cholesky(noise), cholesky(reading_noise)
        m = self.sensor.space.size
        quantiles = np.full(m + 1, np.inf)
        if filter.gate is not None:
            quantiles = chi_square_quantile(filter.gate, np.arange(m + 1))
        readings = record.readings
        return (
            lapse,
            _whole(record.control),
            _whole(np.moveaxis(noise, (0, 1), (2, 3))),
            which,
            float(pause),
            _whole(readings.bounds(record.time.size), np.int64),
            _whole(readings.values),
            _whole(readings.target, np.int64),
            _whole(record.places),
            _whole(reading_noise),
            quantiles,
            not isinstance(filter, DeadReckoning),
            _points(plan, filter),
        )


def check_installed() -> None:
    """Raise UserError, with the remedy, if Numba cannot be imported."""
    try:
        import numba  # noqa: F401
    except Exception as error:  # of the wrong NumPy or llvmlite it raises what it likes
        there = "" if isinstance(error, ModuleNotFoundError) else f" ({' '.join(str(error).split())})"
        raise UserError(f'engine=numba needs numba: pip install "estlab[fast]"{there}') from error


def noises(motion: Motion, control: Array, lapse: Array, pause: float) -> tuple[Array, Array]:
    """Process noise covariances (q, q, K, runs or 1), and which of them (T,) each step has; the last is of a pause.

    Steps that last as long are asked for together, as if they were runs.
    """
    c, steps, runs = control.shape
    q = motion.noise_size
    found: list[Array] = []
    which, count = np.zeros(steps, dtype=np.int64), 0
    order = np.argsort(lapse, kind="stable")
    for alike in np.split(order, np.flatnonzero(np.diff(lapse[order])) + 1):
        dt = float(lapse[alike[0]])
        if dt <= 0.0:
            continue  # no time passes, nothing moves
        cov = motion.noise_cov(control[:, alike].reshape(c, alike.size * runs), dt)
        same = cov.ndim == 2 or cov.shape[2] == 1
        found.append(cov.reshape(q, q, 1, 1) if same else cov.reshape(q, q, alike.size, runs))
        which[alike] = count if same else count + np.arange(alike.size)
        count += found[-1].shape[2]
    still = np.asarray(motion.noise_cov(np.zeros((c, 1)), pause)) if pause > 0.0 else np.zeros((q, q))
    found.append(still.reshape(q, q, 1, 1))
    most = max(cov.shape[3] for cov in found)
    return np.concatenate([np.broadcast_to(cov, (*cov.shape[:3], most)) for cov in found], axis=2), which


def _points(plan: Plan, filter: GaussianFilter) -> tuple[Array, Array, Array, Array, float]:
    """Where the points of motion and sensor lie for unit covariance, (axes, p), and what they weigh; the bonus."""
    transform = filter.transform
    if not isinstance(transform, SigmaPoints):
        return np.empty((0, 0)), np.empty(0), np.empty((0, 0)), np.empty(0), 0.0
    n = plan.state.size
    axes = [n + plan.noises, n + plan.reading.size] if plan.augmented else [n, n]
    (motion, of_motion), (sensor, of_sensor) = (
        (_whole(transform.offsets(np.eye(size))), _whole(transform.weights(size))) for size in axes
    )
    return motion, of_motion, sensor, of_sensor, float(transform.bonus())


def _whole(array: Array, kind: type = np.float64) -> Array:
    """As the loop was compiled for: in one piece, of this kind of number, and not read-only, which is another type."""
    return np.require(array, kind, ["C", "A", "W"])
