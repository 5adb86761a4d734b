"""Checks a record against its contract: one time line, readings in its order, a prior that is a belief."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Array, Space
from estlab.maths.uniform import Uniform
from estlab.models.answers import covariance, instance, kind, numbers, refuse, whole
from estlab.record import Readings, Record


def check_record(where: str, record: Any, state: Space, runs: int) -> Record:
    """Check the record of so many runs. Raises AnswerError that names the field."""
    instance(where, "returned", record, Record)
    _check_time(where, record)
    n, steps = state.size, record.time.size
    numbers(where, "truth is", record.truth, (n, steps, runs), finite=False)
    if np.isinf(record.truth).any():
        refuse(where, "truth is infinite in places; write NaN where it is unknown")
    if not isinstance(record.control, np.ndarray) or record.control.ndim != 3:
        refuse(where, f"control is {kind(record.control)}; must be an array (c, {steps}, {runs} or 1)")
    c = record.control.shape[0]
    numbers(where, "control is", record.control, (c, steps, runs), (c, steps, 1))
    _check_readings(where, record.readings, steps, runs)
    _check_prior(where, record, n, runs)
    if not isinstance(record.landmarks, np.ndarray) or record.landmarks.ndim != 2:
        refuse(where, f"landmarks is {kind(record.landmarks)}; must be an array (p, number of them)")
    if record.origin is not None:
        numbers(where, "origin is", record.origin, (n, runs))
    _check_rest(where, record)
    return record


def check_readings(where: str, readings: Readings, reading: Space, landmarks: Array) -> None:
    """Raise AnswerError unless the readings come from a sensor of this space among these landmarks."""
    m, count = readings.values.shape[0], landmarks.shape[1]
    if m != reading.size:
        refuse(where, f"readings.values has {m} components; the sensor's space has {reading.size}")
    taken = ~np.isnan(readings.values).all(axis=0)
    outside = taken & ((readings.landmark_number < 0) | (readings.landmark_number >= count))
    if outside.any():
        i, run = np.argwhere(outside)[0]
        number = readings.landmark_number[i, run]
        refuse(
            where,
            f"readings.landmark_number is {number} for reading {i} of run {run}; must be 0 to {count - 1}",
        )


def _check_time(where: str, record: Record) -> None:
    time = record.time
    if not isinstance(time, np.ndarray) or time.ndim != 1 or time.size == 0:
        refuse(where, f"time is {kind(time)}; must be an array (T,) of one step or more")
    numbers(where, "time is", time, time.shape)
    if not isinstance(record.start, int | float | np.number) or not np.isfinite(record.start):
        refuse(where, f"start is {kind(record.start)}; must be a finite time")
    if record.start > time[0]:
        refuse(where, f"start is {record.start:g}, after time[0] = {time[0]:g}; the prior must not be later")
    back = np.flatnonzero(np.diff(time) < 0.0)
    if back.size:
        k = int(back[0])
        refuse(where, f"time goes back from {time[k]:.10g} at step {k} to {time[k + 1]:.10g}; it must ascend")


def _check_readings(where: str, readings: Any, steps: int, runs: int) -> None:
    instance(where, "readings is", readings, Readings)
    step, values = readings.step, readings.values
    if not isinstance(step, np.ndarray) or step.ndim != 1:
        refuse(where, f"readings.step is {kind(step)}; must be an array (N,), the step of each reading")
    whole(where, "readings.step is", step, step.shape)
    back = np.flatnonzero(np.diff(step) < 0)
    if back.size:
        i = int(back[0])
        refuse(
            where, f"readings.step goes back from {step[i]} to {step[i + 1]} at reading {i + 1}; sort readings by step"
        )
    for i in (0, -1) if step.size else ():
        if not 0 <= step[i] < steps:
            refuse(where, f"readings.step has {step[i]}; steps are numbered 0 to {steps - 1}")
    if not isinstance(values, np.ndarray) or values.ndim != 3:
        refuse(where, f"readings.values is {kind(values)}; must be an array (m, {step.size}, {runs})")
    numbers(where, "readings.values is", values, (values.shape[0], step.size, runs), finite=False)
    if np.isinf(values).any():
        refuse(where, "readings.values is infinite in places; write NaN where nothing was measured")
    whole(where, "readings.landmark_number is", readings.landmark_number, (step.size, runs))


def _check_prior(where: str, record: Record, n: int, runs: int) -> None:
    prior = record.prior
    if isinstance(prior, Uniform):
        low = numbers(where, "prior.low is", prior.low, (n,))
        high = numbers(where, "prior.high is", prior.high, (n,))
        if (low > high).any():
            i = int(np.argmax(low > high))
            refuse(where, f"prior.low[{i}] is {low[i]:g}, above prior.high[{i}] = {high[i]:g}")
        if prior.runs != runs:
            refuse(where, f"prior.runs is {prior.runs!r}; must be {runs}")
    elif isinstance(prior, Gaussian):
        silent = bool(np.isnan(record.readings.values).all())
        shared = [(n, 1)] if silent and record.control.shape[2] == 1 else []
        numbers(where, "prior.mean is", prior.mean, (n, runs), *shared)
        covariance(where, "prior.cov is", prior.cov, (n, n), (n, n, prior.mean.shape[1]))
    else:
        refuse(where, f"prior is {kind(prior)}; must be a Gaussian or a Uniform")


def _check_rest(where: str, record: Record) -> None:
    for field in ("raw", "extra", "sums"):
        value = getattr(record, field)
        if not isinstance(value, Mapping) or not all(isinstance(array, np.ndarray) for array in value.values()):
            refuse(where, f"{field} is {kind(value)}; must be a dict of arrays by name")
    for field, wanted in (("files", Path), ("remarks", str)):
        value = getattr(record, field)
        if not isinstance(value, tuple) or not all(isinstance(part, wanted) for part in value):
            each = "paths" if wanted is Path else "sentences"
            refuse(where, f"{field} is {kind(value)}; must be a tuple of {each}")
