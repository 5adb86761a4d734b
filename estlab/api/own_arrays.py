"""Your own arrays as a record: each is checked for its shape, and a fault gets one line."""

from typing import Any

import numpy as np

from estlab.errors import UserError
from estlab.filters.filter import Prior
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Array
from estlab.maths.uniform import Uniform
from estlab.models.contract import Motion, Sensor
from estlab.record import Readings, Record
from estlab.validation.records import check_readings, check_record


def record_of_arrays(
    motion: Motion,
    sensor: Sensor,
    prior: Prior,
    time: Any,
    readings: Any,
    control: Any,
    start: float | None,
    landmark: Any,
    truth: Any,
) -> Record:
    """The record of these arrays, with the shapes of :func:`estlab.estimate`.

    Raises UserError for an array of another shape, with the required shape.
    """
    n, m = motion.space.size, sensor.space.size
    times = _numbers("time", time)
    if times.ndim != 1 or times.size == 0:
        raise UserError(f"time has the shape {times.shape}; must be (T,), one number for each time")
    steps = times.size
    values = _numbers("readings", readings)
    runs = values.shape[2] if values.ndim == 3 else 1
    values = _shaped("readings", values, (m, steps, runs), f"m = {m} components of the sensor")
    taken = np.flatnonzero(np.isfinite(values).any(axis=(0, 2)))
    about = _about(landmark, steps, runs)
    commands = np.empty((0, steps, 1)) if control is None else _commands(_numbers("control", control), steps, runs)
    known = np.full((n, steps, runs), np.nan) if truth is None else _numbers("truth", truth)
    record = Record(
        start=float(times[0]) if start is None else float(start),
        time=times,
        truth=_shaped("truth", known, (n, steps, runs), f"n = {n} components of the state"),
        control=commands,
        readings=Readings(taken, values[:, taken], about[taken]),
        prior=_prior(prior, n, runs),
        landmarks=sensor.landmarks,
    )
    check_record("arrays", record, motion.space, runs)
    check_readings("arrays", record.readings, sensor.space, sensor.landmarks)
    return record


def _numbers(name: str, values: Any) -> Array:
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise UserError(f"{name} must be an array of numbers ({error})") from error


def _shaped(name: str, values: Array, shape: tuple[int, int, int], first: str) -> Array:
    """The array with an axis of runs."""
    whole = values[..., None] if values.ndim == 2 else values
    if whole.shape != shape:
        size, steps, runs = shape
        turned = f"; it is transposed, write {name}.T" if values.shape == (steps, size) else ""
        wanted = f"({size}, {steps})" if runs == 1 else f"({size}, {steps}, {runs})"
        raise UserError(f"{name} has the shape {values.shape}; must be {wanted}: {first}, then time{turned}")
    return whole


def _commands(values: Array, steps: int, runs: int) -> Array:
    """(c, T, runs), or (c, T, 1) if all runs have the same commands."""
    whole = values[..., None] if values.ndim == 2 else values
    if whole.ndim != 3 or whole.shape[1] != steps or whole.shape[2] not in (1, runs):
        turned = "; it is transposed, write control.T" if values.ndim == 2 and len(values) == steps else ""
        raise UserError(f"control has the shape {values.shape}; must be (c, {steps}) or (c, {steps}, {runs}){turned}")
    return whole


def _about(landmark: Any, steps: int, runs: int) -> Array:
    """(T, runs) integers."""
    if landmark is None:
        return np.zeros((steps, runs), dtype=int)
    numbers = np.asarray(landmark)
    if numbers.dtype.kind not in "iu" or numbers.shape not in ((steps,), (steps, runs)):
        raise UserError(
            f"landmark has the shape {numbers.shape} and the type {numbers.dtype}; must be ({steps},) or "
            f"({steps}, {runs}) of integers"
        )
    return np.array(np.broadcast_to(numbers.reshape(steps, -1), (steps, runs)))


def _prior(prior: Any, n: int, runs: int) -> Prior:
    """The prior of all runs."""
    if isinstance(prior, Uniform):
        return prior._replace(runs=runs)
    if not isinstance(prior, Gaussian):
        raise UserError(f"prior is a {type(prior).__name__}; must be an estlab.Gaussian or an estlab.Uniform")
    mean, cov = _numbers("prior.mean", prior.mean), _numbers("prior.cov", prior.cov)
    if mean.shape not in ((n,), (n, runs)) or cov.shape not in ((n, n), (n, n, runs)):
        raise UserError(
            f"prior has the shapes {mean.shape} and {cov.shape}; must be ({n},) and ({n}, {n}): a mean and a covariance"
        )
    return Gaussian(np.array(np.broadcast_to(mean.reshape(n, -1), (n, runs))), cov)
