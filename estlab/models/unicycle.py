"""A wheeled robot commanded by forward and angular velocity. State: x [m], y [m], heading [rad]."""

import numpy as np

from estlab.maths.space import Array, Space, cos_sin
from estlab.maths.stacking import Components, Rows

SPACE = Space(("x", "y", "heading"), ("m", "m", "rad"), angles=(2,), position=(0, 1))

# Below this angle [rad] the derivative of the chord uses its series: the exact difference loses digits.
_SMALL = 1e-2
_LEAST = 1e-300  # replaces an angle of zero in a quotient


def arc(pose: Array, control: Array, noise: Array, dt: float) -> Components:
    """Motion on a circular arc, exact for v, w held over dt. Thrun, Burgard and Fox 2005, equation 5.9.

    pose: x, y [m], heading [rad]. control: v [m/s], w [rad/s]. noise: added to v and w.
    """
    x, y, heading = pose
    v, w = control
    noise_v, noise_w = noise
    turn = (w + noise_w) * dt
    chord = (v + noise_v) * dt * _sinc(0.5 * turn)
    cos, sin = cos_sin(heading + 0.5 * turn)
    return x + chord * cos, y + chord * sin, heading + turn


def arc_jacobians(pose: Array, control: Array, dt: float) -> tuple[Rows, Rows]:
    """Derivatives of :func:`arc` in the pose and in the noise on (v, w), at no noise."""
    _, _, heading = pose
    v, w = control
    half_turn, way = 0.5 * (w * dt), v * dt
    cos, sin = cos_sin(heading + half_turn)
    shape = _sinc(half_turn)
    ahead, aside = way * shape * cos, way * shape * sin
    # The effect of w on the chord, and then on the heading at its middle.
    bend, half = way * (0.5 * dt) * _sinc_derivative(half_turn, shape), 0.5 * dt
    in_pose = ((1.0, 0.0, -aside), (0.0, 1.0, ahead), (0.0, 0.0, 1.0))
    in_noise = (
        (dt * shape * cos, bend * cos - half * aside),
        (dt * shape * sin, bend * sin + half * ahead),
        (0.0, dt),
    )
    return in_pose, in_noise


def _sinc(a: Array) -> Array:
    """sin(a) / a, 1 at zero."""
    safe = a + _LEAST
    return np.sin(safe) / safe


def _sinc_derivative(a: Array, shape: Array) -> Array:
    """The derivative of shape = sin(a) / a."""
    square, safe = a * a, a + _LEAST
    series = a * (square * (1.0 / 30.0 - square * (1.0 / 840.0)) - 1.0 / 3.0)
    return np.where(square < _SMALL * _SMALL, series, (np.cos(safe) - shape) / safe)
