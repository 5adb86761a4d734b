"""A car as a rectangle that drives, seen by a LIDAR at the origin.

State: x, y [m] of the middle of the rear edge, speed [m/s], heading [rad], length [m], width [m].
Seed document 000, problem III.
"""

import numpy as np

from estlab.maths.space import Array, Space, cos_sin
from estlab.maths.stacking import Components, Rows

SPACE = Space(
    ("x", "y", "speed", "heading", "length", "width"), ("m", "m", "m/s", "rad", "m", "m"), angles=(3,), position=(0, 1)
)
READING = Space(("bearing_min", "bearing_max", "range_min"), ("rad", "rad", "m"), angles=(0, 1))


def drive(state: Array, control: Array, noise: Array, dt: float) -> Components:
    """Constant speed and heading except for rates held over dt: x' = s cos(heading) + vx, s' = vs, heading' = vh, ...

    noise: the six rates, of x, y [m/s], speed [m/s^2], heading [rad/s], length, width [m/s]. control: none.
    Speed and heading are linear in time, so the integral over dt by Simpson's rule equals a fourth-order Runge-Kutta
    step. Sines and cosines are expensive, so the integral is taken along and across the initial heading, from which
    the car turns by half the turn and then by all of it.
    """
    x, y, speed, heading, length, width = state
    rate_x, rate_y, acceleration, turn_rate, rate_length, rate_width = noise
    cos, sin = cos_sin(heading)
    turn, gain, sixth = dt * turn_rate, dt * acceleration, dt / 6.0
    cos_half, sin_half = cos_sin(0.5 * turn)
    cos_turn, sin_turn = cos_half * cos_half - sin_half * sin_half, 2.0 * sin_half * cos_half
    along = speed * (sixth * (1.0 + 4.0 * cos_half + cos_turn)) + gain * (sixth * (2.0 * cos_half + cos_turn))
    across = speed * (sixth * (4.0 * sin_half + sin_turn)) + gain * (sixth * (2.0 * sin_half + sin_turn))
    return (
        x + along * cos - across * sin + dt * rate_x,
        y + along * sin + across * cos + dt * rate_y,
        speed + gain,
        heading + turn,
        length + dt * rate_length,
        width + dt * rate_width,
    )


def drive_jacobians(state: Array, control: Array, dt: float) -> tuple[Rows, Rows]:
    """Derivatives of :func:`drive` in the state and in the rates, at no noise."""
    _, _, speed, heading, _, _ = state
    cos, sin = cos_sin(heading)
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


def extent(state: Array, landmark: Array) -> Components:
    """From the origin: smallest and largest bearing [rad] of the corners, smallest range [m] to the edges.

    Bearings are taken about the rectangle's middle, so a car across the cut at pi is still narrow. A sigma point may
    have a negative length or width: its corners still define the rectangle.
    """
    x, y, _, heading, length, width = state
    cos, sin = cos_sin(heading)
    ahead, aside = 0.5 * length, 0.5 * width
    middle_x, middle_y = x + ahead * cos, y + ahead * sin
    # The middle as seen from the origin, in the car's own frame: along its heading, and to the right of it.
    along, across = middle_x * cos + middle_y * sin, middle_x * sin - middle_y * cos
    # The angle from the middle m to a corner m + e has cross product m x e and dot product m (m + e): no wrapping
    # needed. Corners lie opposite each other, front left to rear right and front right to rear left.
    square = along * along + across * across
    cross_left, dot_left = ahead * across + aside * along, ahead * along - aside * across
    cross_right, dot_right = ahead * across - aside * along, ahead * along + aside * across
    front_left, rear_right = np.arctan2(cross_left, square + dot_left), np.arctan2(cross_left, square - dot_left)
    front_right, rear_left = np.arctan2(cross_right, square + dot_right), np.arctan2(cross_right, square - dot_right)
    least = np.minimum(np.minimum(front_left, front_right), -np.maximum(rear_left, rear_right))
    most = np.maximum(np.maximum(front_left, front_right), -np.minimum(rear_left, rear_right))
    middle = np.arctan2(middle_y, middle_x)
    beyond, beside = np.abs(along) - np.abs(ahead), np.abs(across) - np.abs(aside)
    return middle + least, middle + most, _distance(beyond, beside)


def corners(state: Array) -> Array:
    """The rectangle's corners in order, (2, 4, *batch) [m]."""
    x, y, _, heading, length, width = state
    cos, sin = np.cos(heading), np.sin(heading)
    along = np.stack([np.zeros_like(length), length, length, np.zeros_like(length)])
    across = 0.5 * np.stack([-width, -width, width, width])
    return np.stack([x + along * cos - across * sin, y + along * sin + across * cos])


def _distance(beyond: Array, beside: Array) -> Array:
    """Distance of the edges from a point so far beyond them along and across the heading; inside where both < 0."""
    out_beyond, out_beside = np.maximum(beyond, 0.0), np.maximum(beside, 0.0)
    outside = np.sqrt(out_beyond * out_beyond + out_beside * out_beside)
    return outside - np.minimum(np.maximum(beyond, beside), 0.0)
