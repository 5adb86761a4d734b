"""filterpy's unscented filter, an implementation by other hands, on one car run."""

import warnings

import numpy as np

from estlab.filters.gaussian import unscented
from estlab.maths.streams import Streams
from estlab.models import vehicle
from tests.conftest import estimate, settings


def test_one_car_run_agrees_with_filterpy():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    experiment = settings("scenario=car")
    problem, noise = experiment.scenario, experiment.noise.filter
    record = problem.simulate(Streams(4, "car"), range(1), noise)
    motion, sensor = problem.motion(noise), problem.sensor(noise, record.landmarks)
    ours = estimate(unscented("merwe", 1.0, 2.0, 0.0, "additive", None), motion, sensor, record)

    def mean_of(space):
        def mean(points, weights):
            about = points[0]
            return space.plus(about, np.sum(weights[:, None] * [space.minus(p, about) for p in points], axis=0))

        return mean

    state, reading = vehicle.SPACE, vehicle.READING
    points = MerweScaledSigmaPoints(6, 1.0, 2.0, 0.0, subtract=state.minus)
    peer = UnscentedKalmanFilter(
        6, 3, 0.1,
        hx=lambda x: np.array(vehicle.extent(x, np.empty(0))),
        fx=lambda x, dt: np.array(vehicle.drive(x, np.empty(0), np.zeros(6), dt)),
        points=points, x_mean_fn=mean_of(state), z_mean_fn=mean_of(reading),
        residual_x=state.minus, residual_z=reading.minus,
    )  # fmt: skip
    peer.x, peer.P, peer.R = record.prior.mean[:, 0].copy(), record.prior.cov.copy(), sensor.noise_cov
    for k in range(record.time.size):
        jacobian = motion.noise_jacobian(peer.x, np.empty(0), 0.1)
        peer.Q = jacobian @ motion.noise_cov(np.empty(0), 0.1) @ jacobian.T
        peer.predict()
        peer.update(record.readings.values[:, k, 0])
        np.testing.assert_allclose(state.minus(ours.mean[:, k, 0], peer.x), 0.0, atol=1e-6)
        np.testing.assert_allclose(ours.cov[:, :, k, 0], peer.P, atol=1e-6)
