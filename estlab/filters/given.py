"""A record in the form that compiled code takes."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from estlab.compiled import cache
from estlab.compiled.routines import Method
from estlab.filters.filter import AnyFilter
from estlab.filters.methods import method_of
from estlab.filters.stacks import one_by_one, stacked
from estlab.filters.step_tables import noise_table
from estlab.maths.streams import Generators
from estlab.models.contract import Motion, Sensor
from estlab.record import Record


@dataclass(frozen=True)
class FilterSetup:
    """A filter with its models, and how it uses several readings at one time: see estlab.filters.loop.Loop."""

    filter: AnyFilter
    motion: Motion
    sensor: Sensor
    scheme: str
    pause: float

    def method(self) -> Method:
        """The filter, described by its steps. Raises ValueError if it cannot be compiled, or not with this scheme."""
        method = method_of(self.filter, self.motion, self.sensor)
        if self.scheme == "stacked" and method.augmented and method.transform == "points":
            raise ValueError(
                "it compiles no scenario.update=stacked with noise=augmented, whose number of points depends on "
                "the number of readings; set engine=numpy"
            )
        return method


@dataclass(frozen=True)
class Shape:
    """What the text of a program depends on, besides filter and models.

    controls: components of a command. each_control, each_noise: whether they differ between runs. noise: the entries
    of the process noise that are not zero. count: readings used as one. masked: whether parts of readings are
    missing. each_landmark: whether the runs' readings may be about different landmarks. lanes: runs at once.
    """

    controls: int
    each_control: bool
    noise: tuple[tuple[int, int], ...]
    each_noise: bool
    count: int
    masked: bool
    each_landmark: bool
    lanes: int


class Given:
    """A record's arrays, the belief at its start, and their shape. Raises ValueError as FilterSetup.method."""

    def __init__(self, setup: FilterSetup, record: Record, generators: Generators, lanes: int | None) -> None:
        method = setup.method()
        self.lapse = np.diff(record.time, prepend=record.start)
        self.pause = setup.pause if setup.scheme == "interleaved" else 0.0
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            start: Any = setup.filter.start(record.prior, generators)
            self.table = noise_table(setup.motion, record.control, self.lapse, self.pause, method.factors_noise)
        self.mean, self.matrix = start  # a covariance or its factor
        self.runs = int(self.mean.shape[1])
        self.stack = (stacked if setup.scheme == "stacked" else one_by_one)(record.readings, self.runs)
        self.control = np.ascontiguousarray(record.control, dtype=float)
        lanes = lanes or cache.lanes()
        while lanes > self.runs:
            lanes //= 2
        self.shape = Shape(
            record.control.shape[0],
            record.control.shape[2] > 1,
            self.table.positions,
            self.table.entries.shape[2] > 1,
            self.stack.count,
            bool(np.isnan(self.stack.values).any()),
            bool((self.stack.landmark_number != self.stack.landmark_number[..., :1]).any()),
            lanes,
        )
