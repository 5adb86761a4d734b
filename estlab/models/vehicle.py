"""A car as a rectangle that drives, seen by a LIDAR at the origin.

State: x, y [m] of the middle of the rear edge, speed [m/s], heading [rad], length [m], width [m].
Seed document 000, problem III.
"""

import numpy as np

from estlab.maths.space import Array, Space
from estlab.models.contract import Components, Rows

SPACE = Space(
    ("x", "y", "speed", "heading", "length", "width"), ("m", "m", "m/s", "rad", "m", "m"), angles=(3,), position=(0, 1)
)
READING = Space(("bearing_min", "bearing_max", "range_min"), ("rad", "rad", "m"), angles=(0, 1))


def drive(state: Array, control: Array, noise: Array, dt: float) -> Components:
    """Constant speed and heading but for rates held over dt: x' = s cos(heading) + vx, s' = vs, heading' = vh, ...

    noise: the six rates, of x, y [m/s], speed [m/s^2], heading [rad/s], length, width [m/s]. control: none.
    Speed and heading are linear in time, so the integral over dt by Simpson's rule is what a
    fourth-order Runge-Kutta step gives.
    """
    x, y, speed, heading, length, width = state
    rate_x, rate_y, acceleration, turn_rate, rate_length, rate_width = noise
    half = 0.5 * dt
    middle_speed, end_speed = speed + half * acceleration, speed + dt * acceleration
    middle, end = heading + half * turn_rate, heading + dt * turn_rate
    sixth = dt / 6.0
    return (
        x
        + dt * rate_x
        + sixth * (speed * np.cos(heading) + 4.0 * middle_speed * np.cos(middle) + end_speed * np.cos(end)),
        y
        + dt * rate_y
        + sixth * (speed * np.sin(heading) + 4.0 * middle_speed * np.sin(middle) + end_speed * np.sin(end)),
        end_speed,
        end,
        length + dt * rate_length,
        width + dt * rate_width,
    )


def drive_jacobians(state: Array, control: Array, dt: float) -> tuple[Rows, Rows]:
    """Derivatives of :func:`drive` in the state and in the rates, at no noise."""
    _, _, speed, heading, _, _ = state
    cos, sin = np.cos(heading), np.sin(heading)
    half = 0.5 * dt * dt
    in_state = (
        (1.0, 0.0, dt * cos, -dt * speed * sin, 0.0, 0.0),
        (0.0, 1.0, dt * sin, dt * speed * cos, 0.0, 0.0),
        (0.0, 0.0, 1.0, 0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, 1.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, 0.0, 1.0, 0.0),
        (0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
    )
    in_noise = (
        (dt, 0.0, half * cos, -half * speed * sin, 0.0, 0.0),
        (0.0, dt, half * sin, half * speed * cos, 0.0, 0.0),
        (0.0, 0.0, dt, 0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, dt, 0.0, 0.0),
        (0.0, 0.0, 0.0, 0.0, dt, 0.0),
        (0.0, 0.0, 0.0, 0.0, 0.0, dt),
    )
    return in_state, in_noise


def extent(state: Array, place: Array) -> Components:
    """From the origin: smallest and largest bearing [rad] of the corners, smallest range [m] to the edges.

    Bearings are taken about the rectangle's middle, so a car that stands across the cut at pi is still narrow.
    A sigma point may have a negative length or width: it is the rectangle that the corners say it is.
    """
    x, y, _, heading, length, width = state
    cos, sin = np.cos(heading), np.sin(heading)
    along_x, along_y = length * cos, length * sin
    side_x, side_y = -0.5 * width * sin, 0.5 * width * cos
    middle_x, middle_y = x + 0.5 * along_x, y + 0.5 * along_y
    middle = np.arctan2(middle_y, middle_x)
    # The angle from the middle to a corner, from the cross and dot product of the two: no wrapping needed.
    a = _angle(middle_x, middle_y, x + side_x, y + side_y)
    b = _angle(middle_x, middle_y, x - side_x, y - side_y)
    c = _angle(middle_x, middle_y, x + along_x + side_x, y + along_y + side_y)
    d = _angle(middle_x, middle_y, x + along_x - side_x, y + along_y - side_y)
    least = np.minimum(np.minimum(a, b), np.minimum(c, d))
    most = np.maximum(np.maximum(a, b), np.maximum(c, d))
    return middle + least, middle + most, _range(-(x * cos + y * sin), x * sin - y * cos, length, width)


def corners(state: Array) -> Array:
    """The rectangle's corners in order, (2, 4, *batch) [m]."""
    x, y, _, heading, length, width = state
    cos, sin = np.cos(heading), np.sin(heading)
    along = np.stack([np.zeros_like(length), length, length, np.zeros_like(length)])
    across = 0.5 * np.stack([-width, -width, width, width])
    return np.stack([x + along * cos - across * sin, y + along * sin + across * cos])


def _angle(from_x: Array, from_y: Array, to_x: Array, to_y: Array) -> Array:
    return np.arctan2(from_x * to_y - from_y * to_x, from_x * to_x + from_y * to_y)


def _range(along: Array, across: Array, length: Array, width: Array) -> Array:
    """Distance to the edges from a point in the car's frame (rear edge at 0, left positive), inside or outside."""
    beyond = np.abs(along - 0.5 * length) - 0.5 * np.abs(length)
    aside = np.abs(across) - 0.5 * np.abs(width)
    outside = np.hypot(np.maximum(beyond, 0.0), np.maximum(aside, 0.0))
    return np.where((beyond < 0.0) & (aside < 0.0), -np.maximum(beyond, aside), outside)
