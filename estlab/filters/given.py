"""A record in the form that compiled code takes."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from estlab.compiled import cache
from estlab.compiled.routines import Method
from estlab.filters.filter import AnyFilter
from estlab.filters.methods import method_of
from estlab.filters.stacks import in_rows, one_by_one, stacked
from estlab.filters.step_tables import noise_table
from estlab.maths.streams import Generators
from estlab.models.contract import Motion, Sensor
from estlab.record import Record

LINE = 8  # numbers of a line of the caches
_BEYOND_CACHES = 16 * 2**20


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

    controls: components of a command. each_control, each_noise: whether runs have their own. noise: the entries of the
    process noise that are not zero. count: readings taken as one. masked: whether numbers of readings are missing.
    each_landmark: whether a reading of one run may be about another landmark than of the next. lanes: runs at once.
    streamed: whether what is found is more than the caches hold, and lies in whole lines of them.
    """

    controls: int
    each_control: bool
    noise: tuple[tuple[int, int], ...]
    each_noise: bool
    count: int
    masked: bool
    each_landmark: bool
    lanes: int
    streamed: bool


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
        self.control = in_rows(record.control)
        lanes = lanes or cache.lanes()
        while lanes > self.runs:
            lanes //= 2
        self.shape = Shape(
            record.control.shape[0],
            record.control.shape[2] > 1,
            self.table.positions,
            self.table.entries.shape[2] > 1,
            self.stack.count,
            bool(np.isnan(np.min(self.stack.values, initial=np.inf))),
            bool((self.stack.landmark_number != self.stack.landmark_number[..., :1]).any()),
            lanes,
            self.runs % LINE == 0 and 8 * self._found(setup, record.time.size) > _BEYOND_CACHES,
        )

    def _found(self, setup: FilterSetup, steps: int) -> int:
        """How many numbers are found."""
        n = setup.motion.space.size
        return (n + n * n) * steps * self.runs + 2 * self.stack.values.size
