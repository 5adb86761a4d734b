"""A kidnapped robot that measures the distances of the nearest beacons. Seed document 000, problem IV."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from estlab.compiled.normals import normals
from estlab.datasets import matlab, problem4
from estlab.datasets.data_files import DEFAULTS, Files, Options
from estlab.maths.space import TURN, Array, Space, wrap
from estlab.maths.streams import Streams
from estlab.maths.uniform import Uniform
from estlab.models import sonar_beams
from estlab.models.contract import Motion, Sensor
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

_GOALS = 64  # places that a simulated robot visits one after another, then again from the first
_ARRIVED = 1.0  # [m] from such a place


@dataclass(frozen=True)
class Sonar(Scenario):
    """A robot that knows the map and the beacons but not its position; simulated, or the document's two files."""

    file_names = problem4.LAYOUT
    of_simulation: ClassVar = ("duration", "speed", "turn_rate", "bounds", "margin", "beacons")
    clocks = ("clock_faults",)

    dt: float
    duration: float
    speed: float
    turn_rate: float
    bounds: list[float]
    margin: float
    beacons: list[list[float]]
    process_sd: list[float]
    measurement_sd: list[float]
    found_radius: float
    lost_radius: float

    def __post_init__(self) -> None:
        check_positive(lost_radius=self.lost_radius)
        check_positive(speed=self.speed, turn_rate=self.turn_rate)
        check_positive(found_radius=self.found_radius)
        check_sds("process_sd", self.process_sd, 2)
        check_sds("measurement_sd", self.measurement_sd, sonar_beams.HEARD)
        check_duration(self.duration, self.dt)
        if len(self.bounds) != 4 or not (self.bounds[0] < self.bounds[1] and self.bounds[2] < self.bounds[3]):
            raise ValueError(f"bounds must be minx < maxx, miny < maxy, got {self.bounds}")
        narrow = min(self.bounds[1] - self.bounds[0], self.bounds[3] - self.bounds[2])
        if not 0.0 <= self.margin < 0.5 * narrow:
            raise ValueError(f"margin must be >= 0 and below half of the map's width {narrow:g}, got {self.margin:g}")
        if len(self.beacons) < sonar_beams.HEARD:
            raise ValueError(f"beacons must be {sonar_beams.HEARD} or more, one [x, y] each, got {len(self.beacons)}")
        for i, beacon in enumerate(self.beacons):
            if len(beacon) != 2:
                raise ValueError(f"beacons[{i}] must be two numbers [x, y], got {len(beacon)}")

    @property
    def lost_beyond(self) -> float:
        return self.lost_radius

    @property
    def space(self) -> Space:
        return sonar_beams.SPACE

    @property
    def found_within(self) -> float:
        return self.found_radius

    def motion(self, noise: Scales) -> Motion:
        cov = noise.process_scale**2 * diagonal_cov(self.process_sd)
        return Motion(
            sonar_beams.SPACE,
            sonar_beams.turn_and_move,
            lambda control, dt: cov,
            2,
            sonar_beams.turn_and_move_jacobians,
        )

    def sensor(self, noise: Scales, landmarks: Array) -> Sensor:
        # A reading does not identify its beacons, so it is about all of them and about no single place.
        cov = noise.measurement_scale**2 * diagonal_cov(self.measurement_sd)
        return Sensor(
            sonar_beams.READING,
            sonar_beams.SPACE,
            lambda pose, landmark: sonar_beams.nearest_ranges(pose, landmarks),
            cov,
            landmarks,
            lambda pose, landmark: sonar_beams.nearest_ranges_jacobian(pose, landmarks),
        )

    def simulate(self, streams: Streams, runs: Sequence[int], noise: Scales) -> Record:
        time = self.dt * np.arange(1, round(self.duration / self.dt) + 1)
        truth, moved = self._wander(streams, runs, time.size)
        sds = noise.process_scale * np.asarray(self.process_sd)
        encoder = moved + sds[:, None, None] * normals(streams, "encoder", runs, moved.shape[:2])
        beacons = np.array(self.beacons, dtype=float).T
        values = simulation.read(streams, runs, self.sensor(noise, beacons), truth, np.empty((0, 1)))
        return self._record(time, truth, encoder, values, beacons, np.array(self.bounds, dtype=float))

    def read(
        self, folder: Path, prefix: str, streams: Streams, runs: Sequence[int], options: Options = DEFAULTS
    ) -> Record:
        recording = problem4.read(Files(folder, prefix, self.file_names, options.names), self.dt, options)
        every = len(runs)
        record = self._record(
            recording.time,
            np.repeat(recording.truth[:, :, None], every, axis=2),
            recording.encoder[:, :, None],
            np.repeat(recording.ranges[:, :, None], every, axis=2),
            recording.beacons,
            recording.bounds,
        )
        return replace(record, files=recording.files, remarks=recording.remarks, repeated=True)

    def write(self, record: Record, folder: Path, prefix: str) -> list[Path]:
        bounds = dict(zip(problem4.BOUNDS, record.extra["bounds"], strict=True))
        encoder = [{"u": u[:, None], "t": t} for u, t in zip(record.control[:, :, 0].T, record.time, strict=True)]
        heard = [{"z": z[:, None], "t": t} for z, t in zip(record.readings.values[:, :, 0].T, record.time, strict=True)]
        robot = [{"x": x[:, None], "t": t} for x, t in zip(record.truth[:, :, 0].T, record.time, strict=True)]
        return [
            matlab.write(
                folder / f"{prefix}{problem4.LAYOUT['data'][0]}",
                {"encoder": encoder, "sonar": heard, "beacons": record.landmarks.T, **bounds},
            ),
            matlab.write(folder / f"{prefix}{problem4.LAYOUT['truth'][0]}", {"robot": robot}),
        ]

    def draw(self, axes: "Axes", history: History) -> None:
        low_x, high_x, low_y, high_y = history.extra["bounds"]
        axes.plot([low_x, high_x, high_x, low_x, low_x], [low_y, low_y, high_y, high_y, low_y], color="0.6", lw=1.0)
        axes.plot(*history.landmarks, "k^", ms=8, label="beacons")

    def pictures(self, histories: dict[str, History]) -> "dict[str, Figure]":
        """How well each place fits the sonar at three times: the likelihood that weights a particle."""
        from matplotlib.figure import Figure

        history = next(iter(histories.values()))
        low_x, high_x, low_y, high_y = history.extra["bounds"]
        x, y = np.meshgrid(np.linspace(low_x, high_x, 151), np.linspace(low_y, high_y, 151))
        sensor = self.sensor(Scales(1.0, 1.0), history.landmarks)
        expected = sensor.read(np.stack([x, y, np.zeros_like(x)]), np.empty((0, 1)))
        sds = np.asarray(self.measurement_sd)[:, None, None]
        figure = Figure(figsize=(9.0, 3.9), layout="constrained")
        panels = figure.subplots(1, 3, sharex=True, sharey=True)
        chosen = np.unique(np.linspace(0, history.step.size - 1, len(panels)).astype(int))
        for axes, k in zip(panels, chosen, strict=False):
            likelihood = np.exp(-0.5 * (((history.values[:, k, None, None] - expected) / sds) ** 2).sum(axis=0))
            step = history.step[k]
            axes.pcolormesh(x, y, likelihood, cmap="Greys", vmin=0.0, shading="nearest", rasterized=True)
            axes.plot(*history.landmarks, "k^", ms=6, mfc="white", label="beacons")
            axes.plot(*history.truth[:2, step], "o", color="C3", ms=7, mfc="none", mew=2, label="robot")
            for name, one in histories.items():
                axes.plot(*one.mean[:2, step], "x", color=one.colour, ms=7, mew=2, label=f"{name}, mean")
            axes.set(title=f"{history.time[step]:.1f} s", aspect="equal", xlabel="x [m]")
            axes.set(xlim=(low_x, high_x), ylim=(low_y, high_y))
        panels[0].set_ylabel("y [m]")
        figure.suptitle(f"likelihood of the one sonar reading over the map · run {history.run}")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=6, frameon=False)
        return {"likelihood.png": figure}

    def _wander(self, streams: Streams, runs: Sequence[int], steps: int) -> tuple[Array, Array]:
        """A robot that drives from place to place: truth (3, T, runs), and [ds dth] as it moved (2, T, runs)."""
        low = np.array([self.bounds[0], self.bounds[2]]) + self.margin
        width = np.array([self.bounds[1], self.bounds[3]]) - self.margin - low
        begin = streams.uniforms("start", runs, (3,))
        goals = low[:, None, None] + width[:, None, None] * streams.uniforms("goals", runs, (2, _GOALS))
        pose = np.concatenate([low[:, None] + width[:, None] * begin[:2], TURN * begin[2:] - np.pi])
        every, goal = np.arange(len(runs)), np.zeros(len(runs), dtype=int)
        truth, moved = np.empty((3, steps, len(runs))), np.empty((2, steps, len(runs)))
        most, still = self.turn_rate * self.dt, np.zeros(2)
        for k in range(steps):
            dx, dy = goals[:, goal, every] - pose[:2]
            off = wrap(np.arctan2(dy, dx) - pose[2])
            turn = np.clip(off, -most, most)
            # Slower the farther off course, so that the robot does not circle a place forever.
            way = self.speed * self.dt * np.maximum(np.cos(off - turn), 0.1)
            moved[:, k] = way, turn
            pose = sonar_beams.SPACE.plus(
                np.stack(sonar_beams.turn_and_move(pose, moved[:, k], still, self.dt)), np.zeros(1)
            )
            truth[:, k] = pose
            goal = np.where(np.hypot(dx, dy) < _ARRIVED, (goal + 1) % _GOALS, goal)
        return truth, moved

    def _record(
        self,
        time: Array,
        truth: Array,
        encoder: Array,
        values: Array,
        beacons: Array,
        bounds: Array,
    ) -> Record:
        low, high = np.array([bounds[0], bounds[2], 0.0]), np.array([bounds[1], bounds[3], TURN])
        return Record(
            float(time[0]) - self.dt,
            time,
            truth,
            encoder,
            Readings(np.arange(time.size), values, np.zeros(values.shape[1:], dtype=int)),
            Uniform(low, high, values.shape[2]),
            landmarks=beacons,
            extra={"bounds": bounds},
        )
