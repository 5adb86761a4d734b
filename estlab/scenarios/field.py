"""A robot on a square path that knows its odometry and sees the bearing of one landmark per step. Seed document 001."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from estlab.datasets import agreement, evaluation
from estlab.datasets.data_files import DEFAULTS, Files, Options
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Array, Space
from estlab.maths.stacking import matrix
from estlab.maths.streams import Streams
from estlab.maths.uniform import Uniform
from estlab.models import odometry
from estlab.models.contract import Motion, Sensor
from estlab.models.landmarks import BEARING, bearing, bearing_hessians, bearing_jacobian
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

# The square: steps per round, length of a step [cm], and the two steps of a round with two eighths of a turn; the
# second turn is on the spot.
_ROUND, _STRIDE = 50, 10.0
_MOVING_TURN, _STANDING_TURN = 20, 40
_EIGHTH = np.pi / 4.0


@dataclass(frozen=True)
class Field(Scenario):
    """Bearing-only localisation among known landmarks, from a known start or from anywhere."""

    file_names = evaluation.LAYOUT
    of_simulation: ClassVar = ("duration",)

    dt: float
    duration: float
    landmarks: list[list[float]]
    start: list[float]
    alphas: list[float]
    least_sd: float
    bearing_sd: float
    prior: Literal["known", "uniform"]
    prior_sd: list[float]
    box_low: list[float]
    box_high: list[float]
    found_radius: float
    lost_radius: float

    def __post_init__(self) -> None:
        check_positive(lost_radius=self.lost_radius)
        check_positive(least_sd=self.least_sd, bearing_sd=self.bearing_sd)
        check_positive(found_radius=self.found_radius)
        check_sds("prior_sd", self.prior_sd, 3)
        for name, numbers, size in (
            ("start", self.start, 3),
            ("alphas", self.alphas, 4),
            ("box_low", self.box_low, 2),
            ("box_high", self.box_high, 2),
        ):
            if len(numbers) != size:
                raise ValueError(f"{name} must have {size} numbers, got {len(numbers)}")
        check_duration(self.duration, self.dt)
        if not self.landmarks:
            raise ValueError("landmarks must have at least one, got none")
        for i, mark in enumerate(self.landmarks):
            if len(mark) != 2:
                raise ValueError(f"landmarks[{i}] must have 2 numbers, got {len(mark)}")
        for i, alpha in enumerate(self.alphas):
            if alpha < 0.0:
                raise ValueError(f"alphas[{i}] must be >= 0, got {alpha:g}")
        for i, (low, high) in enumerate(zip(self.box_low, self.box_high, strict=True)):
            if not low < high:
                raise ValueError(f"box_high[{i}] must be > box_low[{i}]={low:g}, got {high:g}")

    def unread(self, source: Literal["simulated", "files"]) -> dict[str, str]:
        if self.prior == "known":
            keys = dict.fromkeys(("box_low", "box_high", "found_radius"), "scenario.prior=uniform")
        else:
            keys = dict.fromkeys(("start", "prior_sd"), "scenario.prior=known")
            if source == "files":
                del keys["start"]  # the start of the commanded path
        return keys | super().unread(source)

    @property
    def lost_beyond(self) -> float:
        return self.lost_radius

    @property
    def space(self) -> Space:
        return odometry.SPACE

    @property
    def found_within(self) -> float | None:
        return self.found_radius if self.prior == "uniform" else None

    def motion(self, noise: Scales) -> Motion:
        alphas = noise.process_scale**2 * np.array(self.alphas)
        least = noise.process_scale * self.least_sd
        return Motion(
            odometry.SPACE,
            odometry.turn_move_turn,
            lambda control, dt: odometry.noise_cov(control, alphas, least),
            3,
            odometry.jacobians,
            odometry.hessians,
        )

    def sensor(self, noise: Scales, landmarks: Array) -> Sensor:
        cov = noise.measurement_scale**2 * diagonal_cov([self.bearing_sd])
        return Sensor(
            BEARING,
            odometry.SPACE,
            bearing,
            cov,
            landmarks,
            bearing_jacobian,
            bearing_hessians,
        )

    def simulate(self, streams: Streams, runs: Sequence[int], noise: Scales) -> Record:
        steps = round(self.duration / self.dt)
        command = _square(steps)
        prior = self._belief(len(runs))
        # With an unknown start, each run begins somewhere else: a fixed start could flatter a filter.
        begin = prior.sample(streams.generators("start", runs), 1)[:, 0] if isinstance(prior, Uniform) else prior.mean
        time = self.dt * np.arange(1, steps + 1)
        truth = simulation.walk(streams, runs, self.motion(noise), begin, time, command[:, :, None])
        # The landmarks take turns, two readings each: the reading of step k, from 1, is of floor(k / 2) mod 6.
        landmark_number = np.arange(1, steps + 1) // 2 % self._landmarks.shape[1]
        sensor = self.sensor(noise, self._landmarks)
        values = simulation.read(streams, runs, sensor, truth, sensor.landmark(landmark_number[:, None]))
        record = self._record(begin, command, truth, values, landmark_number)
        return record if isinstance(prior, Uniform) else replace(record, origin=begin)

    def read(
        self, folder: Path, prefix: str, streams: Streams, runs: Sequence[int], options: Options = DEFAULTS
    ) -> Record:
        path = Files(folder, prefix, self.file_names, options.names).path("data")
        found, remarks = evaluation.read(path, self._landmarks.shape[1])
        record = self._record(
            np.array(self.start)[:, None].repeat(len(runs), axis=1),
            found.motion.T,
            found.path.T[:, :, None].repeat(len(runs), axis=2),
            found.readings.T[:1, :, None].repeat(len(runs), axis=2),
            found.readings[:, 1].astype(int),
        )
        remarks += self._agreement(found, str(path))
        return replace(record, files=(path,), remarks=remarks, repeated=True)

    def _agreement(self, found: evaluation.Evaluation, what: str) -> tuple[str, ...]:
        x, y, heading = found.path.T
        landmark = self._landmarks[:, found.readings[:, 1].astype(int)]
        expected = np.arctan2(landmark[1] - y, landmark[0] - x) - heading
        course = heading + np.append(found.motion[1:, 0], 0.0)
        return (
            *agreement.of_readings("bearings", found.readings[:, 0], expected, what, agreement.ANGLE),
            *agreement.of_lengths(found.motion[1:, 1], x, y, course, what),
        )

    def write(self, record: Record, folder: Path, prefix: str) -> list[Path]:
        truth, landmark_number = record.truth[:, :, 0], record.readings.landmark_number[:, 0]
        exact = BEARING.plus(np.stack(bearing(truth, record.landmarks[:, landmark_number])), np.zeros(1))
        made = evaluation.Evaluation(
            motion=record.control[:, :, 0].T,
            readings=np.column_stack([record.readings.values[0, :, 0], landmark_number]),
            exact_readings=np.column_stack([exact[0], landmark_number]),
            path=truth.T,
            exact_path=record.extra["commanded"].T,
        )
        return [evaluation.write(made, folder / f"{prefix}{evaluation.LAYOUT['data'][0]}")]

    def table(self, histories: dict[str, History]) -> dict[str, list[Any]]:
        """For a run of a single step: the matrices of the linearisation, row by row, as in the document.

        Q of the reading, M of the command, G and V of the motion at the start, H of the reading at the predicted
        pose.
        """
        history = next(iter(histories.values()))
        if self.prior != "known" or history.time.size > 1 or not history.step.size:
            return {}
        motion, sensor = self.motion(Scales(1.0, 1.0)), self.sensor(Scales(1.0, 1.0), history.landmarks)
        command, start = history.extra["command"], np.array(self.start)
        by_state, by_noise = (matrix(rows, ()) for rows in odometry.jacobians(start, command, self.dt))
        ahead = np.stack(odometry.turn_move_turn(start, command, np.zeros(3), self.dt))
        seen = matrix(bearing_jacobian(ahead, history.landmarks[:, history.landmark_number[0]]), ())
        of = {"Q": sensor.noise_cov, "M": motion.noise_cov(command, self.dt), "G": by_state, "V": by_noise, "H": seen}
        rows = {f"{name}{i + 1}" if len(m) > 1 else name: row for name, m in of.items() for i, row in enumerate(m)}
        columns = [
            [float(f"{row[i]:.6g}") + 0.0 if i < len(row) else math.nan for row in rows.values()] for i in range(3)
        ]
        return {"row": list(rows), "1": columns[0], "2": columns[1], "3": columns[2]}

    def draw(self, axes: "Axes", history: History) -> None:
        commanded = history.extra["commanded"][:2, : history.time.size]
        axes.plot(*commanded, "--", color="0.6", lw=1.0, label="commanded path")
        axes.plot(*history.landmarks, "ks", ms=6, label="landmarks")
        for i, landmark in enumerate(history.landmarks.T):
            axes.annotate(str(i), landmark, xytext=(6, 6), textcoords="offset points", fontsize="small")

    @property
    def _landmarks(self) -> Array:
        return np.array(self.landmarks).T

    def _record(
        self,
        begin: Array,
        command: Array,
        truth: Array,
        values: Array,
        landmark_number: Array,
    ) -> Record:
        """One reading per step.

        begin (3, runs), command (3, T), truth (3, T, runs), values (1, T, runs); landmark_number (T,).
        """
        steps, every = landmark_number.size, begin.shape[1]
        readings = Readings(np.arange(steps), values, landmark_number[:, None].repeat(every, axis=1))
        return Record(
            0.0,
            self.dt * np.arange(1, steps + 1),
            truth,
            command[:, :, None],
            readings,
            self._belief(every),
            landmarks=self._landmarks,
            extra={"commanded": self._obeyed(begin[:, 0], command), "command": command[:, 0]},
        )

    def _belief(self, runs: int) -> Gaussian | Uniform:
        if self.prior == "uniform":
            return Uniform(np.array([*self.box_low, -math.pi]), np.array([*self.box_high, math.pi]), runs)
        return Gaussian(np.array(self.start)[:, None].repeat(runs, axis=1), diagonal_cov(self.prior_sd))

    def _obeyed(self, pose: Array, command: Array) -> Array:
        """The path (3, T) from a pose of a robot that follows its commands exactly."""
        path = np.empty(command.shape)
        for k in range(command.shape[1]):
            moved = odometry.turn_move_turn(pose, command[:, k], np.zeros(3), self.dt)
            path[:, k] = pose = odometry.SPACE.plus(np.stack(moved), np.zeros(1))
        return path


def _square(steps: int) -> Array:
    """The commands (3, steps) of the square, step n counted from 1."""
    n = np.arange(1, steps + 1) % _ROUND
    turn = np.where((n == _MOVING_TURN) | (n == _STANDING_TURN), _EIGHTH, 0.0)
    return np.stack([turn, np.where(n == _STANDING_TURN, 0.0, _STRIDE), turn])
