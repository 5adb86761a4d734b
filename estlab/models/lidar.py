"""LIDAR frames of a rectangle: rays cast from the origin at fixed steps of bearing, and their measurement."""

import numpy as np

from estlab.maths.space import Array, wrap
from estlab.models.vehicle import extent

STEP = np.radians(0.5)  # between neighbouring rays [rad]


def cast(state: Array, step: float = STEP) -> tuple[Array, Array]:
    """Points (2, N) of range [m] and bearing [rad] on the visible edges, and the index (N,) of the state that each
    belongs to.

    state: (6, B), B rectangles that do not contain the origin. Rays lie at integer multiples of ``step``. A rectangle
    thinner than a ray's step may be missed by all of them.
    """
    _, _, _, start, count = rays(state, step)
    owner = np.repeat(np.arange(state.shape[1]), count)
    bearing = (np.arange(owner.size) + np.repeat(start - np.cumsum(count) + count, count)) * step
    distance = nearest_hit(slabs(state)[:, owner], bearing)
    hit = np.isfinite(distance)
    return np.stack([distance, wrap(bearing)])[:, hit], owner[hit]


def rays(state: Array, step: float = STEP) -> tuple[Array, Array, Array, Array, Array]:
    """The extent of rectangles (6, B), the number of the first ray between its bearings, and how many there are."""
    first, last, nearest = extent(state, np.empty((0, state.shape[1])))
    start = np.ceil(first / step).astype(int)
    return first, last, nearest, start, np.maximum(np.floor(last / step).astype(int) - start + 1, 0)


def measure_frames(points: Array, owner: Array, frames: int) -> Array:
    """The three-number measurement of each frame: smallest and largest bearing [rad], smallest range [m]; (3, frames).

    points: (2, N) of range and bearing; owner: (N,) ascending frame numbers. NaN for a frame without a point.
    """
    measured = np.full((3, frames), np.nan)
    if owner.size == 0:
        return measured
    begin = np.flatnonzero(np.append(True, owner[1:] != owner[:-1]))
    present = owner[begin]
    # Bearings about the frame's first point, so that a frame across the cut at pi keeps its order.
    about = np.repeat(points[1, begin], np.diff(np.append(begin, owner.size)))
    turned = wrap(points[1] - about)
    measured[0, present] = wrap(points[1, begin] + np.minimum.reduceat(turned, begin))
    measured[1, present] = wrap(points[1, begin] + np.maximum.reduceat(turned, begin))
    measured[2, present] = np.minimum.reduceat(points[0], begin)
    return measured


def slabs(state: Array) -> Array:
    """Heading, and from the origin to rear, front, right and left edge in the car's frame; (5, B)."""
    x, y, _, heading, length, width = state
    cos, sin = np.cos(heading), np.sin(heading)
    along, across = -(x * cos + y * sin), x * sin - y * cos
    return np.stack([heading, 0.0 - along, length - along, -0.5 * width - across, 0.5 * width - across])


def nearest_hit(slabs: Array, bearing: Array) -> Array:
    """Distance along each ray to the first edge by the slab method; NaN if the ray misses. Kay and Kajiya 1986."""
    heading, rear, front, right, left = slabs
    ray_along, ray_across = np.cos(bearing - heading), np.sin(bearing - heading)
    with np.errstate(divide="ignore", invalid="ignore"):
        rear, front, right, left = rear / ray_along, front / ray_along, right / ray_across, left / ray_across
    enter = np.maximum(np.minimum(rear, front), np.minimum(right, left))
    leave = np.minimum(np.maximum(rear, front), np.maximum(right, left))
    return np.where((enter <= leave) & (enter > 0.0), enter, np.nan)
