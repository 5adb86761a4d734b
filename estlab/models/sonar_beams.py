"""A robot that turns, then moves; and its sonar, which measures the distances of the nearest beacons but not their
identity.

State: x [m], y [m], heading [rad].
"""

import numpy as np

from estlab.maths.space import Array, Space, cos_sin
from estlab.maths.stacking import Components, Rows

SPACE = Space(("x", "y", "heading"), ("m", "m", "rad"), angles=(2,), position=(0, 1))
READING = Space(("nearest", "second", "third"), ("m", "m", "m"))
HEARD = READING.size


def turn_and_move(pose: Array, control: Array, noise: Array, dt: float) -> Components:
    """Turn on the spot, then drive straight. Seed document 000, problem IV.

    control: ds [m], dth [rad], over the whole step. noise: added to ds and dth.
    """
    x, y, heading = pose
    ds, dth = control
    noise_ds, noise_dth = noise
    ahead, way = heading + dth + noise_dth, ds + noise_ds
    # Cosine and sine by the tangent of half the angle: NumPy's tangent is vectorised, its cosine and sine are not.
    half = np.tan(0.5 * ahead)
    stretch = (way + way) / (1.0 + half * half)
    return x + (stretch - way), y + stretch * half, ahead


def turn_and_move_jacobians(pose: Array, control: Array, dt: float) -> tuple[Rows, Rows]:
    """Derivatives of :func:`turn_and_move` in the pose and in the noise on (ds, dth), at no noise."""
    _, _, heading = pose
    ds, dth = control
    ahead = heading + dth
    cos, sin = cos_sin(ahead)
    in_pose = ((1.0, 0.0, -ds * sin), (0.0, 1.0, ds * cos), (0.0, 0.0, 1.0))
    in_noise = ((cos, -ds * sin), (sin, ds * cos), (0.0, 1.0))
    return in_pose, in_noise


def nearest_ranges(pose: Array, beacons: Array) -> Components:
    """Ranges [m] from a pose to the three nearest of the beacons (2, at least 3), ascending."""
    x, y, _ = pose

    def square(beacon: int) -> Array:
        dx, dy = beacons[0, beacon] - x, beacons[1, beacon] - y
        dx *= dx
        dy *= dy
        return dx + dy

    # Keeps the smallest distances in order and inserts each further beacon: over a batch this beats a sort along an
    # axis. The root preserves the order, so it is taken only of those that remain.
    first, second, third = square(0), square(1), square(2)
    first, second = np.minimum(first, second), np.maximum(first, second)
    second, third = np.minimum(second, third), np.maximum(second, third)
    first, second = np.minimum(first, second), np.maximum(first, second)
    for beacon in range(3, beacons.shape[1]):
        further = square(beacon)
        first, further = np.minimum(first, further), np.maximum(first, further)
        second, further = np.minimum(second, further), np.maximum(second, further)
        third = np.minimum(third, further)
    return np.sqrt(first), np.sqrt(second), np.sqrt(third)


def nearest_ranges_jacobian(pose: Array, beacons: Array) -> Rows:
    """Rows of the derivative of :func:`nearest_ranges` in the pose, with the order of the beacons at that pose."""
    x, y, _ = pose
    away = np.stack([np.stack([x - mark_x, y - mark_y]) for mark_x, mark_y in beacons.T], axis=1)
    ranges = np.sqrt((away**2).sum(axis=0))
    order = np.argsort(ranges, axis=0)[:HEARD]
    jacobians = np.take_along_axis(away, order[None], axis=1) / np.take_along_axis(ranges, order, axis=0)
    return tuple((jacobians[0, i], jacobians[1, i], 0.0) for i in range(HEARD))
