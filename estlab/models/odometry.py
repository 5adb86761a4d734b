"""A robot that reports each step as a turn, a straight move and a turn. State: x [cm], y [cm], heading [rad].

Thrun, Burgard and Fox 2005, section 5.4, with the noise added to the odometry itself; seed document 001.
"""

import numpy as np

from estlab.maths.linalg import diagonal
from estlab.maths.space import Array, Space, cos_sin
from estlab.maths.stacking import Components, Rows

SPACE = Space(("x", "y", "heading"), ("cm", "cm", "rad"), angles=(2,), position=(0, 1))


def turn_move_turn(pose: Array, control: Array, noise: Array, dt: float) -> Components:
    """The pose after a step. control: rot1 [rad], trans [cm], rot2 [rad]; noise: added to them. dt has no effect."""
    x, y, heading = pose
    rot1, trans, rot2 = control
    noise_rot1, noise_trans, noise_rot2 = noise
    course = heading + rot1 + noise_rot1
    distance = trans + noise_trans
    cos, sin = cos_sin(course)
    return x + distance * cos, y + distance * sin, course + rot2 + noise_rot2


def jacobians(pose: Array, control: Array, dt: float) -> tuple[Rows, Rows]:
    """Derivatives of :func:`turn_move_turn` in the pose (G) and in the noise (V), at no noise."""
    _, _, heading = pose
    rot1, trans, _ = control
    cos, sin = cos_sin(heading + rot1)
    in_pose = ((1.0, 0.0, -trans * sin), (0.0, 1.0, trans * cos), (0.0, 0.0, 1.0))
    in_noise = ((-trans * sin, cos, 0.0), (trans * cos, sin, 0.0), (1.0, 0.0, 1.0))
    return in_pose, in_noise


def hessians(pose: Array, control: Array, dt: float) -> tuple[Rows, ...]:
    """Second derivatives of :func:`turn_move_turn` in the pose: only the heading is nonlinear."""
    _, _, heading = pose
    rot1, trans, _ = control
    still = (0.0, 0.0, 0.0)
    bent_x, bent_y = -trans * np.cos(heading + rot1), -trans * np.sin(heading + rot1)
    return (
        (still, still, (0.0, 0.0, bent_x)),
        (still, still, (0.0, 0.0, bent_y)),
        (still, still, still),
    )


def noise_cov(control: Array, alphas: Array, least_sd: float) -> Array:
    """M (3, 3, *batch) of the noise on a control (3, *batch), which grows with the command.

    alphas: (4,), a turn's noise from turning and from moving, a move's from moving and from turning.
    least_sd: lower limit of the standard deviations [rad, cm]: a robot commanded to stay has M = 0, which has no
    factor.
    """
    rot1, trans, rot2 = np.square(control)
    by_turn, by_move, move_by_move, move_by_turn = alphas
    variances = np.stack(
        [
            by_turn * rot1 + by_move * trans,
            move_by_move * trans + move_by_turn * (rot1 + rot2),
            by_turn * rot2 + by_move * trans,
        ]
    )
    return diagonal(np.maximum(variances, least_sd**2))
