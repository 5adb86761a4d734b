"""Truth and readings drawn from a problem's own models."""

from collections.abc import Sequence

import numpy as np

from estlab.compiled.normals import normals
from estlab.errors import UserError
from estlab.maths.gaussian_belief import Gaussian, draw
from estlab.maths.linalg import cholesky, matvec
from estlab.maths.space import Array, Space
from estlab.maths.stacking import Components
from estlab.maths.streams import Streams
from estlab.models.answers import covariance, kind, numbers, refuse
from estlab.models.checks import check_motion, check_sensor, try_motion, try_sensor
from estlab.models.contract import Motion, Sensor
from estlab.record import Readings, Record
from estlab.scenarios.scenario import Scales


def drawn(
    streams: Streams, runs: Sequence[int], motion: Motion, sensor: Sensor, prior: Gaussian, time: Array, control: Array
) -> Record:
    """A record whose runs start from draws of the prior, with one reading per step and no landmarks.

    prior: mean (n,) and cov (n, n) at time 0. time: (T,) > 0. control: (c, T, 1 or runs). Raises AnswerError for
    invalid models and arrays.
    """
    check_motion("motion", motion, motion.space)
    n = motion.space.size
    numbers("simulate", "prior.mean is", prior.mean, (n,))
    covariance("simulate", "prior.cov is", prior.cov, (n, n))
    mean = prior.mean[:, None].repeat(len(runs), axis=1)
    begin = draw(motion.space, Gaussian(mean, prior.cov), normals(streams, "prior", runs, prior.mean.shape))
    truth = walk(streams, runs, motion, begin, time, control)
    values = read(streams, runs, sensor, truth, np.empty((0, 1)))
    landmark_number = np.zeros(values.shape[1:], dtype=int)
    readings = Readings(np.arange(time.size), values, landmark_number)
    return Record(0.0, time, truth, control, readings, Gaussian(mean, prior.cov), origin=begin)


def walk(streams: Streams, runs: Sequence[int], motion: Motion, begin: Array, time: Array, control: Array) -> Array:
    """Truth (n, T, runs) from the motion model with its noise, from begin (n, runs) at time 0.

    Raises AnswerError for an invalid motion, and for arrays that do not match it.
    """
    check_motion("motion", motion, motion.space)
    n, count = motion.space.size, len(runs)
    numbers("simulate", "the state begun from is", begin, (n, count))
    if not isinstance(time, np.ndarray) or time.ndim != 1 or time.size == 0:
        refuse("simulate", f"time is {kind(time)}; must be an array (T,) of one step or more")
    if not isinstance(control, np.ndarray) or control.ndim != 3:
        refuse("simulate", f"control is {kind(control)}; must be an array (c, {time.size}, {count} or 1)")
    numbers("simulate", "control is", control, *((len(control), time.size, some) for some in (count, 1)))
    lapse = np.diff(time, prepend=0.0)
    if not (lapse >= 0.0).all():
        k = int(np.argmin(lapse >= 0.0))
        refuse("simulate", f"time[{k}] is {time[k]:g}, after {time[k - 1] if k else 0.0:g}; time must ascend from 0")
    try_motion("motion", motion, Gaussian(begin, np.zeros((n, n))), control, lapse)
    blur = normals(streams, "truth", runs, (time.size, motion.noise_size))
    truth = np.empty((motion.space.size, time.size, len(runs)))
    state = begin
    for k in range(time.size):
        if lapse[k] > 0.0:
            noise = matvec(cholesky(motion.noise_cov(control[:, k], lapse[k])), blur[k])
            state = motion.space.plus(motion.step(state, control[:, k], noise, lapse[k]), np.zeros(1))
        truth[:, k] = state
    return truth


def read(streams: Streams, runs: Sequence[int], sensor: Sensor, states: Array, landmark: Array) -> Array:
    """Readings (m, N, runs) of states (n, N, runs) with the sensor's noise.

    Raises AnswerError for an invalid sensor.
    """
    check_sensor("sensor", sensor, sensor.state)
    if states.shape[1]:
        n = sensor.state.size
        first = landmark.reshape(len(landmark), -1)[:, :1] if landmark.size else np.empty((len(landmark), 1))
        about = np.repeat(first, len(runs), axis=1)
        try_sensor("sensor", sensor, Gaussian(states[:, 0], np.zeros((n, n))), about)
    blur = normals(streams, "readings", runs, (sensor.space.size, states.shape[1]))
    noise = np.einsum("ij,jnr->inr", cholesky(sensor.noise_cov), blur)
    return sensor.space.plus(sensor.read(states, landmark), noise)


def one_prediction(streams: Streams, runs: Sequence[int], motion: Motion, prior: Gaussian) -> Record:
    """A record of one step without readings: each run's truth is drawn from the common prior and moved once.

    prior: mean (n, 1) and cov (n, n).
    """
    z = normals(streams, "truth", runs, prior.mean.shape[:1])
    start = prior.mean + matvec(cholesky(prior.cov), z)
    control, count = np.empty((0, 1, 1)), len(runs)
    truth = motion.step(start, control[:, 0], np.zeros(motion.noise_size), 1.0)[:, None]
    nothing = Readings(np.empty(0, dtype=int), np.empty((0, 0, count)), np.empty((0, count), dtype=int))
    return Record(0.0, np.ones(1), truth, control, nothing, prior)


def no_sensor(state: Space) -> Sensor:
    """The sensor of a problem without readings: it measures nothing."""
    return Sensor(Space((), ()), state, _nothing, np.empty((0, 0)), np.empty((0, 1)))


def no_cov(control: Array, dt: float) -> Array:
    """The covariance (0, 0) of no process noise."""
    return np.empty((0, 0))


def refuse_scales(noise: Scales, instead: str) -> None:
    """Raise UserError unless the scales are 1: a problem without process noise and readings has nothing to scale."""
    if (noise.process_scale, noise.measurement_scale) != (1.0, 1.0):
        raise UserError(f"this scenario has neither process nor measurement noise, leave noise as it is; {instead}")


def _nothing(state: Array, landmark: Array) -> Components:
    return ()
