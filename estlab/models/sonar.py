"""A robot that turns, then moves; and its sonar, which hears how far the nearest beacons are but not which they are.

State: x [m], y [m], heading [rad].
"""

import numpy as np

from estlab.maths.space import Array, Space
from estlab.models.contract import Components, Rows

SPACE = Space(("x", "y", "heading"), ("m", "m", "rad"), angles=(2,), position=(0, 1))
READING = Space(("nearest", "second", "third"), ("m", "m", "m"))
HEARD = READING.size


def turn_and_move(pose: Array, control: Array, noise: Array, dt: float) -> Components:
    """Turn on the spot, then go straight. Seed document 000, problem IV.

    control: ds [m], dth [rad], over the whole step. noise: added to ds and dth.
    """
    x, y, heading = pose
    ds, dth = control
    noise_ds, noise_dth = noise
    ahead, way = heading + dth + noise_dth, ds + noise_ds
    return x + way * np.cos(ahead), y + way * np.sin(ahead), ahead


def turn_and_move_jacobians(pose: Array, control: Array, dt: float) -> tuple[Rows, Rows]:
    """Derivatives of :func:`turn_and_move` in the pose and in the noise on (ds, dth), at no noise."""
    _, _, heading = pose
    ds, dth = control
    ahead = heading + dth
    cos, sin = np.cos(ahead), np.sin(ahead)
    in_pose = ((1.0, 0.0, -ds * sin), (0.0, 1.0, ds * cos), (0.0, 0.0, 1.0))
    in_noise = ((cos, -ds * sin), (sin, ds * cos), (0.0, 1.0))
    return in_pose, in_noise


def nearest_ranges(pose: Array, beacons: Array) -> Components:
    """Ranges [m] from a pose to the three nearest of the beacons (2, at least 3), ascending."""
    x, y, _ = pose
    ranges = [np.sqrt((mark_x - x) ** 2 + (mark_y - y) ** 2) for mark_x, mark_y in beacons.T]
    # Three passes of exchanges bring the three smallest to the front; over a batch this beats sorting along an axis.
    for first in range(HEARD):
        for i in range(len(ranges) - 1, first, -1):
            ranges[i - 1], ranges[i] = np.minimum(ranges[i - 1], ranges[i]), np.maximum(ranges[i - 1], ranges[i])
    return tuple(ranges[:HEARD])


def nearest_ranges_slope(pose: Array, beacons: Array) -> Rows:
    """Rows of the derivative of :func:`nearest_ranges` in the pose, with the order of the beacons as it is there."""
    x, y, _ = pose
    away = np.stack([np.stack([x - mark_x, y - mark_y]) for mark_x, mark_y in beacons.T], axis=1)
    ranges = np.sqrt((away**2).sum(axis=0))
    order = np.argsort(ranges, axis=0)[:HEARD]
    slopes = np.take_along_axis(away, order[None], axis=1) / np.take_along_axis(ranges, order, axis=0)
    return tuple((slopes[0, i], slopes[1, i], 0.0) for i in range(HEARD))
