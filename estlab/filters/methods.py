"""What compiled code needs to know about a filter: see estlab.compiled.routines.Method."""

from typing import Any, cast

import numpy as np

from estlab.compiled.routines import Method, PointSet
from estlab.filters.filter import Filter
from estlab.filters.gaussian import DeadReckoning, GaussianFilter, IteratedFilter
from estlab.filters.square_root import SquareRootFilter
from estlab.maths.sigma_points import Cubature, GaussHermite, Julier, Scaled, SigmaPoints, Simplex, SymmetricSigmaPoints
from estlab.maths.transforms import Linearised, SecondOrder
from estlab.models.contract import Motion, Sensor

_MOST_POINTS, MOST_STATES = 128, 24
_POINTS = (Scaled, Julier, Cubature, Simplex, GaussHermite)


def method_of(filter: Filter, motion: Motion, sensor: Sensor) -> Method:
    """The method; the sensor's number of values is that of one update. Raises ValueError for another filter."""
    n, q, m = motion.space.size, motion.noise_size, sensor.space.size
    if n > MOST_STATES:
        raise ValueError(f"it unrolls states of {MOST_STATES} components at most, not {n}; set engine=numpy")
    transform: Any = getattr(filter, "transform", None)
    if type(filter) is SquareRootFilter and isinstance(transform, SymmetricSigmaPoints) and type(transform) in _POINTS:
        points = _points(transform, n)
        return Method("factors", points, points, gated=filter.gate is not None)
    if type(filter) not in (GaussianFilter, DeadReckoning, IteratedFilter):
        raise ValueError(
            "it compiles ekf, iekf, second_order, ukf, ckf, ghkf, srukf, srckf, dead_reckoning, pf, rpf and apf, "
            "not this filter; set engine=numpy"
        )
    filter = cast(GaussianFilter, filter)
    augmented, gated = filter.noise == "augmented", filter.gate is not None
    iterations = filter.iterations if isinstance(filter, IteratedFilter) else 1
    updating = not isinstance(filter, DeadReckoning)
    if type(transform) is Linearised:
        # When linearised, both kinds of noise are the same.
        return Method("linearised", iterations=iterations, updating=updating, gated=gated)
    if type(transform) is SecondOrder and iterations == 1:
        return Method(transform.form, augmented=augmented, updating=updating, gated=gated)
    if type(transform) in _POINTS and iterations == 1:
        of_motion, of_sensor = (_points(transform, n + (more if augmented else 0)) for more in (q, m))
        return Method("points", of_motion, of_sensor, augmented, updating=updating, gated=gated)
    raise ValueError("it cannot compile this transform; set engine=numpy")


def _points(transform: SigmaPoints, axes: int) -> PointSet:
    if isinstance(transform, SymmetricSigmaPoints):
        return PointSet(transform.spread2(axes), bonus=float(transform.bonus()))
    weights = transform.weights(axes)
    if weights.size > _MOST_POINTS:
        raise ValueError(f"it unrolls {_MOST_POINTS} points at most, not {weights.size}; set engine=numpy")
    listed = transform.offsets(np.eye(axes))
    rows = tuple(tuple(map(float, row)) for row in listed)
    return PointSet(listed=rows, weights=tuple(map(float, weights)), bonus=float(transform.bonus()))
