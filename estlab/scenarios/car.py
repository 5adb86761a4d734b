"""Tracking a car with a LIDAR. Seed document 000, problem III."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from estlab.compiled.normals import normals
from estlab.datasets import matlab, problem3
from estlab.datasets.data_files import DEFAULTS, Files, Options
from estlab.errors import UserError
from estlab.maths.gaussian_belief import Gaussian, draw
from estlab.maths.space import Array, Space, wrap
from estlab.maths.streams import Streams
from estlab.models import lidar, vehicle
from estlab.models.contract import Motion, Sensor
from estlab.models.lidar_runs import measure_runs, noisy_frames
from estlab.record import Readings, Record
from estlab.scenarios import simulation
from estlab.scenarios.scenario import (
    History,
    Scales,
    Scenario,
    check_duration,
    check_positive,
    check_sds,
    diagonal_cov,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SPEED, HEADING, LENGTH = 2, 3, 4  # length and width are the last two

# The initial state of a simulated car, and the half width of the uniform distribution about it.
_BEGIN = np.array([90.0, 4.25, 13.0, np.pi, 4.7, 1.85])
_BEGIN_WITHIN = np.array([1.0, 0.3, 0.5, 0.03, 0.5, 0.15])

# The drive: (until [s], acceleration [m/s^2], turn rate [deg/s]). Toward the sensor, brake, turn aside, pass, turn
# behind it, drive away.
_SCRIPT = (
    (3.5, 0.0, 0.0), (6.0, -2.4, 0.0), (7.5, 0.0, -30.0), (9.0, 0.0, 30.0), (11.5, 0.0, 0.0),
    (14.0, 1.0, -20.0), (16.0, 2.5, 0.0), (17.5, 1.0, 20.0), (np.inf, 0.0, 0.0),
)  # fmt: skip

_OF_MANOEUVRE = ("lidar_range_sd", "lidar_bearing_sd", "acceleration_sd", "turn_rate_sd")


@dataclass(frozen=True)
class Car(Scenario):
    """A manoeuvring car as a rectangle; its LIDAR frames give two bearings and a range."""

    file_names = problem3.LAYOUT
    of_simulation: ClassVar = ("duration", "truth", *_OF_MANOEUVRE)
    clocks = ("clock_faults",)

    dt: float
    duration: float
    truth: Literal["manoeuvre", "model"]
    initial: Literal["drawn", "document"]
    process_sd: list[float]
    measurement_sd: list[float]
    initial_mean: list[float]
    initial_sd: list[float]
    smallest: float
    lidar_range_sd: float
    lidar_bearing_sd: float
    acceleration_sd: float
    turn_rate_sd: float
    lost_radius: float

    def __post_init__(self) -> None:
        check_positive(lost_radius=self.lost_radius, smallest=self.smallest)
        check_duration(self.duration, self.dt)
        check_positive(lidar_range_sd=self.lidar_range_sd, lidar_bearing_sd=self.lidar_bearing_sd)
        check_positive(acceleration_sd=self.acceleration_sd, turn_rate_sd=self.turn_rate_sd)
        check_sds("process_sd", self.process_sd, 6)
        check_sds("measurement_sd", self.measurement_sd, 3)
        check_sds("initial_sd", self.initial_sd, 6)
        if len(self.initial_mean) != 6:
            raise ValueError(f"initial_mean must have 6 numbers, got {len(self.initial_mean)}")

    def unread(self, source: Literal["simulated", "files"]) -> dict[str, str]:
        drawn = self.initial == "drawn"
        keys = {"initial_mean": "scenario.initial=document"} if drawn else {"smallest": "scenario.initial=drawn"}
        if self.truth == "model":
            keys |= dict.fromkeys(_OF_MANOEUVRE, "scenario.truth=manoeuvre")
        return keys | super().unread(source)

    @property
    def lost_beyond(self) -> float:
        return self.lost_radius

    @property
    def space(self) -> Space:
        return vehicle.SPACE

    def motion(self, noise: Scales) -> Motion:
        cov = noise.process_scale**2 * diagonal_cov(self.process_sd)
        return Motion(vehicle.SPACE, vehicle.drive, lambda control, dt: cov / dt, 6, vehicle.drive_jacobians)

    def sensor(self, noise: Scales, landmarks: Array) -> Sensor:
        cov = noise.measurement_scale**2 * diagonal_cov(self.measurement_sd)
        return Sensor(vehicle.READING, vehicle.SPACE, vehicle.extent, cov, landmarks)

    def simulate(self, streams: Streams, runs: Sequence[int], noise: Scales) -> Record:
        time = self.dt * np.arange(round(self.duration / self.dt))
        begin, truth = self._drive(streams, runs, time, noise.process_scale)
        raw: dict[str, Array] = {}
        if self.truth == "model":
            values = simulation.read(streams, runs, self.sensor(noise, np.empty((0, 1))), truth, np.empty(0))
        else:
            values, raw = self._scan(streams, runs, truth, noise.measurement_scale)
        record = self._record(time, truth, values, self._prior(streams, runs, begin), raw)
        return replace(record, origin=begin) if self._has_bound else record

    def read(
        self, folder: Path, prefix: str, streams: Streams, runs: Sequence[int], options: Options = DEFAULTS
    ) -> Record:
        recording = problem3.read(Files(folder, prefix, self.file_names, options.names), self.dt, options)
        if self.initial == "drawn" and np.isnan(recording.truth[:, 0]).any():
            raise UserError(
                "scenario.initial=drawn needs the truth of the first frame, which is unknown; set "
                "scenario.initial=document, which starts at initial_mean"
            )
        values = lidar.measure_frames(recording.points, recording.owner, recording.time.size)
        begin = np.stack(vehicle.drive(recording.truth[:, 0], np.empty(0), np.zeros(6), -self.dt))
        every = len(runs)
        record = self._record(
            recording.time,
            np.repeat(recording.truth[:, :, None], every, axis=2),
            np.repeat(values[:, :, None], every, axis=2),
            self._prior(streams, runs, np.repeat(begin[:, None], every, axis=1)),
            {"points": recording.points, "owner": recording.owner},
        )
        return replace(record, files=recording.files, remarks=recording.remarks, repeated=True)

    def write(self, record: Record, folder: Path, prefix: str) -> list[Path]:
        if "points" not in record.raw:
            raise UserError("scenario.truth=model makes no LIDAR frames to write; use scenario.truth=manoeuvre")
        points, owner = record.raw["points"], record.raw["owner"]
        edges = np.searchsorted(owner, np.arange(record.time.size + 1))
        frames = [{"z": points[:, a:b].T, "t": t} for a, b, t in zip(edges, edges[1:], record.time, strict=False)]
        states = [{"x": x, "t": t} for x, t in zip(record.truth[:, :, 0].T[:, :, None], record.time, strict=True)]
        return [
            matlab.write(folder / f"{prefix}{problem3.LAYOUT['data'][0]}", {"lidar": frames}),
            matlab.write(folder / f"{prefix}{problem3.LAYOUT['truth'][0]}", {"car": states}),
        ]

    def draw(self, axes: "Axes", history: History) -> None:
        first, last, distance = history.values
        middle = first + 0.5 * wrap(last - first)
        nearest = distance * np.cos(middle), distance * np.sin(middle)
        axes.plot(*nearest, ".", color="0.6", ms=3, label="smallest range, middle bearing")
        axes.plot(0.0, 0.0, "k^", ms=8, label="LIDAR")
        chosen = np.arange(0, history.time.size, max(1, history.time.size // 14))
        _draw_rectangles(axes, history.truth[:, chosen], "black")
        _draw_rectangles(axes, history.mean[:, chosen], history.colour)

    def pictures(self, histories: dict[str, History]) -> "dict[str, Figure]":
        """The passing in close-up: rectangles every half second within 30 m of the LIDAR."""
        from matplotlib.figure import Figure

        history = next(iter(histories.values()))
        every = max(1, round(0.5 / self.dt))
        near = np.flatnonzero(np.hypot(*history.truth[:2]) < 30.0)[::every]
        if near.size == 0:
            return {}
        figure = Figure(figsize=(9.0, 6.0), layout="constrained")
        axes = figure.add_subplot()
        axes.plot(0.0, 0.0, "k^", ms=8, label="LIDAR")
        _draw_rectangles(axes, history.truth[:, near], "black", "the car, every half second")
        for i, (name, found) in enumerate(histories.items()):
            _draw_rectangles(axes, found.mean[:, near], f"C{i}", f"as estimated by {name}")
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
        axes.grid(alpha=0.3)
        axes.set_title(f"run {history.run} within 30 m of the LIDAR")
        figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize="small")
        return {"passing.png": figure}

    @property
    def _has_bound(self) -> bool:
        """Whether everything is drawn from the model, and no size is too close to the smallest for a Gaussian error."""
        room = (_BEGIN - _BEGIN_WITHIN)[LENGTH:] - self.smallest
        whole = (room > 4.0 * np.asarray(self.initial_sd[LENGTH:])).all()
        return self.truth == "model" and self.initial == "drawn" and bool(whole)

    def _drive(self, streams: Streams, runs: Sequence[int], time: Array, scale: float) -> tuple[Array, Array]:
        """The state at -dt (6, runs) and at each time (6, T, runs)."""
        start = streams.uniforms("start", runs, (6,)) * 2.0 - 1.0
        begin = _BEGIN[:, None] + _BEGIN_WITHIN[:, None] * start
        rates = normals(streams, "truth", runs, (time.size, 6)) * scale / np.sqrt(self.dt)
        if self.truth == "model":
            rates = rates * np.asarray(self.process_sd)[:, None]
        else:
            rates = rates * np.array([0.0, 0.0, self.acceleration_sd, self.turn_rate_sd, 0.0, 0.0])[:, None]
            script = np.array([next(row[1:] for row in _SCRIPT if t <= row[0]) for t in time])
            rates[:, SPEED] += script[:, :1]
            rates[:, HEADING] += np.radians(script[:, 1:])
        truth = np.empty((6, time.size, len(runs)))
        state = begin
        for k in range(time.size):
            truth[:, k] = state = np.stack(vehicle.drive(state, np.empty(0), rates[k], self.dt))
        return begin, vehicle.SPACE.plus(truth, np.zeros(1))

    def _scan(
        self, streams: Streams, runs: Sequence[int], truth: Array, scale: float
    ) -> tuple[Array, dict[str, Array]]:
        """The measurements (3, T, runs) from noisy frames, and the frames of the first run."""
        sds = (scale * self.lidar_range_sd, scale * self.lidar_bearing_sd)
        values = measure_runs(truth, streams, runs, sds)
        points, owner = noisy_frames(truth[:, :, :1], streams, runs[:1], sds)
        return values, {"points": points, "owner": owner}

    def _prior(self, streams: Streams, runs: Sequence[int], begin: Array) -> Gaussian:
        cov = diagonal_cov(self.initial_sd)
        if self.initial == "document":
            return Gaussian(np.repeat(np.array(self.initial_mean, dtype=float)[:, None], len(runs), axis=1), cov)
        # A car has no negative size: of several draws of the initial error, each run uses the first that keeps length
        # and width at or above the smallest.
        errors = normals(streams, "prior", runs, (6, 40))
        candidates = draw(vehicle.SPACE, Gaussian(begin[:, None], cov), errors)
        valid = (candidates[LENGTH:] >= self.smallest).all(axis=0)
        mean = np.take_along_axis(candidates, valid.argmax(axis=0)[None, None], axis=1)[:, 0]
        mean[LENGTH:] = np.maximum(mean[LENGTH:], self.smallest)
        return Gaussian(mean, cov)

    def _record(self, time: Array, truth: Array, values: Array, prior: Gaussian, raw: dict[str, Array]) -> Record:
        readings = Readings(np.arange(time.size), values, np.zeros(values.shape[1:], dtype=int))
        control = np.empty((0, time.size, 1))
        return Record(float(time[0]) - self.dt, time, truth, control, readings, prior, raw=raw)


def _draw_rectangles(axes: "Axes", states: Array, colour: str, label: str | None = None) -> None:
    outline = vehicle.corners(states)
    closed = np.concatenate([outline, outline[:, :1]], axis=1)
    axes.plot(closed[0], closed[1], color=colour, lw=0.9)
    axes.plot([], [], color=colour, lw=0.9, label=label)
