"""A pendulum seen from the side, which states no slopes: the smallest problem with an angle for the compiled loop."""

import numpy as np

from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Space
from estlab.models.contract import Motion, Sensor
from estlab.record import Readings, Record

STATE = Space(("angle", "rate"), ("rad", "rad/s"), angles=(0,))
READING = Space(("sideways",), ("m",))


def swing(state, control, noise, dt):
    angle, rate = state
    (push,) = noise
    faster = rate + dt * (push - pull(angle))
    return angle + dt * faster, faster


def pull(angle):
    return 9.81 * np.sin(angle)


def sideways(state, landmark):
    angle, rate = state
    return (np.where(np.abs(angle) < 2.0, np.sin(angle), np.sin(angle) + 0.01 * rate),)


def branching(state, control, noise, dt):
    """What NumPy can do for one run, and a tracer cannot."""
    angle, rate = state
    return angle + dt * rate, rate + (dt * noise[0] if np.all(angle > 0.0) else 0.0 * dt)


MOTION = Motion(STATE, swing, lambda control, dt: np.array([[0.04 / dt]]), 1)
SENSOR = Sensor(READING, STATE, sideways, np.array([[0.01]]), np.empty((0, 1)))


def record(runs=2, steps=80, dt=0.05):
    """What swings over the top and is seen at every other step."""
    time = dt * np.arange(1, steps + 1)
    truth = np.empty((2, steps, runs))
    state = np.stack([np.linspace(0.2, 0.4, runs), np.full(runs, 7.0)])
    for k in range(steps):
        state = STATE.plus(np.stack(swing(state, np.empty(0), np.zeros(1), dt)), np.zeros(1))
        truth[:, k] = state
    seen = np.arange(0, steps, 2)
    values = np.stack(sideways(truth[:, seen], None)) + 0.1 * np.sin(np.arange(seen.size))[:, None]
    prior = Gaussian(truth[:, 0] + 0.1, np.diag([0.1, 0.2]))
    readings = Readings(seen, values, np.zeros((seen.size, runs), dtype=int))
    return Record(0.0, time, truth, np.empty((0, steps, 1)), readings, prior)
