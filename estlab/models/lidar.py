"""LIDAR frames of a rectangle: rays cast from the origin at fixed steps of bearing, and what is measured from them."""

import numpy as np

from estlab.maths.space import Array, wrap
from estlab.models.vehicle import extent

STEP = np.radians(0.5)  # between neighbouring rays [rad]


def cast(state: Array, step: float = STEP) -> tuple[Array, Array]:
    """Points (2, N) of range [m] and bearing [rad] on the visible edges, and which state each belongs to (N,).

    state: (6, B), B rectangles that do not contain the origin. Rays lie at whole multiples of ``step``.
    A rectangle thinner than a ray's step may be missed by all of them.
    """
    first, last, _ = extent(state, np.empty((0, state.shape[1])))
    start = np.ceil(first / step).astype(int)
    count = np.maximum(np.floor(last / step).astype(int) - start + 1, 0)
    owner = np.repeat(np.arange(state.shape[1]), count)
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    bearing = (start[owner] + within) * step
    distance = _nearest_hit(state[:, owner], bearing)
    hit = np.isfinite(distance)
    return np.stack([distance, wrap(bearing)])[:, hit], owner[hit]


def measure_frames(points: Array, owner: Array, frames: int) -> Array:
    """The three-number measurement of each frame: smallest and largest bearing [rad], smallest range [m]; (3, frames).

    points: (2, N) of range and bearing; owner: (N,) ascending frame numbers. NaN for a frame without a point.
    """
    measured = np.full((3, frames), np.nan)
    if owner.size == 0:
        return measured
    present, begin = np.unique(owner, return_index=True)
    # Bearings about the frame's first point, so that a frame across the cut at pi keeps its order.
    about = np.repeat(points[1, begin], np.diff(np.append(begin, owner.size)))
    turned = wrap(points[1] - about)
    measured[0, present] = wrap(points[1, begin] + np.minimum.reduceat(turned, begin))
    measured[1, present] = wrap(points[1, begin] + np.maximum.reduceat(turned, begin))
    measured[2, present] = np.minimum.reduceat(points[0], begin)
    return measured


def _nearest_hit(state: Array, bearing: Array) -> Array:
    """Distance along each ray to the first edge by the slab method, NaN where the ray misses. Kay and Kajiya 1986."""
    x, y, _, heading, length, width = state
    cos, sin = np.cos(heading), np.sin(heading)
    # The origin and the ray in the car's frame.
    along, across = -(x * cos + y * sin), x * sin - y * cos
    ray_along, ray_across = np.cos(bearing - heading), np.sin(bearing - heading)
    with np.errstate(divide="ignore", invalid="ignore"):
        near_a, far_a = _slab(along, ray_along, 0.0, length)
        near_b, far_b = _slab(across, ray_across, -0.5 * width, 0.5 * width)
    enter, leave = np.maximum(near_a, near_b), np.minimum(far_a, far_b)
    return np.where((enter <= leave) & (enter > 0.0), enter, np.nan)


def _slab(origin: Array, ray: Array, low: Array | float, high: Array | float) -> tuple[Array, Array]:
    one, other = (low - origin) / ray, (high - origin) / ray
    return np.minimum(one, other), np.maximum(one, other)
