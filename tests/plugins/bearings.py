"""A ship seen from two stations, one of which takes a bearing at every step and the other at every third."""

from dataclasses import dataclass

import numpy as np

from estlab.maths.gaussian_belief import Gaussian, draw
from estlab.maths.space import Space
from estlab.models.contract import Motion, Sensor
from estlab.record import Readings, Record
from estlab.scenarios.scenario import Scenario
from estlab.scenarios.simulation import walk

STATE = Space(("east", "north", "v_east", "v_north"), ("m", "m", "m/s", "m/s"), position=(0, 1))
READING = Space(("bearing",), ("rad",), angles=(0,))
STATIONS = np.array([[0.0, 400.0], [0.0, 0.0]])


def sail(state, control, noise, dt):
    east, north, v_east, v_north = state
    a_east, a_north = noise
    half = 0.5 * dt * dt
    return (
        east + dt * v_east + half * a_east,
        north + dt * v_north + half * a_north,
        v_east + dt * a_east,
        v_north + dt * a_north,
    )


def sail_jacobians(state, control, dt):
    half = 0.5 * dt * dt
    in_state = (1.0, 0.0, dt, 0.0), (0.0, 1.0, 0.0, dt), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    return in_state, ((half, 0.0), (0.0, half), (dt, 0.0), (0.0, dt))


def bearing(state, station):
    east, north, _, _ = state
    at_east, at_north = station
    return (np.arctan2(north - at_north, east - at_east),)


@dataclass(frozen=True)
class Ship(Scenario):
    """Readings of both stations in the order of time; at a third of the steps there are two."""

    acceleration_sd: float
    bearing_sd: float
    steps: int

    @property
    def space(self):
        return STATE

    def motion(self, noise):
        cov = (noise.process_scale * self.acceleration_sd) ** 2 * np.eye(2)
        return Motion(STATE, sail, lambda control, dt: cov, 2, sail_jacobians)

    def sensor(self, noise, landmarks):
        return Sensor(
            READING, STATE, bearing, np.array([[(noise.measurement_scale * self.bearing_sd) ** 2]]), landmarks
        )

    def simulate(self, streams, runs, noise):
        motion, sensor = self.motion(noise), self.sensor(noise, STATIONS)
        time = np.arange(1.0, self.steps + 1.0)
        control = np.empty((0, time.size, 1))
        mean = np.repeat([[100.0], [300.0], [5.0], [-2.0]], len(runs), axis=1)
        prior = Gaussian(mean, np.diag([50.0, 50.0, 2.0, 2.0]) ** 2)
        begin = draw(STATE, prior, streams.normals("prior", runs, (4,)))
        truth = walk(streams, runs, motion, begin, time, control)
        taken = [(k, station) for k in range(self.steps) for station in (0, 1) if station == 0 or k % 3 == 2]
        step, station = np.array(taken).T
        landmark_number = np.repeat(station[:, None], len(runs), axis=1)
        blur = self.bearing_sd * noise.measurement_scale * streams.normals("readings", runs, (1, step.size))
        values = READING.plus(sensor.read(truth[:, step], sensor.landmark(landmark_number)), blur)
        readings = Readings(step, values, landmark_number)
        return Record(0.0, time, truth, control, readings, prior, landmarks=STATIONS, origin=begin)
