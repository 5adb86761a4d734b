"""The contract of every problem. To add one, write a class with these methods and a YAML file with its numbers."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from estlab.earlier_names import renamed
from estlab.errors import UserError
from estlab.maths.space import Array, Space
from estlab.maths.streams import Streams
from estlab.models.contract import Motion, Sensor
from estlab.record import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Scales:
    """Factors on the standard deviations of process and measurement noise."""

    process_scale: float
    measurement_scale: float

    def __post_init__(self) -> None:
        for name, value in (("process_scale", self.process_scale), ("measurement_scale", self.measurement_scale)):
            if not 1e-50 < value < 1e50:
                raise ValueError(f"{name} must be > 0 and between 1e-50 and 1e50, got {value:g}")


@renamed(target="landmark_number", places="landmarks", shown="extra")
@dataclass(frozen=True)
class History:
    """One run as it is drawn: everything that a problem's own pictures may use.

    time: (T,). truth, mean: (n, T). cov: (n, n, T). step: (N,), values: (m, N), landmark_number: (N,) of the readings.
    landmarks: (p, L). extra: the record's further arrays, and its sums over all runs. run: its number.
    colour: of its filter in every picture.
    """

    time: Array
    truth: Array
    mean: Array
    cov: Array
    step: Array
    values: Array
    landmark_number: Array
    landmarks: Array
    extra: dict[str, Array]
    run: int = 0
    colour: str = "C0"


class Scenario(ABC):
    """A problem: its spaces and models, where its records come from, and how it is drawn.

    of_simulation, of_recordings: keys that only simulated data, or only files, use.
    file_names: the names that each kind of file may have, the original's first. If there are any, :meth:`read` takes
    estlab.datasets.data_files.Options as its fifth argument.
    clocks: the keys of data, about times in its files, that reading uses.
    """

    of_simulation: ClassVar[Sequence[str]] = ()
    of_recordings: ClassVar[Sequence[str]] = ()
    file_names: ClassVar[Mapping[str, Sequence[str]]] = {}
    clocks: ClassVar[Sequence[str]] = ()

    def unread(self, source: Literal["simulated", "files"]) -> dict[str, str]:
        """The keys that a run on data from this source does not read, each with the setting that would read it."""
        if source == "files":
            return dict.fromkeys(self.of_simulation, "data=simulated")
        return dict.fromkeys(self.of_recordings, "data=files")

    @property
    def scheme(self) -> tuple[Literal["sequential", "stacked", "interleaved"], float]:
        """How several readings at one time are used, and the pause [s] between them; see estlab.filters.loop."""
        return "sequential", 0.0

    @property
    def found_within(self) -> float | None:
        """The position error, in its unit, within which a lost robot counts as found; None if none is lost."""
        return None

    @property
    def lost_beyond(self) -> float | None:
        """The position error, in its unit, beyond which a run that stays there to the end is lost; or None."""
        return None

    @property
    @abstractmethod
    def space(self) -> Space:
        """Of the state."""

    @abstractmethod
    def motion(self, noise: Scales) -> Motion:
        """The motion model as assumed with these noises."""

    @abstractmethod
    def sensor(self, noise: Scales, landmarks: Array) -> Sensor:
        """The sensor as assumed with these noises, among a record's landmarks."""

    @abstractmethod
    def simulate(self, streams: Streams, runs: Sequence[int], noise: Scales) -> Record:
        """Truth and readings of the runs with these numbers."""

    def read(self, folder: Path, prefix: str, streams: Streams, runs: Sequence[int]) -> Record:
        """The recording in a folder, in the original file layout; the runs differ only in the prior's error.

        folder: may be the file itself if one is enough.

        Raises UserError that names the file and the remedy.
        """
        raise UserError(f"{type(self).__name__} reads no files; run it with data=simulated")

    def write(self, record: Record, folder: Path, prefix: str) -> list[Path]:
        """Write run 0 of a record in the original file layout. Returns the files written."""
        raise UserError(f"{type(self).__name__} has no file layout to write")

    def draw(self, axes: "Axes", history: History) -> None:  # noqa: B027 - nothing to add is an answer
        """Draw everything in the trajectory picture except truth, estimate and ellipses: readings, landmarks, bodies.

        The axes show the first two components of the position, or time and a position of one component. Clouds are
        drawn over the same.
        """

    def table(self, histories: dict[str, History]) -> dict[str, list[Any]]:
        """A table of the problem's own, by column, for the terminal and <scenario>.csv; empty for none."""
        return {}

    def pictures(self, histories: dict[str, History]) -> "dict[str, Figure]":
        """Figures of the problem's own by file name, from the first run of each filter."""
        return {}


def check_positive(**values: float) -> None:
    """Raise ValueError that names the key for the first value that is not positive and finite."""
    for name, value in values.items():
        if not (value > 0.0 and math.isfinite(value)):
            raise ValueError(f"{name} must be > 0 and finite, got {value:g}")


def check_duration(duration: float, dt: float) -> None:
    """Raise ValueError unless at least one step and at most ten million fit."""
    check_positive(dt=dt, duration=duration)
    if not 1 <= round(duration / dt) <= 10_000_000:
        raise ValueError(f"duration must be from one to ten million steps of dt = {dt:g} s, got {duration:g}")


def check_sds(name: str, values: Sequence[float], size: int) -> None:
    """Raise ValueError unless there are ``size`` positive standard deviations, so that their covariance is definite."""
    if len(values) != size:
        raise ValueError(f"{name} must have {size} numbers, got {len(values)}")
    for i, value in enumerate(values):
        if not 0.0 < value < 1e50:
            raise ValueError(
                f"{name}[{i}] must be > 0 and below 1e50 for a positive definite covariance, got {value:g}"
            )


def diagonal_cov(sds: Sequence[float]) -> Array:
    """The covariance (n, n) of independent components with these standard deviations."""
    return np.diag(np.square(np.asarray(sds, dtype=float)))
