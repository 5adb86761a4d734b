"""A cart that white acceleration drives: noise of rank one. Bar-Shalom, Li and Kirubarajan 2001, section 6.3.2."""

from dataclasses import dataclass

import numpy as np

from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Space
from estlab.models.contract import Motion, Sensor
from estlab.scenarios.scenario import Scenario
from estlab.scenarios.simulation import drawn

STATE = Space(("place", "velocity"), ("m", "m/s"), position=(0,))
READING = Space(("place",), ("m",))


def coast(state, control, noise, dt):
    place, velocity = state
    jump, gain = noise
    return place + dt * velocity + jump, velocity + gain


def place(state, where):
    return (state[0],)


@dataclass(frozen=True)
class Cart(Scenario):
    """Acceleration is constant over a step and independent from step to step. known: the start is."""

    acceleration_sd: float
    reading_sd: float
    steps: int
    known: bool

    @property
    def space(self):
        return STATE

    def motion(self, noise):
        sd = noise.process_scale * self.acceleration_sd

        def noise_cov(control, dt):
            gain = sd * np.array([0.5 * dt * dt, dt])
            return np.outer(gain, gain)

        return Motion(STATE, coast, noise_cov, 2)

    def sensor(self, noise, landmarks):
        return Sensor(READING, STATE, place, np.array([[(noise.measurement_scale * self.reading_sd) ** 2]]), landmarks)

    def simulate(self, streams, runs, noise):
        time = 0.3 * np.arange(1, self.steps + 1)
        prior = Gaussian(np.array([1.0, 0.5]), np.zeros((2, 2)) if self.known else np.diag([4.0, 1.0]))
        sensor = self.sensor(noise, np.empty((0, 1)))
        return drawn(streams, runs, self.motion(noise), sensor, prior, time, np.empty((0, time.size, 1)))
