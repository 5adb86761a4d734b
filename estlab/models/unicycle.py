"""A wheeled robot commanded by forward and angular velocity. State: x [m], y [m], heading [rad]."""

import numpy as np

from estlab.maths.linalg import diagonal
from estlab.maths.space import Array, Space
from estlab.models.contract import Components, Rows

SPACE = Space(("x", "y", "heading"), ("m", "m", "rad"), angles=(2,), position=(0, 1))

# Below this turn [rad] in one step the chord is computed by its series: the exact quotient loses digits.
_SMALL_TURN = 1e-4


def arc(pose: Array, control: Array, noise: Array, dt: float) -> Components:
    """Motion on a circular arc, exact for v, w held over dt. Thrun, Burgard and Fox 2005, equation 5.9.

    pose: x, y [m], heading [rad]. control: v [m/s], w [rad/s]. noise: added to v and w.
    """
    x, y, heading = pose
    v, w = control
    noise_v, noise_w = noise
    turn = (w + noise_w) * dt
    chord = (v + noise_v) * dt * _sinc(0.5 * turn)
    middle = heading + 0.5 * turn
    return x + chord * np.cos(middle), y + chord * np.sin(middle), heading + turn


def arc_jacobians(pose: Array, control: Array, dt: float) -> tuple[Rows, Rows]:
    """Derivatives of :func:`arc` in the pose and in the noise on (v, w), at no noise."""
    _, _, heading = pose
    v, w = control
    turn = w * dt
    middle = heading + 0.5 * turn
    shape = _sinc(0.5 * turn)
    cos, sin = np.cos(middle), np.sin(middle)
    chord = v * dt * shape
    # d(chord)/dw and d(middle)/dw
    bend = v * dt * _sinc_slope(0.5 * turn) * 0.5 * dt
    half = 0.5 * dt
    in_pose = ((1.0, 0.0, -chord * sin), (0.0, 1.0, chord * cos), (0.0, 0.0, 1.0))
    in_noise = (
        (dt * shape * cos, bend * cos - chord * sin * half),
        (dt * shape * sin, bend * sin + chord * cos * half),
        (0.0, dt),
    )
    return in_pose, in_noise


def white_noise_cov(sd_v: float, sd_w: float, dt: float) -> Array:
    """Covariance (2, 2) of white noise on (v, w), of sd_v [m/s] and sd_w [rad/s] per sqrt(s), held over dt [s]."""
    return diagonal(np.array([sd_v**2, sd_w**2])) / dt


def _sinc(a: Array) -> Array:
    """sin(a) / a, by its series where a is small."""
    small = np.abs(a) < _SMALL_TURN
    safe = np.where(small, 1.0, a)
    return np.where(small, 1.0 - a * a / 6.0, np.sin(safe) / safe)


def _sinc_slope(a: Array) -> Array:
    """The derivative of sin(a) / a."""
    small = np.abs(a) < _SMALL_TURN
    safe = np.where(small, 1.0, a)
    return np.where(small, -a / 3.0, (np.cos(safe) - np.sin(safe) / safe) / safe)
