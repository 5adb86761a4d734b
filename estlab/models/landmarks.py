"""Range and bearing to a known landmark, or only its bearing, from a pose."""

import numpy as np

from estlab.maths.space import Array, Space
from estlab.maths.stacking import Components, Rows

SPACE = Space(("range", "bearing"), ("m", "rad"), angles=(1,))
BEARING = Space(("bearing",), ("rad",), angles=(0,))


def range_bearing(pose: Array, landmark: Array) -> Components:
    """Range [m] and bearing [rad] from a pose [m, m, rad] to a landmark [m, m]. Thrun et al. 2005, eq. 6.40."""
    x, y, heading = pose
    mark_x, mark_y = landmark
    dx, dy = mark_x - x, mark_y - y
    return np.sqrt(dx * dx + dy * dy), np.arctan2(dy, dx) - heading


def range_bearing_jacobian(pose: Array, landmark: Array) -> Rows:
    """Rows of the derivative of :func:`range_bearing` in the pose."""
    x, y, _ = pose
    mark_x, mark_y = landmark
    dx, dy = mark_x - x, mark_y - y
    q = dx * dx + dy * dy
    r = np.sqrt(q)
    return (-dx / r, -dy / r, 0.0), (dy / q, -dx / q, -1.0)


def bearing(pose: Array, landmark: Array) -> Components:
    """Bearing [rad] from a pose to a landmark, in any one unit of length. Seed document 001."""
    x, y, heading = pose
    mark_x, mark_y = landmark
    return (np.arctan2(mark_y - y, mark_x - x) - heading,)


def bearing_jacobian(pose: Array, landmark: Array) -> Rows:
    """The row of the derivative of :func:`bearing` in the pose (H)."""
    return (range_bearing_jacobian(pose, landmark)[1],)


def bearing_hessians(pose: Array, landmark: Array) -> tuple[Rows, ...]:
    """Rows of the second derivatives of :func:`bearing` in the pose."""
    x, y, _ = pose
    mark_x, mark_y = landmark
    dx, dy = mark_x - x, mark_y - y
    q = dx * dx + dy * dy
    q2 = q * q
    along, across = 2.0 * dx * dy / q2, (dy * dy - dx * dx) / q2
    return (((along, across, 0.0), (across, -along, 0.0), (0.0, 0.0, 0.0)),)


def seen_at(pose: Array, reading: Array) -> Array:
    """The position (2, *batch) [m] of the landmark, from a reading (2, *batch) taken at a pose (3, *batch)."""
    x, y, heading = pose
    distance, bearing = reading
    return np.stack([x + distance * np.cos(heading + bearing), y + distance * np.sin(heading + bearing)])
