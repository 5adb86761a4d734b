"""The fixed reference: filters as plain NumPy loops, as a textbook prints them.

One run at a time, one call of the model for each sigma point, sums over the points as sums of outer products. Vectors
are (n,) and matrices (n, n); nothing is shared with estlab but the numbers. What comes out is the same, which
tests/oracles/test_plain_loops.py holds it to. It is not made faster when estlab is: ratios would mean something else.
"""

from collections.abc import Callable

import numpy as np

Vector = np.ndarray
Model = Callable[[np.ndarray], np.ndarray]
Transform = Callable[[Model, np.ndarray, np.ndarray, tuple[int, ...]], tuple[np.ndarray, np.ndarray, np.ndarray]]


def wrapped(angle: float) -> float:
    """The same angle in [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


# --- the car


def car_motion(x: Vector, rates: Vector, dt: float) -> Vector:
    """Speed and heading linear over dt, the place by Simpson's rule (a Runge-Kutta step)."""
    middle, end = x + 0.5 * dt * rates, x + dt * rates

    def velocity(at: Vector) -> Vector:
        return at[2] * np.array([np.cos(at[3]), np.sin(at[3])])

    end[:2] += dt / 6.0 * (velocity(x) + 4.0 * velocity(middle) + velocity(end))
    return end


def car_noise_cov(x: Vector, rates: np.ndarray, dt: float) -> np.ndarray:
    """Of the state after rates of this covariance held over dt, linearised; the heading's turns x and y too."""
    jacobian = dt * np.eye(6)
    half = 0.5 * dt * dt
    cos, sin = np.cos(x[3]), np.sin(x[3])
    jacobian[:2, 2] = half * cos, half * sin
    jacobian[:2, 3] = -half * x[2] * sin, half * x[2] * cos
    return jacobian @ rates @ jacobian.T


def car_reading(x: Vector) -> Vector:
    """Smallest and largest bearing of the corners, smallest range to the edges."""
    cos, sin = np.cos(x[3]), np.sin(x[3])
    ahead, left = np.array([cos, sin]), np.array([-sin, cos])
    rear, front = x[:2], x[:2] + x[4] * ahead
    side = 0.5 * x[5] * left
    corners = np.array([rear + side, rear - side, front + side, front - side])
    centre = 0.5 * (rear + front)
    middle = np.arctan2(centre[1], centre[0])
    bearings = wrapped(np.arctan2(corners[:, 1], corners[:, 0]) - middle)
    along, across = -x[:2] @ ahead, -x[:2] @ left
    beyond = abs(along - 0.5 * x[4]) - 0.5 * abs(x[4])
    aside = abs(across) - 0.5 * abs(x[5])
    inside = beyond < 0.0 and aside < 0.0
    distance = -max(beyond, aside) if inside else np.hypot(max(beyond, 0.0), max(aside, 0.0))
    return np.array([middle + bearings.min(), middle + bearings.max(), distance])


# --- the robot among landmarks


def robot_motion(x: Vector, control: Vector, dt: float) -> Vector:
    """On an arc at v and w; Thrun et al. 2005, eq. 5.9."""
    v, w = control
    if abs(w * dt) < 1e-9:
        return np.array([x[0] + v * dt * np.cos(x[2]), x[1] + v * dt * np.sin(x[2]), x[2]])
    after, r = x[2] + w * dt, v / w
    return np.array([x[0] + r * (np.sin(after) - np.sin(x[2])), x[1] + r * (np.cos(x[2]) - np.cos(after)), after])


def robot_jacobians(x: Vector, control: Vector, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of :func:`robot_motion` in the pose and in (v, w)."""
    v, w = control
    sin, cos = np.sin(x[2]), np.cos(x[2])
    if abs(w * dt) < 1e-9:
        in_pose = np.array([[1.0, 0.0, -v * dt * sin], [0.0, 1.0, v * dt * cos], [0.0, 0.0, 1.0]])
        half = 0.5 * v * dt * dt
        return in_pose, np.array([[dt * cos, -half * sin], [dt * sin, half * cos], [0.0, dt]])
    after = x[2] + w * dt
    sin_after, cos_after = np.sin(after), np.cos(after)
    in_pose = np.array([[1.0, 0.0, v / w * (cos_after - cos)], [0.0, 1.0, v / w * (sin_after - sin)], [0.0, 0.0, 1.0]])
    in_control = np.array(
        [
            [(sin_after - sin) / w, v * (cos_after * dt / w - (sin_after - sin) / w**2)],
            [(cos - cos_after) / w, v * (sin_after * dt / w - (cos - cos_after) / w**2)],
            [0.0, dt],
        ]
    )
    return in_pose, in_control


def landmark_reading(x: Vector, landmark: Vector) -> Vector:
    """Range and bearing."""
    dx, dy = landmark - x[:2]
    return np.array([np.hypot(dx, dy), np.arctan2(dy, dx) - x[2]])


def landmark_jacobian(x: Vector, landmark: Vector) -> np.ndarray:
    """The derivative of :func:`landmark_reading` in the pose."""
    dx, dy = landmark - x[:2]
    q = dx * dx + dy * dy
    r = np.sqrt(q)
    return np.array([[-dx / r, -dy / r, 0.0], [dy / q, -dx / q, -1.0]])


# --- the filters


def unscented(
    model: Model, mean: Vector, cov: np.ndarray, angles: tuple[int, ...]
) -> tuple[Vector, np.ndarray, np.ndarray]:
    """Mean, covariance and cross-covariance by the scaled transform, alpha = 1, beta = 2, kappa = 0.

    angles: of the values, those that wrap.
    """
    n = mean.size
    root = np.sqrt(n) * np.linalg.cholesky(cov)
    points = [mean] + [mean + root[:, i] for i in range(n)] + [mean - root[:, i] for i in range(n)]
    weights = [0.0] + [0.5 / n] * (2 * n)
    weights_cov = [2.0] + [0.5 / n] * (2 * n)
    values = [model(point) for point in points]
    rises = [value - values[0] for value in values]
    for rise in rises:
        for i in angles:
            rise[i] = wrapped(rise[i])
    shift = sum(weight * rise for weight, rise in zip(weights, rises, strict=True))
    value_cov, cross = np.zeros((shift.size, shift.size)), np.zeros((n, shift.size))
    for weight, point, rise in zip(weights_cov, points, rises, strict=True):
        value_cov += weight * np.outer(rise - shift, rise - shift)
        cross += weight * np.outer(point - mean, rise - shift)
    return values[0] + shift, value_cov, cross


def unscented_by_matrices(
    model: Model, mean: Vector, cov: np.ndarray, angles: tuple[int, ...]
) -> tuple[Vector, np.ndarray, np.ndarray]:
    """The same with its sums as products of matrices, which is about as fast as a loop over single runs gets."""
    n = mean.size
    root = np.sqrt(n) * np.linalg.cholesky(cov).T
    offsets = np.concatenate([root, -root])
    centre = model(mean)
    rises = np.array([model(mean + offset) for offset in offsets]) - centre
    for i in angles:
        rises[:, i] = wrapped(rises[:, i])
    weight = 0.5 / n
    shift = weight * rises.sum(axis=0)
    # The centre, of no weight in the mean and 2 in the covariance, lies -shift from it.
    value_cov = weight * rises.T @ rises + np.outer(shift, shift)
    return centre + shift, value_cov, weight * offsets.T @ rises


def updated(
    mean: Vector, cov: np.ndarray, innovation: Vector, innovation_cov: np.ndarray, cross: np.ndarray, heading: int
) -> tuple[Vector, np.ndarray, float]:
    """The Kalman update: mean, covariance and NIS."""
    inverse = np.linalg.inv(innovation_cov)
    kalman_gain = cross @ inverse
    mean = mean + kalman_gain @ innovation
    mean[heading] = wrapped(mean[heading])
    cov = cov - kalman_gain @ innovation_cov @ kalman_gain.T
    return mean, 0.5 * (cov + cov.T), float(innovation @ inverse @ innovation)


def car_ukf(
    mean: Vector,
    cov: np.ndarray,
    readings: np.ndarray,
    rates: np.ndarray,
    reading_cov: np.ndarray,
    dt: float,
    transform: Transform = unscented,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One run, additive noise: means (T, 6), covariances (T, 6, 6) and NIS (T,) for readings (T, 3)."""
    steps = len(readings)
    means, covs, nis = np.empty((steps, 6)), np.empty((steps, 6, 6)), np.empty(steps)
    still = np.zeros(6)
    for k in range(steps):
        added = car_noise_cov(mean, rates, dt)
        mean, cov, _ = transform(lambda x: car_motion(x, still, dt), mean, cov, ())
        mean[3], cov = wrapped(mean[3]), cov + added
        expected, spread, cross = transform(car_reading, mean, cov, (0, 1))
        innovation = readings[k] - expected
        innovation[:2] = wrapped(innovation[:2])
        mean, cov, nis[k] = updated(mean, cov, innovation, spread + reading_cov, cross, 3)
        means[k], covs[k] = mean, cov
    return means, covs, nis


def landmark_filter(
    linearised: bool,
    mean: Vector,
    cov: np.ndarray,
    controls: np.ndarray,
    readings: list[list[tuple[Vector, Vector]]],
    control_cov: np.ndarray,
    reading_cov: np.ndarray,
    dt: float,
) -> tuple[np.ndarray, np.ndarray]:
    """One run of the EKF, or of the UKF with additive noise: means (T, 3) and covariances (T, 3, 3).

    controls: (T, 2). readings: for each step, (reading, landmark) one after another.
    """
    steps = len(controls)
    means, covs = np.empty((steps, 3)), np.empty((steps, 3, 3))
    for k in range(steps):
        control = controls[k]
        in_pose, in_control = robot_jacobians(mean, control, dt)
        added = in_control @ control_cov @ in_control.T
        if linearised:
            mean, cov = robot_motion(mean, control, dt), in_pose @ cov @ in_pose.T + added
        else:
            mean, cov, _ = unscented(lambda x: robot_motion(x, control, dt), mean, cov, ())  # noqa: B023 - called here
            cov = cov + added
        mean[2] = wrapped(mean[2])
        for reading, landmark in readings[k]:
            if linearised:
                jacobian = landmark_jacobian(mean, landmark)
                expected, cross = landmark_reading(mean, landmark), cov @ jacobian.T
                spread = jacobian @ cross
            else:
                expected, spread, cross = unscented(lambda x: landmark_reading(x, landmark), mean, cov, (1,))  # noqa: B023
            innovation = reading - expected
            innovation[1] = wrapped(innovation[1])
            mean, cov, _ = updated(mean, cov, innovation, spread + reading_cov, cross, 2)
        means[k], covs[k] = mean, cov
    return means, covs
