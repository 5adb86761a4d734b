"""The weather on a circle of latitude: 40 places, every second of which is observed. Lorenz 1996, equation 1."""

from dataclasses import dataclass

import numpy as np

from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Space
from estlab.models.contract import Motion, Sensor
from estlab.scenarios.scenario import Scenario
from estlab.scenarios.simulation import drawn

SIZE, FORCING = 40, 8.0
STATE = Space(tuple(f"x{i}" for i in range(SIZE)), ("",) * SIZE)
READING = Space(STATE.names[::2], STATE.units[::2])


def tendency(x):
    return [(x[(i + 1) % SIZE] - x[i - 2]) * x[i - 1] - x[i] + FORCING for i in range(SIZE)]


def moved(x, slope, dt):
    return [a + dt * b for a, b in zip(x, slope, strict=True)]


def forecast(state, control, noise, dt):
    """One step of Runge and Kutta, then the noise."""
    first = tendency(state)
    second = tendency(moved(state, first, 0.5 * dt))
    third = tendency(moved(state, second, 0.5 * dt))
    fourth = tendency(moved(state, third, dt))
    return tuple(
        x + dt / 6.0 * (a + 2.0 * b + 2.0 * c + d) + w
        for x, a, b, c, d, w in zip(state, first, second, third, fourth, noise, strict=True)
    )


def observe(state, landmark):
    return tuple(state[i] for i in range(0, SIZE, 2))


@dataclass(frozen=True)
class Lorenz96(Scenario):
    """Chaos in forty components, with a little noise."""

    noise_sd: float
    reading_sd: float
    steps: int

    @property
    def space(self):
        return STATE

    def motion(self, noise):
        cov = (noise.process_scale * self.noise_sd) ** 2 * np.eye(SIZE)
        return Motion(STATE, forecast, lambda control, dt: cov, SIZE)

    def sensor(self, noise, landmarks):
        cov = (noise.measurement_scale * self.reading_sd) ** 2 * np.eye(READING.size)
        return Sensor(READING, STATE, observe, cov, landmarks)

    def simulate(self, streams, runs, noise):
        time = 0.05 * np.arange(1, self.steps + 1)
        mean = FORCING + np.sin(np.arange(SIZE))
        prior = Gaussian(mean, np.eye(SIZE))
        sensor = self.sensor(noise, np.empty((0, 1)))
        return drawn(streams, runs, self.motion(noise), sensor, prior, time, np.empty((0, time.size, 1)))
