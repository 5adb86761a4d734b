"""A filter over the time line of a record."""

from collections.abc import Callable
from typing import Literal

import numpy as np

from estlab.filters.gaussian import GaussianFilter, Innovation
from estlab.maths.gaussian import Gaussian
from estlab.models.contract import Motion, Sensor
from estlab.record import Estimates, Record

Scheme = Literal["sequential", "stacked", "interleaved"]


def estimate(
    filter: GaussianFilter,
    motion: Motion,
    sensor: Sensor,
    record: Record,
    scheme: Scheme = "sequential",
    pause: float = 0.0,
    tick: Callable[[], None] = lambda: None,
) -> Estimates:
    """Predict to each time, then update with the readings taken there.

    scheme: what to do with several readings at one time: one after another, as one long reading, or one after another
    with a prediction of ``pause`` [s] at zero command between. tick: called after every step.
    A belief that stops being one becomes NaN and stays so; the other runs go on.
    """
    steps, runs, n = record.time.size, record.runs, motion.space.size
    mean, cov = np.empty((n, steps, runs)), np.empty((n, n, steps, runs))
    nis, size = np.zeros((steps, runs)), np.zeros((steps, runs), dtype=int)
    lapse = np.diff(record.time, prepend=record.start)
    bounds = record.readings.bounds(steps)
    belief = filter.start(record.prior)
    # NaN is how a run says that it diverged, so the arithmetic that carries it is not worth a warning.
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        for k in range(steps):
            control = record.control[:, k]
            if lapse[k] > 0.0:
                belief = filter.predict(motion, belief, control, float(lapse[k]))
            taken = slice(bounds[k], bounds[k + 1])
            if taken.stop > taken.start:
                belief, fit = _update(filter, motion, sensor, belief, record, taken, scheme, pause)
                nis[k], size[k] = fit
            mean[:, k], cov[:, :, k] = belief
            tick()
    return Estimates(mean, cov, nis, size)


def _update(
    filter: GaussianFilter,
    motion: Motion,
    sensor: Sensor,
    belief: Gaussian,
    record: Record,
    taken: slice,
    scheme: Scheme,
    pause: float,
) -> tuple[Gaussian, Innovation]:
    values = record.readings.values[:, taken]
    places = sensor.place(record.readings.target[taken])
    m, count, runs = values.shape
    if scheme == "stacked" and count > 1:
        long = np.swapaxes(values, 0, 1).reshape(count * m, runs)
        return filter.update(sensor.times(count), belief, long, places)

    nis, size = np.zeros(runs), np.zeros(runs, dtype=int)
    at_rest = np.zeros((record.control.shape[0], 1))
    for i in range(count):
        if scheme == "interleaved" and i > 0:
            belief = filter.predict(motion, belief, at_rest, pause)
        belief, fit = filter.update(sensor, belief, values[:, i], places[:, i])
        nis, size = nis + fit.nis, size + fit.size
    return belief, Innovation(nis, size)
