"""A shell in three dimensions, followed by a radar: range, azimuth and elevation, seen from the origin."""

from dataclasses import dataclass

import numpy as np

from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Space
from estlab.models.contract import Motion, Sensor
from estlab.scenarios.scenario import Scenario
from estlab.scenarios.simulation import drawn

STATE = Space(("x", "y", "z", "vx", "vy", "vz"), ("m",) * 3 + ("m/s",) * 3, position=(0, 1, 2))
READING = Space(("range", "azimuth", "elevation"), ("m", "rad", "rad"), angles=(1, 2))
DRAG = 5e-4  # [1/m]


def fly(state, control, noise, dt):
    x, y, z, vx, vy, vz = state
    speed = np.sqrt(vx * vx + vy * vy + vz * vz)
    ax, ay, az = -DRAG * speed * vx, -DRAG * speed * vy, -DRAG * speed * vz - 9.81
    half = 0.5 * dt * dt
    return (
        x + dt * vx + half * ax + noise[0],
        y + dt * vy + half * ay + noise[1],
        z + dt * vz + half * az + noise[2],
        vx + dt * ax + noise[3],
        vy + dt * ay + noise[4],
        vz + dt * az + noise[5],
    )


def radar(state, landmark):
    x, y, z, _, _, _ = state
    ground = np.sqrt(x * x + y * y)
    return np.sqrt(ground * ground + z * z), np.arctan2(y, x), np.arctan2(z, ground)


@dataclass(frozen=True)
class Ballistic(Scenario):
    """White acceleration in each axis: a process noise of rank three in six components."""

    acceleration_sd: float
    range_sd: float
    angle_sd: float
    steps: int

    @property
    def space(self):
        return STATE

    def motion(self, noise):
        sd = noise.process_scale * self.acceleration_sd

        def noise_cov(control, dt):
            gain = sd * np.concatenate([0.5 * dt * dt * np.eye(3), dt * np.eye(3)])
            return gain @ gain.T

        return Motion(STATE, fly, noise_cov, 6)

    def sensor(self, noise, landmarks):
        sds = noise.measurement_scale * np.array([self.range_sd, self.angle_sd, self.angle_sd])
        return Sensor(READING, STATE, radar, np.diag(sds**2), landmarks)

    def simulate(self, streams, runs, noise):
        time = 0.5 * np.arange(1, self.steps + 1)
        mean = np.array([-2000.0, 500.0, 300.0, 200.0, 30.0, 150.0])
        prior = Gaussian(mean, np.diag([100.0, 100.0, 100.0, 10.0, 10.0, 10.0]) ** 2)
        sensor = self.sensor(noise, np.empty((0, 1)))
        return drawn(streams, runs, self.motion(noise), sensor, prior, time, np.empty((0, time.size, 1)))
