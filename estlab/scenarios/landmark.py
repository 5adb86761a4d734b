"""A wheeled robot among landmarks whose barcodes it reads. Seed document 003; the UTIAS data."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from estlab.compiled.normals import normals
from estlab.datasets import mrclam
from estlab.datasets.data_files import DEFAULTS, Options
from estlab.maths.gaussian_belief import Gaussian, draw
from estlab.maths.space import Array, Space, wrap
from estlab.maths.streams import Streams
from estlab.models import unicycle
from estlab.models.contract import Motion, Sensor
from estlab.models.landmarks import SPACE as READING
from estlab.models.landmarks import range_bearing, range_bearing_jacobian, seen_at
from estlab.record import Readings, Record
from estlab.scenarios.landmark_files import timeline
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

# The simulated room: fifteen landmarks along its walls and between, and the corners of the tour, all in metres.
_LANDMARKS = np.array(
    [
        [-0.6, -4.8], [2.1, -5.4], [5.0, -4.9], [6.3, -2.6], [6.1, 0.4],
        [6.4, 3.2], [4.6, 5.3], [1.8, 5.1], [-0.9, 5.0], [-1.8, 2.4],
        [-1.5, -0.5], [-1.7, -2.9], [2.6, -1.9], [1.3, 1.6], [3.5, 2.0],
    ]
).T  # fmt: skip
_BARCODES = np.array([63, 25, 45, 16, 61, 36, 18, 9, 72, 70, 81, 54, 27, 7, 90])
_TOUR = np.array(
    [[0.5, -3.6], [3.9, -3.4], [4.7, -0.4], [4.6, 3.4], [2.3, 3.5], [2.4, 0.1], [0.2, 0.5], [0.3, 3.2], [-0.4, -1.6]]
).T
_ARRIVED = 0.4  # [m] from a corner of the tour
# The sample commands of document 003, each held for a second: v [m/s], w [rad/s].
_COMMANDS = np.array([[0.5, 0.0], [0.0, -0.5 / np.pi], [0.5, 0.0], [0.0, 0.5 / np.pi], [0.5, 0.0]]).T


@dataclass(frozen=True)
class Landmark(Scenario):
    """Range and bearing to landmarks known by their barcodes; simulated room or MRCLAM files."""

    of_simulation: ClassVar = (
        "dt", "duration", "reading_every", "max_range", "field_of_view", "dropped", "speed", "drive",
    )  # fmt: skip
    of_recordings: ClassVar = ("truth_gap", "unknown_barcodes")
    file_names = mrclam.LAYOUT
    clocks = ("clock_faults", "clock_gap")

    dt: float
    duration: float
    reading_every: int
    max_range: float
    field_of_view: float
    dropped: float
    speed: float
    drive: Literal["tour", "commands"]
    process_sd: list[float]
    measurement_sd: list[float]
    initial_sd: list[float]
    initial: Literal["drawn", "truth"]
    update: Literal["sequential", "stacked", "interleaved"]
    interleave_dt: float
    sightings: list[list[float]]
    truth_gap: float
    unknown_barcodes: float
    lost_radius: float

    def __post_init__(self) -> None:
        check_positive(lost_radius=self.lost_radius)
        check_duration(self.duration, self.dt)
        check_positive(max_range=self.max_range, speed=self.speed)
        check_positive(interleave_dt=self.interleave_dt, truth_gap=self.truth_gap)
        check_sds("process_sd", self.process_sd, 2)
        check_sds("measurement_sd", self.measurement_sd, 2)
        check_sds("initial_sd", self.initial_sd, 3)
        if not 1 <= self.reading_every <= 1_000_000:
            raise ValueError(f"reading_every must be from 1 to 1e6, got {self.reading_every}")
        for i, sighting in enumerate(self.sightings):
            if len(sighting) != 5:
                raise ValueError(f"sightings[{i}] must be [x, y, heading, landmark x, landmark y], got {sighting}")
        if not 0.0 < self.field_of_view <= 2.0 * np.pi:
            raise ValueError(f"field_of_view must be > 0 and at most 2 pi [rad], got {self.field_of_view:g}")
        for name, share in (("dropped", self.dropped), ("unknown_barcodes", self.unknown_barcodes)):
            if not 0.0 <= share <= 1.0:
                raise ValueError(f"{name} must be a share from 0 to 1, got {share:g}")

    def unread(self, source: Literal["simulated", "files"]) -> dict[str, str]:
        keys = {} if self.update == "interleaved" else {"interleave_dt": "scenario.update=interleaved"}
        if self.drive == "commands":
            keys["speed"] = "scenario.drive=tour"
        return keys | super().unread(source)

    @property
    def lost_beyond(self) -> float:
        return self.lost_radius

    @property
    def space(self) -> Space:
        return unicycle.SPACE

    @property
    def scheme(self) -> tuple[Literal["sequential", "stacked", "interleaved"], float]:
        return self.update, self.interleave_dt

    def motion(self, noise: Scales) -> Motion:
        cov = noise.process_scale**2 * diagonal_cov(self.process_sd)
        return Motion(
            unicycle.SPACE,
            unicycle.arc,
            lambda control, dt: cov / dt,
            2,
            unicycle.arc_jacobians,
        )

    def sensor(self, noise: Scales, landmarks: Array) -> Sensor:
        cov = noise.measurement_scale**2 * diagonal_cov(self.measurement_sd)
        return Sensor(READING, unicycle.SPACE, range_bearing, cov, landmarks, range_bearing_jacobian)

    def simulate(self, streams: Streams, runs: Sequence[int], noise: Scales) -> Record:
        duration = self.duration if self.drive == "tour" else min(self.duration, float(_COMMANDS.shape[1]))
        steps = round(duration / self.dt)
        time = self.dt * np.arange(1, steps + 1)
        first = _TOUR[:, 0] if self.drive == "tour" else np.zeros(2)
        begin = np.array([*first, 0.0])[:, None].repeat(len(runs), axis=1)
        truth, control = self._tour(streams, runs, begin, steps, self.motion(noise))
        readings = self._readings(streams, runs, truth, self.sensor(noise, _LANDMARKS))
        prior = self._prior(streams, runs, begin)
        extra = {"commands": control[:, :, 0]} if self.drive == "commands" else {}
        return Record(0.0, time, truth, control, readings, prior, landmarks=_LANDMARKS, extra=extra, origin=begin)

    def read(
        self, folder: Path, prefix: str, streams: Streams, runs: Sequence[int], options: Options = DEFAULTS
    ) -> Record:
        recording = mrclam.read(folder, prefix, self.unknown_barcodes, options)
        line = timeline(recording, self.truth_gap, options.clock_gap, self.measurement_sd)
        every = len(runs)
        readings = Readings(
            line.step,
            recording.readings[:, line.taken, None].repeat(every, axis=2),
            recording.landmark_number[line.taken, None].repeat(every, axis=1),
        )
        return Record(
            line.start,
            line.time,
            line.truth[:, :, None].repeat(every, axis=2),
            line.control[:, :, None],
            readings,
            self._prior(streams, runs, line.begin[:, None].repeat(every, axis=1), line.sds),
            recording.files,
            (*recording.remarks, *line.remarks),
            recording.landmarks,
            repeated=True,
        )

    def write(self, record: Record, folder: Path, prefix: str) -> list[Path]:
        time = np.concatenate([[record.start], record.time])
        control = np.concatenate([record.control[:, :, 0].T, np.zeros((1, 2))])
        seen = np.isfinite(record.readings.values[:, :, 0]).all(axis=0)
        assert record.origin is not None
        recording = mrclam.LandmarkRecording(
            odometry=np.column_stack([time, control]),
            truth=np.column_stack([time, np.concatenate([record.origin[:, 0][None], record.truth[:, :, 0].T])]),
            reading_time=record.time[record.readings.step[seen]],
            readings=record.readings.values[:, seen, 0],
            landmark_number=record.readings.landmark_number[seen, 0],
            landmarks=_LANDMARKS,
            subjects=mrclam.FIRST_LANDMARK + np.arange(_LANDMARKS.shape[1]),
            barcodes=_BARCODES,
            paths={},
        )
        return mrclam.write(recording, folder, prefix)

    def table(self, histories: dict[str, History]) -> dict[str, list[Any]]:
        """The readings at the sightings in the configuration; otherwise the end of each sample command."""
        if self.sightings:
            columns = np.array(self.sightings).T
            pose, (x, y) = columns[:3], columns[3:]
            distance, bearing = range_bearing(pose, columns[3:])
            return {
                "sighting": [str(i + 1) for i in range(x.size)],
                **dict(zip(("x [m]", "y [m]", "heading [rad]"), map(list, pose), strict=True)),
                "landmark x [m]": list(x),
                "landmark y [m]": list(y),
                "range [m]": [float(f"{value:.4f}") for value in distance],
                "bearing [rad]": [float(f"{value:.4f}") for value in wrap(np.asarray(bearing))],
            }
        history = next(iter(histories.values()))
        if "commands" not in history.extra:
            return {}
        ends = [k for k, time in enumerate(history.time) if abs(time - round(time)) < 0.5 * self.dt]
        commanded = [list(column) for column in history.extra["commands"][:, ends]]
        reached = [[float(f"{value:.4f}") + 0.0 for value in component] for component in history.mean[:, ends]]
        names = ("v [m/s]", "w [rad/s]", "x [m]", "y [m]", "heading [rad]")
        seconds = [f"{history.time[k]:.0f}" for k in ends]
        return {"after [s]": seconds, **dict(zip(names, [*commanded, *reached], strict=True))}

    def draw(self, axes: "Axes", history: History) -> None:
        if not history.step.size:
            return  # without the room about it, a path is easier to see
        seen = seen_at(history.mean[:, history.step], history.values)
        axes.plot(seen[0], seen[1], ".", color="C1", ms=2, alpha=0.4, label="readings, placed from the estimate")
        axes.plot(history.landmarks[0], history.landmarks[1], "ks", ms=6, label="landmarks")

    def _tour(
        self, streams: Streams, runs: Sequence[int], begin: Array, steps: int, motion: Motion
    ) -> tuple[Array, Array]:
        """A robot steered from corner to corner of the tour: truth (3, T, runs), commands (2, T, runs)."""
        blur = normals(streams, "truth", runs, (steps, 2))
        truth, control = np.empty((3, steps, len(runs))), np.empty((2, steps, len(runs)))
        pose, goal = begin, np.ones(len(runs), dtype=int)
        for k in range(steps):
            dx, dy = _TOUR[:, goal] - pose[:2]
            turn = wrap(np.arctan2(dy, dx) - pose[2])
            if self.drive == "tour":
                command = np.stack([self.speed * np.maximum(np.cos(turn), 0.2), np.clip(2.0 * turn, -1.0, 1.0)])
            else:
                command = np.repeat(_COMMANDS[:, [int((k + 0.5) * self.dt)]], len(runs), axis=1)
            sds = np.sqrt(np.diag(motion.noise_cov(command, self.dt)))
            pose = motion.space.plus(motion.step(pose, command, sds[:, None] * blur[k], self.dt), np.zeros(1))
            truth[:, k], control[:, k] = pose, command
            goal = np.where(np.hypot(dx, dy) < _ARRIVED, (goal + 1) % _TOUR.shape[1], goal)
        return truth, control

    def _readings(self, streams: Streams, runs: Sequence[int], truth: Array, sensor: Sensor) -> Readings:
        """What is visible every few steps, minus dropped readings, in as many slots as the busiest run needs."""
        when = np.arange(self.reading_every - 1, truth.shape[1], self.reading_every)
        marks = _LANDMARKS.shape[1]
        shape = (marks, when.size, len(runs))
        at = np.broadcast_to(truth[:, when][:, None], (3, *shape))
        exact = sensor.read(at, _LANDMARKS[:, :, None, None])
        sds = np.sqrt(np.diag(sensor.noise_cov))[:, None, None, None]
        noisy = sensor.space.plus(exact, sds * normals(streams, "readings", runs, (2, marks, when.size)))
        bearing = sensor.space.minus(exact, np.zeros(1))[1]
        kept = streams.uniforms("dropped", runs, (marks, when.size)) >= self.dropped
        in_sight = (exact[0] < self.max_range) & (np.abs(bearing) <= 0.5 * self.field_of_view) & kept
        # Each run's readings move up to its first slots; a step has as many slots as its busiest run.
        order = np.argsort(~in_sight, axis=0, kind="stable")
        values = np.where(in_sight, noisy, np.nan)
        values = np.take_along_axis(values, order[None], axis=1)
        slots = in_sight.sum(axis=0).max(axis=-1)
        used = np.arange(marks)[:, None] < slots
        reading, slot = np.nonzero(used.T)
        return Readings(when[reading], values[:, slot, reading], order[slot, reading])

    def _prior(self, streams: Streams, runs: Sequence[int], begin: Array, sds: Array | None = None) -> Gaussian:
        """A Gaussian about the start, with initial_sd, or with ``sds`` if the start was estimated from readings."""
        cov = diagonal_cov(self.initial_sd if sds is None else np.maximum(self.initial_sd, sds).tolist())
        if self.initial == "truth" or sds is not None:
            return Gaussian(begin, cov)
        return Gaussian(draw(unicycle.SPACE, Gaussian(begin, cov), normals(streams, "prior", runs, (3,))), cov)
