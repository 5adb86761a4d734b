"""The scalar growth model, whose readings do not tell the state's sign. Gordon, Salmond and Smith 1993, section 5."""

from dataclasses import dataclass

import numpy as np

from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Space
from estlab.models.contract import Motion, Sensor
from estlab.scenarios.scenario import Scenario
from estlab.scenarios.simulation import drawn

STATE = Space(("x",), ("m",), position=(0,))
READING = Space(("squared",), ("m",))


def grow(state, control, noise, dt):
    (x,), (wave,), (w,) = state, control, noise
    return (0.5 * x + 25.0 * x / (1.0 + x * x) + wave + w,)


def squared(state, landmark):
    (x,) = state
    return (0.05 * x * x,)


@dataclass(frozen=True)
class Growth(Scenario):
    """x[k] = x/2 + 25 x / (1 + x^2) + 8 cos(1.2 k) + w, z = x^2 / 20 + v."""

    steps: int
    process_variance: float
    reading_variance: float

    @property
    def space(self):
        return STATE

    def motion(self, noise):
        cov = np.array([[noise.process_scale**2 * self.process_variance]])
        return Motion(STATE, grow, lambda control, dt: cov, 1)

    def sensor(self, noise, landmarks):
        cov = np.array([[noise.measurement_scale**2 * self.reading_variance]])
        return Sensor(READING, STATE, squared, cov, landmarks)

    def simulate(self, streams, runs, noise):
        time = np.arange(1.0, self.steps + 1.0)
        wave = 8.0 * np.cos(1.2 * time).reshape(1, -1, 1)
        prior = Gaussian(np.array([0.1]), np.array([[2.0]]))
        sensor = self.sensor(noise, np.empty((0, 1)))
        return drawn(streams, runs, self.motion(noise), sensor, prior, time, wave)
