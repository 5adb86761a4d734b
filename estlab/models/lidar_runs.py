"""LIDAR frames of many runs, measured without storing their points: by NumPy, or by compiled code with the same
results.

Compiled code finds the ray that reads the smallest range; NumPy then computes the range, and handles every frame in
which rays lie so close that rounding could decide.
"""

from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import numpy as np

from estlab.compiled.cache import loadable
from estlab.compiled.fold import Fold
from estlab.compiled.normals import code as normals_code
from estlab.compiled.normals import one_after_another
from estlab.maths.space import Array, wrap
from estlab.maths.streams import Streams
from estlab.models.lidar import STEP, cast, measure_frames, nearest_hit, rays, slabs

PURPOSE = "readings"  # of the streams
_FRAMES, _FRAMES_BY_NUMPY = 6_000, 1_600  # at once, whose arrays stay in the cache; NumPy has arrays of all their rays
_MANY = 40_000  # frames from which loading the compiler pays
_SURE = 1e-9  # rad of bearing, and share of a range, within which rounding might decide
_WIDE = 3.0  # rad, which no rectangle reaches over that the sensor is well outside of
_STEEP = 1e-5  # cosine of the angle between a ray and an edge's normal, below which its quotient is less exact


def measure_runs(states: Array, streams: Streams, runs: Sequence[int], sds: Sequence[float]) -> Array:
    """The three-number measurements (3, T, runs) of rectangles (6, T, runs) from frames of noisy points.

    Each run's noise comes from its stream for readings. sds: of range [m] and bearing [rad].
    """
    _, steps, count = states.shape
    scan = _compiled() if steps * count >= _MANY else None
    together = max(1, (_FRAMES if scan else _FRAMES_BY_NUMPY) // steps)
    values = np.empty((3, steps, count))
    for begin in range(0, count, together):
        some, own = states[:, :, begin : begin + together], runs[begin : begin + together]
        if scan is None:
            found = measure_frames(*noisy_frames(some, streams, own, sds), some[0].size)
        else:
            found = _by_rays(scan, some, streams, own, sds)
        values[:, :, begin : begin + together] = found.reshape(3, -1, steps).swapaxes(1, 2)
    return values


def noisy_frames(states: Array, streams: Streams, runs: Sequence[int], sds: Sequence[float]) -> tuple[Array, Array]:
    """Noisy points (2, N) of the frames of all steps, run by run; and the frame number of each."""
    points, owner = cast(_one_run_after_another(states))
    edges = np.searchsorted(owner, states.shape[1] * np.arange(len(runs) + 1))
    noise = [
        generator.standard_normal((2, end - begin))
        for generator, (begin, end) in zip(streams.generators(PURPOSE, runs), pairwise(edges), strict=True)
    ]
    return points + np.asarray(sds)[:, None] * np.concatenate(noise, axis=1), owner


def _one_run_after_another(states: Array) -> Array:
    return np.swapaxes(states, 1, 2).reshape(states.shape[0], -1)


@cache
def _compiled() -> Fold | None:
    """The compiled scan; None without a compiler, or without room for one."""
    return Fold(_ray, given=7, looked_up=2, kept=7, parameters=2) if loadable() else None


def _ray(number: Array, frame: Array, noise: Array, kept: Array, sds: Array) -> tuple[Array, ...]:
    """The state of a frame after one more of its rays.

    Over all rays so far: the smallest range, its ray, the next range; smallest and largest bearing relative to the
    first; the first; the smallest cosine between a ray and the normal of an edge.
    """
    edges, start, count = frame[:5], frame[5], frame[6]
    nearest, which, second, least, most, first, steepest = kept
    inside = number < count
    bearing = (start + number) * STEP
    seen = wrap(bearing) + sds[1] * noise[1]
    first = np.where(number == 0.0, seen, first)
    turned = wrap(seen - first)
    distance = nearest_hit(edges, bearing) + sds[0] * noise[0]
    along, across = np.abs(np.cos(bearing - edges[0])), np.abs(np.sin(bearing - edges[0]))
    return (
        np.where(inside, np.minimum(nearest, distance), nearest),
        np.where(inside & (distance < nearest), number, which),
        np.where(inside, np.minimum(second, np.maximum(nearest, distance)), second),
        np.where(inside, np.minimum(least, turned), least),
        np.where(inside, np.maximum(most, turned), most),
        first,
        np.where(inside, np.minimum(steepest, np.minimum(along, across)), steepest),
    )


def _by_rays(scan: Fold, states: Array, streams: Streams, runs: Sequence[int], sds: Sequence[float]) -> Array:
    """The measurements (3, runs * T), run by run."""
    steps, state = states.shape[1], _one_run_after_another(states)
    first, last, nearest, start, count = rays(state)
    sure = (last - first < _WIDE) & (nearest > _SURE) & (start * STEP - first > _SURE)
    sure &= last - (start + count - 1) * STEP > _SURE
    doubtful = ~sure & (count > 0)
    at = np.flatnonzero(doubtful)
    count[at] = np.bincount(cast(state[:, at])[1], minlength=at.size)

    # A run's numbers are those for the ranges of all its points, then those for their bearings.
    edges = np.concatenate([[0], np.cumsum(count)])
    ends = edges[::steps]
    noise = one_after_another(normals_code(), streams, PURPOSE, runs, 2 * ends, int(count.max(initial=0)) + 1)
    of_range = edges[:-1] + np.repeat(ends[:-1], steps)
    looked_up = np.stack([of_range, of_range + np.repeat(np.diff(ends), steps)])

    edge = slabs(state)
    given = np.concatenate([edge, [start, count]])
    begun = (np.inf, 0.0, np.inf, np.inf, -np.inf, 0.0, np.inf)
    (smallest, which, second, least, most, about, steepest), right = scan(count, given, noise, looked_up, begun, sds)
    ray = which.astype(int)
    distance = nearest_hit(edge, (start + ray) * STEP) + sds[0] * noise[of_range + ray]
    with np.errstate(invalid="ignore"):  # of frames without a point
        measured = np.stack([wrap(about + least), wrap(about + most), distance])
        clear = right & (second - smallest > _SURE * np.abs(smallest)) & (steepest > _STEEP)
    measured[:, count == 0] = np.nan

    at = np.flatnonzero((doubtful | ~clear) & (count > 0))
    points, owner = cast(state[:, at])
    within = np.arange(owner.size) - np.searchsorted(owner, owner)
    measured[:, at] = measure_frames(
        points + np.asarray(sds)[:, None] * noise[looked_up[:, at[owner]] + within], owner, at.size
    )
    return measured
