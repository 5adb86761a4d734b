"""Runs a filter over the time line of a record."""

from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from estlab.filters.filter import AnyFilter, Belief, Cloud, check_traits
from estlab.filters.smoother import Link, smooth
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Array
from estlab.maths.streams import Generators
from estlab.models.contract import Motion, Sensor
from estlab.record import Estimates, Record

Scheme = Literal["sequential", "stacked", "interleaved"]

_CLOUDS = 6  # moments at which clouds are stored


class Loop:
    """Predict to each time, then update with the readings taken there.

    scheme: how to use several readings at one time: one after another, as one long reading, or one after another with
    a prediction of ``pause`` [s] at zero command between them.
    A Gaussian belief that stops being one becomes NaN and stays NaN; the other runs continue.
    """

    def __init__(
        self, filter: AnyFilter, motion: Motion, sensor: Sensor, scheme: Scheme = "sequential", pause: float = 0.0
    ) -> None:
        self.filter, self.motion, self.sensor, self.scheme, self.pause = filter, motion, sensor, scheme, pause

    def check(self) -> None:
        """Raise ValueError that names the filter's key if filter and models do not fit together."""
        check_traits(self.filter)
        self.filter.check(self.motion, self.sensor)
        if self.scheme == "stacked" and self.filter.traits.gate is not None:
            raise ValueError("gate would reject all readings of a time because of one; set scenario.update=sequential")

    @property
    def compiles(self) -> bool:
        """Whether to compile the filter's steps to machine code, if its models allow it."""
        return False

    def check_engine(self) -> None:
        """Raise ValueError if the engine does not support this filter; NumPy supports all."""

    def prepare(self, record: Record, generators: Generators) -> None:
        """One-time preparation that is no part of a filter's cost; NumPy needs none."""

    def check_smoother(self) -> None:
        """Raise ValueError if there is no smoother for this filter and scheme."""
        if not self.filter.traits.smooths:
            raise ValueError("this filter has no smoother; use one of the Gaussian family (ekf, ukf, ckf, ...)")
        if self.scheme == "interleaved":
            raise ValueError("the smoother does not support predictions between readings; set another scenario.update")

    def estimate(
        self, record: Record, generators: Generators, on_step: Callable[[], None] = lambda: None, watched: int = 0
    ) -> Estimates:
        """The belief after each step. generators: the filter's own. on_step: called after every step.

        watched: the number of first runs whose cloud is stored at some steps, if the belief is one.
        """
        if record.runs == 1 and self.filter.traits.single and self.scheme != "stacked":
            return self._alone(record, generators, on_step)
        return self._forward(record, generators, on_step, None, watched)

    def estimate_and_smooth(
        self, record: Record, generators: Generators, on_step: Callable[[], None] = lambda: None
    ) -> tuple[Estimates, Estimates]:
        """The belief after each step, and the belief given all readings."""
        links: list[Link | None] = []
        filtered = self._forward(record, generators, on_step, links)
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            mean, cov = smooth(self.motion.space, links, filtered.mean, filtered.cov)
        nothing = np.full_like(filtered.whitened, np.nan)
        return filtered, Estimates(mean, cov, nothing, nothing, None, {})

    def _forward(
        self,
        record: Record,
        generators: Generators,
        on_step: Callable[[], None],
        links: list[Link | None] | None,
        watched: int = 0,
    ) -> Estimates:
        steps, runs, n = record.time.size, record.runs, self.motion.space.size
        mean, cov = np.empty((n, steps, runs)), np.empty((n, n, steps, runs))
        whitened, log_scale = np.full((2, *record.readings.values.shape), np.nan)
        sample = None
        clouds: dict[int, Cloud] = {}
        moments = set(cloud_steps(steps)) if watched else set()
        notes: dict[str, Array] = {"gated": np.zeros((steps, runs))}
        lapse = np.diff(record.time, prepend=record.start)
        bounds = record.readings.bounds(steps)
        has = np.asarray(~np.isnan(record.readings.values).all(axis=0))
        belief = self.filter.start(record.prior, generators)
        # NaN marks a run that diverged, so the arithmetic that carries it is not worth a warning.
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            for k in range(steps):
                belief, link = self._predict(belief, record.control[:, k], float(lapse[k]), links is not None)
                if links is not None:
                    links.append(link)
                if bounds[k + 1] > bounds[k]:
                    taken = slice(bounds[k], bounds[k + 1])
                    belief, notes["gated"][k] = self._update(
                        belief, record, taken, has[taken], whitened[:, taken], log_scale[:, taken]
                    )
                mean[:, k], cov[:, :, k] = self.filter.moments(belief, self.motion)
                if (sampled := self.filter.sample(belief)) is not None:
                    sample = np.empty((2, steps, runs)) if sample is None else sample
                    sample[:, k] = sampled
                for name, values in self.filter.notes(belief).items():
                    notes.setdefault(name, np.zeros((steps, runs)))[k] = values
                if k in moments and (cloud := self.filter.cloud(belief, watched)) is not None:
                    clouds[k] = cloud
                on_step()
        arrays = _as_arrays(clouds)
        return Estimates(mean, cov, whitened, log_scale, sample, notes, self.filter.traits.gate, arrays)

    def _alone(self, record: Record, generators: Generators, on_step: Callable[[], None]) -> Estimates:
        """For a single run and a Gaussian belief: no array has the axis of runs, so models work on plain numbers.

        The arithmetic equals that of many runs, number for number.
        """
        steps, n, filter = record.time.size, self.motion.space.size, self.filter
        mean, cov, gated = np.empty((steps, n)), np.empty((steps, n, n)), np.zeros(steps)
        values = np.ascontiguousarray(record.readings.values[:, :, 0].T)
        whitened, log_scale = np.full((2, *values.shape), np.nan)
        has = (~np.isnan(values).all(axis=1)).tolist()
        landmarks = self.sensor.landmark(record.readings.landmark_number[:, 0]).T
        control, at_rest = np.ascontiguousarray(record.control[:, :, 0].T), np.zeros(record.control.shape[0])
        lapse = np.diff(record.time, prepend=record.start).tolist()
        bounds = record.readings.bounds(steps).tolist()
        start = filter.start(record.prior, generators)
        belief = Gaussian(start.mean[..., 0], start.cov[..., 0])
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            for k in range(steps):
                if lapse[k] > 0.0:
                    belief = filter.predict(self.motion, belief, control[k], lapse[k])
                for i in range(bounds[k], bounds[k + 1]):
                    if not has[i]:
                        continue
                    if self.scheme == "interleaved" and i > bounds[k]:
                        belief = filter.predict(self.motion, belief, at_rest, self.pause)
                    belief, innovation = filter.update(self.sensor, belief, values[i], landmarks[i])
                    whitened[i], log_scale[i] = innovation.whitened, innovation.log_scale
                    gated[k] += innovation.gated
                mean[k], cov[k] = belief
                on_step()
        return Estimates(
            np.moveaxis(mean, 0, -1)[..., None],
            np.moveaxis(cov, 0, -1)[..., None],
            whitened.T[..., None],
            log_scale.T[..., None],
            None,
            {"gated": gated[:, None]},
            filter.traits.gate,
        )

    def _predict(self, belief: Any, control: Array, lapse: float, linked: bool) -> tuple[Any, Link | None]:
        if lapse <= 0.0:
            return belief, None
        if linked:
            after = self.filter.propagate(self.motion, belief, control, lapse)
            return belief._replace(mean=after.mean, cov=after.cov), Link(belief, after)
        return self.filter.predict(self.motion, belief, control, lapse), None

    def _update(
        self, belief: Belief, record: Record, taken: slice, has: Array, whitened: Array, log_scale: Array
    ) -> tuple[Belief, Array]:
        """Use a step's readings, store their innovations, and count the gated readings of each run.

        has: (readings, runs), which run has which; a run without a reading is not updated.
        """
        values, landmark_number = record.readings.values[:, taken], record.readings.landmark_number[taken]
        if self.scheme == "stacked":
            return self._stacked(belief, values, landmark_number, has, whitened, log_scale)

        gated = np.zeros(record.runs)
        at_rest = np.zeros((record.control.shape[0], 1))
        for i in np.flatnonzero(has.any(axis=1)):
            everyone = has[i].all()
            # A slice selects all runs, because NumPy does not copy for it.
            runs: Any = slice(None) if everyone else np.flatnonzero(has[i])
            part = belief if everyone else belief.take(runs)
            if self.scheme == "interleaved" and i > 0:
                part = self.filter.predict(self.motion, part, at_rest, self.pause)
            landmark = self.sensor.landmark(landmark_number[i, runs])
            part, innovation = self.filter.update(self.sensor, part, values[:, i, runs], landmark)
            belief = part if everyone else belief.replaced(runs, part)
            whitened[:, i, runs], log_scale[:, i, runs] = innovation.whitened, innovation.log_scale
            gated[runs] += innovation.gated
        return belief, gated

    def _stacked(
        self, belief: Belief, values: Array, landmark_number: Array, has: Array, whitened: Array, log_scale: Array
    ) -> tuple[Belief, Array]:
        """All of a run's readings as one, separately for the runs with each number of readings."""
        gated, counts = np.zeros(has.shape[1]), has.sum(axis=0)
        for count in np.unique(counts[counts > 0]):
            runs = np.flatnonzero(counts == count)
            slots = np.argsort(~has[:, runs], axis=0, kind="stable")[:count]
            landmarks = self.sensor.landmark(np.take_along_axis(landmark_number[:, runs], slots, axis=0))
            long = np.take_along_axis(values[:, :, runs], slots[None], axis=1).swapaxes(0, 1).reshape(-1, runs.size)
            part, innovation = self.filter.update(self.sensor.times(int(count)), belief.take(runs), long, landmarks)
            belief = belief.replaced(runs, part)
            # With a triangular factor, the parts of a long innovation equal those of its readings used in turn.
            for room, parts in ((whitened, innovation.whitened), (log_scale, innovation.log_scale)):
                room[:, slots, runs] = parts.reshape(count, -1, runs.size).swapaxes(0, 1)
            gated[runs] += innovation.gated
        return belief, gated


def cloud_steps(steps: int) -> list[int]:
    """The steps at which clouds are stored: the first, the last, and steps between them in geometric progression."""
    kept: list[int] = []
    for step in np.rint(np.geomspace(1, steps, _CLOUDS)):
        kept.append(max(int(step) - 1, len(kept) and kept[-1] + 1))
    return [step for step in kept if step < steps]


def _as_arrays(clouds: dict[int, Cloud]) -> dict[str, Array]:
    """Clouds by step as arrays: step (K,), points (n, K, S, runs), weights (K, S, runs)."""
    if not clouds:
        return {}
    points, weights = zip(*clouds.values(), strict=True)
    return {"step": np.array(list(clouds)), "points": np.stack(points, axis=1), "weights": np.stack(weights)}
