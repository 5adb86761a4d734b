"""Range and bearing to a known landmark, seen from a pose."""

import numpy as np

from estlab.maths.space import Array, Space
from estlab.models.contract import Components, Rows

SPACE = Space(("range", "bearing"), ("m", "rad"), angles=(1,))


def range_bearing(pose: Array, landmark: Array) -> Components:
    """Range [m] and bearing [rad] from a pose [m, m, rad] to a landmark [m, m]. Thrun et al. 2005, eq. 6.40."""
    x, y, heading = pose
    mark_x, mark_y = landmark
    dx, dy = mark_x - x, mark_y - y
    return np.sqrt(dx * dx + dy * dy), np.arctan2(dy, dx) - heading


def range_bearing_slope(pose: Array, landmark: Array) -> Rows:
    """Rows of the derivative of :func:`range_bearing` in the pose."""
    x, y, _ = pose
    mark_x, mark_y = landmark
    dx, dy = mark_x - x, mark_y - y
    q = dx * dx + dy * dy
    r = np.sqrt(q)
    return (-dx / r, -dy / r, 0.0), (dy / q, -dx / q, -1.0)


def seen_at(pose: Array, reading: Array) -> Array:
    """Where a reading (2, *batch) taken from a pose (3, *batch) puts its landmark: (2, *batch) [m]."""
    x, y, heading = pose
    distance, bearing = reading
    return np.stack([x + distance * np.cos(heading + bearing), y + distance * np.sin(heading + bearing)])
