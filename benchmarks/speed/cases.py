"""What is timed: a scenario's record with the filter loop over it, and the plain loop over one of its runs."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial
from itertools import pairwise

import numpy as np

from benchmarks.speed import reference
from estlab.config.build import build
from estlab.config.settings import Names, Settings
from estlab.experiment.monte_carlo import loop_of, record_of
from estlab.filters.loop import Loop
from estlab.launch.in_process import compose
from estlab.maths.streams import Streams
from estlab.record import Estimates, Readings, Record

PLAIN = "plain loop"
NAMES = Names("benchmark", "benchmark")


def settings_of(*words: str) -> Settings:
    """The settings that these words of a command line compose."""
    request, _ = compose(words)
    return build(request.plain, NAMES)


class Case:
    """An ensemble ready for its filter, and the fixed reference over the first of its runs."""

    def __init__(self, *words: str) -> None:
        self.settings = settings_of(*words)

    @cached_property
    def record(self) -> Record:
        """Truth and readings of all runs."""
        return record_of(self.settings, self.settings.run_numbers)

    @cached_property
    def loop(self) -> Loop:
        """The filter with its models."""
        return loop_of(self.settings, self.settings.filter, self.record.landmarks)

    def filtered(self) -> Estimates:
        """What the filter finds in all runs, as one block."""
        generators = Streams(1, "benchmark").generators("filter", self.settings.run_numbers)
        return self.loop.estimate(self.record, generators)

    def plain_car(self, steps: int, transform: reference.Transform = reference.unscented) -> Callable[[], object]:
        """The reference over the first steps of the car's first run."""
        record, dt = self.record, self.settings.scenario.dt
        readings = record.readings.values[:, :steps, 0].T
        rates = self.loop.motion.noise_cov(np.empty((0, 1)), dt)
        prior = record.prior.mean[:, 0], record.prior.cov
        return partial(reference.car_ukf, *prior, readings, rates, self.loop.sensor.noise_cov, dt, transform)

    def plain_robot(self, steps: int, linearised: bool) -> Callable[[], object]:
        """The reference, EKF or UKF, over the first steps of the landmark scenario's first run."""
        record, dt = self.record, self.settings.scenario.dt
        values, landmark_number = record.readings.values[:, :, 0], record.readings.landmark_number[:, 0]
        readings = [
            [
                (values[:, i], record.landmarks[:, landmark_number[i]])
                for i in range(first, last)
                if np.isfinite(values[0, i])
            ]
            for first, last in pairwise(record.readings.bounds(steps))
        ]
        controls = record.control[:, :steps, 0].T
        noises = self.loop.motion.noise_cov(controls[0], dt), self.loop.sensor.noise_cov
        prior = record.prior.mean[:, 0], record.prior.cov
        return partial(reference.landmark_filter, linearised, *prior, controls, readings, *noises, dt)


class OneReading(Case):
    """The landmark scenario with one reading at each step, of one landmark after another, which every run has."""

    def __init__(self, *words: str) -> None:
        sight = ("scenario.reading_every=1", "scenario.dropped=0", "scenario.max_range=100")
        super().__init__("scenario=landmark", *sight, "scenario.field_of_view=6.283185", *words)

    @cached_property
    def record(self) -> Record:
        whole = record_of(self.settings, self.settings.run_numbers)
        steps, marks = whole.time.size, whole.landmarks.shape[1]
        taken = np.arange(steps) * marks + np.arange(steps) % marks
        readings = whole.readings
        taken_readings = Readings(readings.step[taken], readings.values[:, taken], readings.landmark_number[taken])
        return replace(whole, readings=taken_readings)
