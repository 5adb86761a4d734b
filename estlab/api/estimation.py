"""A filter over arrays of your own: no scenario, no configuration, no directory."""

from dataclasses import replace
from typing import Any, Literal

import numpy as np

from estlab.api.estimates import FilterEstimates
from estlab.api.own_arrays import record_of_arrays
from estlab.config.build import filter_of
from estlab.errors import UserError
from estlab.filters.engine import CompiledLoop
from estlab.filters.filter import AnyFilter, Filter, Prior
from estlab.filters.loop import Loop
from estlab.launch.shipped import shipped_filter
from estlab.maths.streams import Streams
from estlab.models.answers import instance
from estlab.models.checks import check_motion, check_noise, check_sensor, check_space, try_motion, try_sensor
from estlab.models.contract import Motion, Sensor
from estlab.record import Estimates, Record

Engine = Literal["auto", "numpy", "compiled"]


def make_filter(name: str, **settings: Any) -> AnyFilter:
    """A filter by its name in ``estlab list filters``, with its default settings, except those that you give.

    Raises UserError for an unknown name or setting, and for an invalid value.

    >>> import estlab
    >>> estlab.make_filter("ekf", gate=0.999).gate
    0.999
    >>> estlab.make_filter("ekf", gate=2)
    Traceback (most recent call last):
    estlab.errors.UserError: filter.gate must lie between 0 and 1, or be null, got 2
    """
    return filter_of(shipped_filter(name) | settings)


def estimate(
    filter: AnyFilter | str,
    motion: Motion,
    sensor: Sensor,
    prior: Prior,
    time: Any,
    readings: Any,
    control: Any = None,
    *,
    start: float | None = None,
    landmark: Any = None,
    truth: Any = None,
    smooth: bool = False,
    seed: int = 1,
    engine: Engine = "auto",
) -> FilterEstimates:
    """A filter's estimates from readings: the belief after each of T times.

    n components of the state, m of a reading, c of a command. For one record of readings leave the axis of runs out;
    with it, all runs go through the filter together.

    filter: an object, or a name for :func:`make_filter`.
    motion, sensor: the models, see docs/python.md.
    prior: at ``start``: Gaussian with mean (n,) and cov (n, n), the same for all runs, or with mean (n, runs); Uniform.
    time: (T,) [s], ascending. readings: (m, T) or (m, T, runs), NaN where nothing was measured.
    control: (c, T) or (c, T, runs), over the step that ends at each time; None for a motion without commands.
    start: the time of the prior [s]; time[0] by default, where the first reading updates the prior itself.
    landmark: (T,) or (T, runs) the number of the landmark that each reading is about, among ``sensor.landmarks``; 0.
    truth: (n, T) or (n, T, runs), for the errors in the result.
    smooth: estimates from all readings (Rauch-Tung-Striebel), for the Gaussian family.
    seed: for filters that draw random numbers.
    engine: "numpy", "compiled", or "auto": compiled where possible.

    Raises UserError, in one line, for arrays whose shapes do not go together, for models that do not answer as they
    must, and for a filter that is not defined for them.

    >>> import numpy as np
    >>> from estlab import Gaussian, Motion, Sensor, Space, estimate
    >>> track, range_ = Space(("height", "speed"), ("m", "m/s")), Space(("height",), ("m",))
    >>> def fall(state, control, noise, dt):
    ...     height, speed = state
    ...     return height + speed * dt, speed - 9.81 * dt + noise[0]
    >>> def measure(state, landmark):
    ...     return (state[0],)
    >>> motion = Motion(track, fall, lambda control, dt: np.array([[0.01 * dt]]), 1)
    >>> sensor = Sensor(range_, track, measure, np.array([[0.25]]))
    >>> time = np.arange(0.1, 1.01, 0.1)
    >>> readings = (100.0 - 0.5 * 9.81 * time**2)[None]
    >>> prior = Gaussian(np.array([90.0, 0.0]), np.diag([100.0, 1.0]))
    >>> found = estimate("ekf", motion, sensor, prior, time, readings, start=0.0)
    >>> found["height"].mean[-1].round(1)
    np.float64(95.1)
    >>> found.nis.shape
    (10,)
    """
    _check_models(motion, sensor)
    record = record_of_arrays(motion, sensor, prior, time, readings, control, start, landmark, truth)
    _try_models(motion, sensor, record)
    chosen = make_filter(filter) if isinstance(filter, str) else filter
    instance("filter", "is", chosen, Filter)
    loop = _loop(chosen, motion, sensor, engine, smooth)
    generators = Streams(seed, "estimate").generators("filter", range(record.runs))
    loop.prepare(record, generators)
    if smooth:
        filtered, smoothed = loop.estimate_and_smooth(record, generators)
        found = _named(motion, record, replace(filtered, mean=smoothed.mean, cov=smoothed.cov))
    else:
        found = _named(motion, record, loop.estimate(record, generators))
    return found if np.ndim(readings) == 3 else _alone(found)


def _check_models(motion: Motion, sensor: Sensor) -> None:
    instance("motion", "is", motion, Motion)
    instance("sensor", "is", sensor, Sensor)
    check_space("motion.space", motion.space, 1)
    check_motion("motion", motion, motion.space)
    check_sensor("sensor", sensor, motion.space)


def _try_models(motion: Motion, sensor: Sensor, record: Record) -> None:
    """Raise UserError unless the models work at the prior."""
    begin = record.prior.fitted()
    try_motion("motion", motion, begin, record.control, np.diff(record.time, prepend=record.start))
    if record.readings.step.size:
        try_sensor("sensor", sensor, begin, sensor.landmark(record.readings.landmark_number[0]))
        check_noise("sensor", sensor)


def _loop(filter: AnyFilter, motion: Motion, sensor: Sensor, engine: Engine, smooth: bool) -> Loop:
    """The filter with its models, checked against each other."""
    if engine not in ("auto", "numpy", "compiled"):
        raise UserError(f"engine must be one of auto, numpy, compiled, got {engine!r}")
    parts = filter, motion, sensor
    loop = Loop(*parts) if engine == "numpy" else CompiledLoop(*parts, insist=engine == "compiled")
    try:
        loop.check()
        loop.check_engine()
        if smooth:
            loop.check_smoother()
    except ValueError as error:
        raise UserError(f"filter: {error}") from error
    return loop


def _named(motion: Motion, record: Record, found: Estimates) -> FilterEstimates:
    """Estimates with the names of their components, and the NIS at each time."""
    nis = np.full((record.time.size, record.runs), np.nan)
    nis[record.readings.step] = np.where(
        np.isfinite(found.whitened).any(axis=0), np.nansum(found.whitened**2, axis=0), np.nan
    )
    return FilterEstimates(motion.space, record.time, found.mean, found.cov, record.truth, np.arange(record.runs), nis)


def _alone(found: FilterEstimates) -> FilterEstimates:
    """The estimates of a single run, without the axis of runs."""
    assert found.nis is not None
    return replace(
        found, mean=found.mean[..., 0], cov=found.cov[..., 0], truth=found.truth[..., 0], nis=found.nis[..., 0]
    )
