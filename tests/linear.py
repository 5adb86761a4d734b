"""A linear Gaussian problem, on which every member of the Gaussian family must be the Kalman filter."""

import numpy as np

from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Space
from estlab.maths.streams import Streams
from estlab.models.contract import Motion, Sensor
from estlab.record import Readings, Record

STATE = Space(("position", "velocity", "bias"), ("m", "m/s", "m"))
space = STATE  # as a scenario has it
READING = Space(("sum", "position"), ("m", "m"))
A = np.array([[1.0, 0.1, 0.0], [0.0, 0.98, 0.0], [0.0, 0.0, 0.95]])
G = np.array([[0.005, 0.0], [0.1, 0.0], [0.0, 0.3]])
H = np.array([[1.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
Q = np.diag([0.5, 0.2])
R = np.array([[0.3, 0.1], [0.1, 0.4]])
P0 = np.array([[1.0, 0.2, 0.0], [0.2, 0.5, 0.1], [0.0, 0.1, 0.3]])


def move(state, control, noise, dt):
    return tuple(
        sum(A[i, j] * state[j] for j in range(3)) + sum(G[i, j] * noise[j] for j in range(2)) for i in range(3)
    )


def measure(state, landmark):
    return tuple(sum(H[i, j] * state[j] for j in range(3)) for i in range(2))


MOTION = Motion(STATE, move, lambda control, dt: Q, 2)
SENSOR = Sensor(READING, STATE, measure, R, np.empty((0, 1)))


def record(runs, steps=40, seed=5):
    """An ensemble drawn from the model, prior error and all."""
    streams = Streams(seed, "linear")
    begin = np.zeros((3, len(runs)))
    prior = np.einsum("ij,jr->ir", np.linalg.cholesky(P0), streams.normals("prior", runs, (3,)))
    process = np.einsum("ij,tjr->tir", G @ np.linalg.cholesky(Q), streams.normals("truth", runs, (steps, 2)))
    blur = np.einsum("ij,tjr->tir", np.linalg.cholesky(R), streams.normals("readings", runs, (steps, 2)))
    truth, values = np.empty((3, steps, len(runs))), np.empty((2, steps, len(runs)))
    state = begin
    for k in range(steps):
        state = A @ state + process[k]
        truth[:, k], values[:, k] = state, H @ state + blur[k]
    time = 0.1 * np.arange(1, steps + 1)
    landmark_number = np.zeros((steps, len(runs)), dtype=int)
    return Record(
        0.0,
        time,
        truth,
        np.empty((0, steps, 1)),
        Readings(np.arange(steps), values, landmark_number),
        Gaussian(prior, P0),
        origin=begin,
    )
