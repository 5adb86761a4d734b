"""A small robot on a table, seen by a camera from above. Seed document 004."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from estlab.compiled.normals import normals
from estlab.datasets import epuck_recording as files
from estlab.datasets.data_files import DEFAULTS, Files, Options
from estlab.errors import UserError
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.linalg import cholesky
from estlab.maths.space import Array, Space, wrap
from estlab.maths.streams import Streams
from estlab.models import camera
from estlab.models.contract import Motion, Sensor
from estlab.record import Readings, Record
from estlab.scenarios import simulation
from estlab.scenarios.closeness import CLOSENESS, closeness
from estlab.scenarios.scenario import History, Scales, Scenario, check_duration, check_positive, check_sds

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

X, Y, SPEED, HEADING = range(4)

# The simulated drive, as lively as the filmed one: corners of a tour on the table [cm], each with the speed [cm/s]
# toward it.
_TOUR = np.array([[28, 8], [36, 24], [18, 28], [8, 42], [26, 50], [36, 38], [54, 42], [56, 24], [44, 8]]).T
_SPEED = np.array([6.0, 6.5, 6.0, 4.0, 6.0, 6.5, 6.0, 4.0, 6.0])
_ARRIVED = 5.0  # [cm] from a corner at which the robot heads for the next
_BEND = 1.0  # [rad/s], its fastest turn
_EAGER = 4.0  # [1/s], turn rate per radian off course, up to the fastest
_BEGIN = np.array([14.0, 10.0, 7.0, 0.0])
_BEGIN_WITHIN = np.array([3.0, 3.0, 0.5, 0.2])  # a run's start is uniform within this of the start above
_SUBSTEPS = 10  # frames of the film for each one that is used
_HEADING_SD = np.radians(10.0)  # of the initial estimate, in the document


@dataclass(frozen=True)
class Epuck(Scenario):
    """Position fixes of a robot whose speed and heading walk at random."""

    of_simulation: ClassVar = ("duration", "truth", "alpha_sd", "wobble_sd")
    file_names = files.LAYOUT

    dt: float
    duration: float
    truth: Literal["drive", "model"]
    dv2: float
    dth2: float
    fix_variance: float
    led_sd: float
    alpha_sd: float
    wobble_sd: list[float]
    initial_covariance: Literal["diagonal", "document"]
    lost_radius: float

    def __post_init__(self) -> None:
        check_positive(lost_radius=self.lost_radius)
        check_positive(dv2=self.dv2, dth2=self.dth2)
        check_positive(fix_variance=self.fix_variance, led_sd=self.led_sd, alpha_sd=self.alpha_sd)
        check_sds("wobble_sd", self.wobble_sd, 2)
        check_duration(self.duration, self.dt)
        if self.duration < 2.0 * self.dt:
            raise ValueError(f"duration must be at least two steps of dt={self.dt:g}, got {self.duration:g}")
        if np.isnan(cholesky(self._initial_cov())).any():
            raise ValueError(
                "initial_covariance=document is not a covariance: not positive definite, its x-heading "
                f"correlation is {self._x_heading_correlation():.2f}; use diagonal, which omits the cross terms"
            )

    def unread(self, source: Literal["simulated", "files"]) -> dict[str, str]:
        keys = {"wobble_sd": "scenario.truth=drive"} if self.truth == "model" else {}
        return keys | super().unread(source)

    @property
    def lost_beyond(self) -> float:
        return self.lost_radius

    @property
    def space(self) -> Space:
        return camera.SPACE

    def motion(self, noise: Scales) -> Motion:
        cov = noise.process_scale**2 * np.diag([self.dv2, self.dth2])
        return Motion(
            camera.SPACE, camera.coast, lambda control, dt: cov, 2, camera.coast_jacobians, camera.coast_hessians
        )

    def sensor(self, noise: Scales, landmarks: Array) -> Sensor:
        cov = noise.measurement_scale**2 * self.fix_variance * np.eye(2)
        return Sensor(camera.FIX, camera.SPACE, camera.fix, cov, landmarks, camera.fix_jacobian)

    def simulate(self, streams: Streams, runs: Sequence[int], noise: Scales) -> Record:
        steps = round(self.duration / self.dt)
        begin = _BEGIN[:, None] + _BEGIN_WITHIN[:, None] * (streams.uniforms("start", runs, (4,)) * 2.0 - 1.0)
        if self.truth == "model":
            time = self.dt * np.arange(1, steps + 1)
            walk = simulation.walk(streams, runs, self.motion(noise), begin, time, np.empty((0, steps, 1)))
        else:
            walk = self._drive(streams, runs, begin, steps, noise.process_scale)
        truth = np.concatenate([begin[:, None], walk], axis=1)
        blur = noise.measurement_scale * normals(streams, "readings", runs, (3, steps + 1))
        fixes = truth[:SPEED] + self.led_sd * blur[:2]
        alpha = wrap(truth[HEADING] + self.alpha_sd * blur[2])
        record = self._record(truth, fixes, alpha[:, 0])
        return replace(record, origin=begin) if self._has_bound(noise) else record

    def read(
        self, folder: Path, prefix: str, streams: Streams, runs: Sequence[int], options: Options = DEFAULTS
    ) -> Record:
        recording = files.read(Files(folder, prefix, self.file_names, options.names))
        fixes = recording.fixes[:, :, None].repeat(len(runs), axis=2)
        beside = "; alpha, also measured, is shown beside the estimates" if np.isfinite(recording.alpha).any() else ""
        record = self._record(np.full((4, *fixes.shape[1:]), np.nan), fixes, recording.alpha, recording.first)
        return replace(
            record,
            files=recording.files,
            remarks=(f"the files hold no truth: nothing is scored{beside}", *recording.remarks),
            repeated=True,
        )

    def write(self, record: Record, folder: Path, prefix: str) -> list[Path]:
        if record.time.size < 2:
            raise UserError("steps must be >= 2: the files need three rows, two of them for the initial estimate")
        kept = slice(record.time.size + 1)
        return files.write(
            files.EpuckRecording(record.extra["fixes"][:, kept], record.extra["alpha"][kept]), folder, prefix
        )

    def draw(self, axes: "Axes", history: History) -> None:
        axes.plot(*history.values, ".", color="0.6", ms=3, label="camera fixes")

    def table(self, histories: dict[str, History]) -> dict[str, list[Any]]:
        """How close the first run of each filter stays to the measurements, and how smoothly; needs no truth."""
        rows = [closeness(history, _until(history)[0]) for history in histories.values()]
        return {
            f"run {next(iter(histories.values())).run}": list(histories),
            **{
                name: list(column)
                for name, column in zip(CLOSENESS, zip(*rows, strict=True), strict=True)
                if not np.isnan(column).all()
            },
        }

    def pictures(self, histories: dict[str, History]) -> "dict[str, Figure]":
        from matplotlib.figure import Figure

        figure = Figure(figsize=(9.0, 6.4), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True)
        first = next(iter(histories.values()))
        alpha, time, fixes = _until(first)
        lapse = np.diff(time)
        above.plot(
            time[1:] - 0.5 * lapse,
            np.hypot(*np.diff(fixes)) / lapse,
            ".",
            color="0.6",
            ms=4,
            label="from differences of the fixes; alpha",
        )
        steady = _unrolled(alpha)
        below.plot(time, np.where(np.isfinite(alpha), steady, np.nan), ".", color="0.6", ms=4)
        for axes in (above, below):
            if np.isfinite(axes.dataLim.intervaly).all():
                axes.set_ylim(*_with_room(axes.dataLim.intervaly))
            axes.grid(alpha=0.3)
        if np.isfinite(first.truth).any():
            above.plot(first.time, first.truth[SPEED], color="black", lw=1.6, label="truth")
            below.plot(first.time, _near(first.truth[HEADING], steady[1:]), color="black", lw=1.6)
        for name, history in histories.items():
            above.plot(history.time, history.mean[SPEED], color=history.colour, lw=1.1, label=name)
            below.plot(history.time, _near(history.mean[HEADING], steady[1:]), color=history.colour, lw=1.1)
        above.set_ylabel("speed [cm/s]")
        below.set_ylabel("heading [rad]")
        below.set_xlabel("time [s]")
        figure.suptitle(f"epuck · speed and heading · run {first.run} · dv2 {self.dv2:g}, dth2 {self.dth2:g}")
        handles, labels = above.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False, fontsize="small")
        return {"epuck_motion.png": figure}

    def _drive(self, streams: Streams, runs: Sequence[int], begin: Array, steps: int, scale: float) -> Array:
        """A robot that heads for one corner of the tour after another: truth (4, steps, runs).

        Every frame of the film is a step, so the robot's path bends between fixes, which the filter's model does not.
        """
        frame = self.dt / _SUBSTEPS
        wobble = normals(streams, "truth", runs, (steps * _SUBSTEPS, 2)) * scale * np.sqrt(frame)
        wobble = wobble * np.asarray(self.wobble_sd)[:, None]
        truth, state, goal = np.empty((4, steps, len(runs))), begin, np.zeros(len(runs), dtype=int)
        for k in range(steps * _SUBSTEPS):
            x, y, speed, heading = state
            dx, dy = _TOUR[0, goal] - x, _TOUR[1, goal] - y
            turn = frame * np.clip(_EAGER * wrap(np.arctan2(dy, dx) - heading), -_BEND, _BEND)
            faster = frame * 0.5 * (_SPEED[goal] - speed)
            middle = heading + 0.5 * turn
            x, y = x + frame * speed * np.cos(middle), y + frame * speed * np.sin(middle)
            state = np.stack([x, y, speed + faster + wobble[k, 0], heading + turn + wobble[k, 1]])
            truth[:, k // _SUBSTEPS] = state
            goal = np.where(np.hypot(dx, dy) < _ARRIVED, (goal + 1) % _SPEED.size, goal)
        return camera.SPACE.plus(truth, np.zeros(1))

    def _record(self, truth: Array, fixes: Array, alpha: Array, first: int = 0) -> Record:
        """The record from the first fix on. The first two fixes make the initial estimate; the second is also a
        reading.

        first: the number of its frame.
        """
        time = self.dt * (first + np.arange(fixes.shape[1]))
        steps = time.size - 1
        dx, dy = fixes[:, 1] - fixes[:, 0]
        begin = np.stack([*fixes[:, 0], np.hypot(dx, dy) / self.dt, np.arctan2(dy, dx)])
        return Record(
            float(time[0]),
            time[1:],
            truth[:, 1:],
            np.empty((0, steps, 1)),
            Readings(np.arange(steps), fixes[:, 1:], np.zeros((steps, fixes.shape[2]), dtype=int)),
            Gaussian(begin, self._initial_cov()),
            extra={"frame_time": time, "fixes": fixes[:, :, 0], "alpha": alpha},
        )

    def _has_bound(self, noise: Scales) -> bool:
        """Whether everything is drawn from the model, and the prior knows at least as much about the start as the
        first fix tells.

        The initial covariance has a third of the fix's variance, whatever the scale of the simulated fixes.
        """
        as_assumed = math.isclose(self.led_sd**2, self.fix_variance, rel_tol=1e-3)
        return self.truth == "model" and as_assumed and noise.measurement_scale**2 >= 1.0 / 3.0

    def _initial_cov(self) -> Array:
        """Document 004, equation 12; its cross terms only if requested."""
        place = self.led_sd**2 / 3.0  # the mean of three lights
        cov = np.diag([place, place, 2.0 * place / self.dt**2, _HEADING_SD**2])
        if self.initial_covariance == "document":
            cov[np.ix_([X, Y], [SPEED, HEADING])] = cov[np.ix_([SPEED, HEADING], [X, Y])] = place
        return cov

    def _x_heading_correlation(self) -> float:
        cov = self._initial_cov()
        return float(cov[X, HEADING] / np.sqrt(cov[X, X] * cov[HEADING, HEADING]))


def _until(history: History) -> tuple[Array, Array, Array]:
    """alpha, time and fixes of all frames up to the last step, the first frame included."""
    kept = slice(history.time.size + 1)
    return history.extra["alpha"][kept], history.extra["frame_time"][kept], history.extra["fixes"][:, kept]


def _unrolled(alpha: Array) -> Array:
    """alpha without jumps at the cut; where it was not measured, as between its neighbours."""
    known = np.flatnonzero(np.isfinite(alpha))
    if not known.size:
        return np.zeros(alpha.size)
    return np.interp(np.arange(alpha.size), known, np.unwrap(alpha[known]))


def _near(heading: Array, about: Array) -> Array:
    """The headings, shifted by whole turns to be close to others, so that no line jumps at the cut."""
    return about + wrap(heading - about)


def _with_room(interval: Array) -> tuple[float, float]:
    """Limits with half as much room again; an estimate beyond them has left the measurements."""
    low, high = interval
    room = 0.25 * max(high - low, 1e-3)
    return low - room, high + room
