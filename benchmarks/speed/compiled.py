"""``engine=numba`` on long single recordings, against plain loops and the NumPy engine; compiled before the clock runs.

python -m benchmarks.speed.compiled
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from benchmarks.speed import reference
from benchmarks.speed.turns import Row, faster
from estlab.config import Settings, build
from estlab.ensemble import Names, loop_of, record_of
from estlab.maths.streams import Streams
from estlab.models.contract import Motion, Sensor
from estlab.paths import conf_folder
from estlab.record import Estimates, Record

PLAIN = "plain loop, one Python call per sigma point"
REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "MRCLAM_Dataset6"
GOAL = 100.0
_STEPS = 1000  # of the plain loops, whose time is scaled up


def rows() -> Iterator[Row]:
    """Landmark EKF and car UKF on 30,000 steps; a real recording, where it is, against the NumPy engine."""
    landmark = Case("scenario=landmark", "filter=ekf", "scenario.duration=3000")
    yield landmark.row("landmark EKF, 1 run × 30,000 steps, engine=numba", landmark.plain_robot())
    car = Case("scenario=car", "filter=ukf", "filter.noise=additive", "scenario.dt=0.001", "scenario.duration=30")
    yield car.row("car UKF, 1 run × 30,000 steps, engine=numba", car.plain_car())
    if REAL.is_dir():
        real = Case("scenario=landmark", "filter=ekf", "data=files", f"data.path={REAL}", "data.prefix=Robot1_")
        work = f"MRCLAM_Dataset6 Robot1, EKF, {real.record.time.size:,} events, engine=numba"
        yield faster(work, real.compiled, "engine=numpy", real.numpy, real.share(3000), GOAL)


class Case:
    """A scenario's one run, all of it through the compiled loop and the first steps through the others."""

    def __init__(self, *words: str) -> None:
        with initialize_config_dir(str(conf_folder()), version_base="1.3"):
            composed = compose("config", overrides=[*words, "runs=1", "engine=numba"])
        self.settings = build(OmegaConf.to_container(composed, resolve=True))
        self.record = record_of(self.settings, Names("benchmark", "compiled"), range(1))

    def row(self, work: str, plain: Callable[[], object]) -> Row:
        """The compiled loop against a plain one."""
        return faster(work, self.compiled, PLAIN, plain, self.share(_STEPS), GOAL)

    def share(self, steps: int) -> float:
        """Of the record's steps."""
        return steps / self.record.time.size

    def compiled(self) -> Estimates:
        """What the compiled loop finds."""
        return self._estimated(self.settings, self.record)

    def numpy(self) -> Estimates:
        """What the NumPy engine finds in the first 3000 steps."""
        return self._estimated(replace(self.settings, engine="numpy"), self.record.first(3000))

    def plain_car(self) -> Callable[[], object]:
        """The reference over the first steps."""
        motion, sensor, record = *self._models(), self.record
        dt = self.settings.scenario.dt
        readings = record.readings.values[:, :_STEPS, 0].T
        rates = motion.noise_cov(np.empty((0, 1)), dt)
        prior = record.prior.mean[:, 0], record.prior.cov
        return partial(reference.car_ukf, *prior, readings, rates, sensor.noise_cov, dt)

    def plain_robot(self) -> Callable[[], object]:
        """The reference over the first steps."""
        motion, sensor, record = *self._models(), self.record
        dt, bounds = self.settings.scenario.dt, record.readings.bounds(_STEPS)
        values, target = record.readings.values[:, :, 0], record.readings.target[:, 0]
        readings = [
            [(values[:, i], record.places[:, target[i]]) for i in range(first, last) if np.isfinite(values[0, i])]
            for first, last in pairwise(bounds)
        ]
        controls = record.control[:, :_STEPS, 0].T
        noises = motion.noise_cov(controls[0], dt), sensor.noise_cov
        prior = record.prior.mean[:, 0], record.prior.cov
        return partial(reference.landmark_filter, True, *prior, controls, readings, *noises, dt)

    def _models(self) -> tuple[Motion, Sensor]:
        scenario, noise = self.settings.scenario, self.settings.noise.filter
        return scenario.motion(noise), scenario.sensor(noise, self.record.places)

    def _estimated(self, settings: Settings, record: Record) -> Estimates:
        draws = Streams(1, "benchmark").draws("filter", range(1))
        return loop_of(settings, settings.filter, record.places).estimate(record, draws)


if __name__ == "__main__":
    for row in rows():
        print(row)
