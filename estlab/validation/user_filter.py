"""Checks a user's own filter against its contract, over one step of a record's first runs."""

from typing import Any

import numpy as np

from estlab.filters.filter import AnyFilter, Innovation, Sample
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Array
from estlab.maths.streams import Generators
from estlab.models.answers import covariance, instance, kind, numbers, quietly, refuse
from estlab.models.contract import Motion, Sensor
from estlab.record import Record


@quietly
def try_filter(
    where: str, filter: AnyFilter, motion: Motion, sensor: Sensor, record: Record, generators: Generators
) -> None:
    """Raise AnswerError unless the filter works over a step of the record. generators: for all its runs."""
    runs = record.runs if record.each_its_own else 1
    belief = _something(where, "start", filter.start(record.prior, generators))
    _check_moments(where, filter, belief, motion, runs)
    belief = _something(where, "predict", filter.predict(motion, belief, record.control[:, 0], _lapse(record)))
    _check_moments(where, filter, belief, motion, runs)
    if record.readings.step.size and record.each_its_own:
        some = np.arange(runs)[: max(1, runs - 1)]
        for method in ("take", "replaced"):
            if not callable(getattr(belief, method, None)):
                refuse(where, f"the belief has no method {method}, which selects the runs that have a reading")
        part = belief.take(some)
        m = sensor.space.size
        reading, landmark = (
            record.readings.values[:, 0, some],
            sensor.landmark(record.readings.landmark_number[0, some]),
        )
        pair = filter.update(sensor, part, reading, landmark)
        if type(pair) is not tuple or len(pair) != 2:
            refuse(where, f"update returned {kind(pair)}; must be a pair, of a belief and an Innovation")
        updated, innovation = pair
        _something(where, "update", updated)
        _check_innovation(where, innovation, m, some.size)
        _check_moments(where, filter, updated, motion, some.size)
        _check_moments(where, filter, _something(where, "replaced", belief.replaced(some, updated)), motion, runs)
    sample = filter.sample(belief)
    if sample is not None:
        instance(where, "sample returned", sample, Sample)
        for field in ("size", "scale"):
            numbers(where, f"sample returned as {field}", getattr(sample, field), (runs,), finite=False)
    notes = instance(where, "notes returned", filter.notes(belief), dict)
    for name, values in notes.items():
        numbers(where, f"notes returned for {name}", values, (runs,), finite=False)


def _check_moments(where: str, filter: AnyFilter, belief: Any, motion: Motion, runs: int) -> None:
    n, found = motion.space.size, filter.moments(belief, motion)
    instance(where, "moments returned", found, Gaussian)
    numbers(where, "moments returned as mean", found.mean, (n, runs), finite=False)
    cov: Array = numbers(where, "moments returned as cov", found.cov, (n, n, runs), finite=False)
    if np.isfinite(cov).all():
        covariance(where, "moments returned as cov", cov, (n, n, runs))


def _check_innovation(where: str, innovation: Any, m: int, runs: int) -> None:
    instance(where, "update returned as its second", innovation, Innovation)
    for field in ("whitened", "log_scale"):
        numbers(where, f"update returned as {field}", getattr(innovation, field), (m, runs), finite=False)
    numbers(where, "update returned as gated", innovation.gated, (runs,))


def _something(where: str, method: str, belief: Any) -> Any:
    if belief is None:
        refuse(where, f"{method} returned nothing (None); must be a belief; is a return missing?")
    return belief


def _lapse(record: Record) -> float:
    lapse = np.diff(record.time, prepend=record.start)
    return float(lapse[lapse > 0.0][0]) if (lapse > 0.0).any() else 1.0
