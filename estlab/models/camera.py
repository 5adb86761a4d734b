"""A robot seen by a camera from above. State: x [cm], y [cm], speed [cm/s], heading [rad]. Seed document 004."""

import numpy as np

from estlab.maths.space import Array, Space, cos_sin
from estlab.maths.stacking import Components, Rows

SPACE = Space(("x", "y", "speed", "heading"), ("cm", "cm", "cm/s", "rad"), angles=(3,), position=(0, 1))
FIX = Space(("x", "y"), ("cm", "cm"))


def coast(state: Array, control: Array, noise: Array, dt: float) -> Components:
    """Straight motion for dt [s]; then speed and heading take a step of their random walks. Document 004, equation 2.

    noise: the walks' rates [cm/s and rad, per sqrt(s)]. With covariance diag(dv2, dth2) they add the document's Gamma
    Q Gamma', with sqrt(dv2 dt) and sqrt(dth2 dt) in Gamma and the identity as Q (equations 4 and 5).
    """
    x, y, speed, heading = state
    noise_speed, noise_heading = noise
    (cos, sin), root = cos_sin(heading), np.sqrt(dt)
    return (
        x + dt * speed * cos,
        y + dt * speed * sin,
        speed + root * noise_speed,
        heading + root * noise_heading,
    )


def coast_jacobians(state: Array, control: Array, dt: float) -> tuple[Rows, Rows]:
    """Derivatives of :func:`coast` in state and noise. Document 004, equation 3 (which omits the first two ones)."""
    _, _, speed, heading = state
    (cos, sin), root = cos_sin(heading), np.sqrt(dt)
    in_state = (
        (1.0, 0.0, dt * cos, -dt * speed * sin),
        (0.0, 1.0, dt * sin, dt * speed * cos),
        (0.0, 0.0, 1.0, 0.0),
        (0.0, 0.0, 0.0, 1.0),
    )
    return in_state, ((0.0, 0.0), (0.0, 0.0), (root, 0.0), (0.0, root))


def coast_hessians(state: Array, control: Array, dt: float) -> tuple[Rows, ...]:
    """Second derivatives of the four components of :func:`coast` in the state. Document 004, equation 20."""
    _, _, speed, heading = state
    cos, sin = dt * np.cos(heading), dt * np.sin(heading)
    flat = (0.0, 0.0, 0.0, 0.0)
    straight = (flat, flat, flat, flat)
    return (
        (flat, flat, (0.0, 0.0, 0.0, -sin), (0.0, 0.0, -sin, -speed * cos)),
        (flat, flat, (0.0, 0.0, 0.0, cos), (0.0, 0.0, cos, -speed * sin)),
        straight,
        straight,
    )


def fix(state: Array, landmark: Array) -> Components:
    """The position [cm]."""
    x, y, _, _ = state
    return x, y


def fix_jacobian(state: Array, landmark: Array) -> Rows:
    """Rows of the derivative of :func:`fix` in the state."""
    return (1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0)
