"""Checks each answer of a scenario against its contract."""

import typing
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from estlab.errors import AnswerError
from estlab.filters.filter import AnyFilter
from estlab.filters.loop import Scheme
from estlab.maths.space import Array
from estlab.models.answers import refuse
from estlab.models.checks import check_motion, check_noise, check_sensor, check_space, try_motion, try_sensor
from estlab.models.contract import Motion, Sensor
from estlab.record import Record
from estlab.scenarios.scenario import Scales, Scenario
from estlab.validation.records import check_readings, check_record


def models_of(scenario: Scenario, noise: Scales, landmarks: Array) -> tuple[Motion, Sensor]:
    """Motion and sensor with these noises. Raises AnswerError that names the function and its field."""
    where = name_of(scenario)
    check_space(f"{where}.space", scenario.space, 1)
    motion = check_motion(f"{where}.motion", scenario.motion(noise), scenario.space)
    return motion, check_sensor(f"{where}.sensor", scenario.sensor(noise, landmarks), scenario.space)


def scheme_of(scenario: Scenario) -> tuple[Scheme, float]:
    """How several readings at one time are applied, and the pause between them."""
    scheme = scenario.scheme
    known = typing.get_args(Scheme)
    if not (isinstance(scheme, tuple) and len(scheme) == 2 and scheme[0] in known and scheme[1] >= 0.0):
        refuse(f"{name_of(scenario)}.scheme", f"is {scheme!r}; must be one of {', '.join(known)} and a pause [s]")
    return scheme


def recorded(scenario: Scenario, make: "partial[Any]", runs: int) -> Record:
    """The record of so many runs that a scenario's method makes. Raises AnswerError that names the field."""
    where = f"{name_of(scenario)}.{make.func.__name__}"
    try:
        made = make()
    except AnswerError as error:  # of the method that was called
        raise AnswerError(f"{name_of(scenario)}.{error}") from error
    record = check_record(where, made, scenario.space, runs)
    if record.origin is not None and np.isnan(record.truth).any():
        k = int(np.isnan(record.truth).any(axis=(0, 2)).argmax())
        refuse(where, f"simulated truth is NaN from time {record.time[k]:g} on; check move and noise_cov there")
    return record


def check(scenario: Scenario, motion: Motion, sensor: Sensor, record: Record, filters: Sequence[AnyFilter]) -> None:
    """Raise AnswerError unless the models that filters assume match a record, and work from its start on."""
    where = name_of(scenario)
    check_readings(f"{where}: record", record.readings, sensor.space, sensor.landmarks)
    begin = record.prior.fitted()
    try_motion(f"{where}.motion", motion, begin, record.control, np.diff(record.time, prepend=record.start))
    if record.readings.step.size == 0:
        return
    try_sensor(f"{where}.sensor", sensor, begin, sensor.landmark(record.readings.landmark_number[0]))
    if any(filter.traits.reads for filter in filters):
        check_noise(f"{where}.sensor", sensor)


def name_of(thing: Any) -> str:
    """A user's object, named by its class as a configuration writes it."""
    return f"{type(thing).__module__}.{type(thing).__qualname__}"
