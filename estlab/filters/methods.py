"""What compiled code needs to know about a filter: see estlab.compiled.routines.Method."""

from collections.abc import Callable
from typing import Any

import numpy as np

from estlab.compiled.routines import Method, PointSet
from estlab.filters.filter import AnyFilter
from estlab.filters.gaussian import DeadReckoning, GaussianFilter, IteratedFilter
from estlab.filters.square_root import SquareRootFilter
from estlab.maths.sigma_points import Cubature, GaussHermite, Julier, Scaled, SigmaPoints, Simplex, SymmetricSigmaPoints
from estlab.maths.transforms import Linearised, SecondOrder
from estlab.models.contract import Motion, Sensor

_MOST_POINTS, MOST_STATES = 128, 24
_POINTS = (Scaled, Julier, Cubature, Simplex, GaussHermite)


def method_of(filter: AnyFilter, motion: Motion, sensor: Sensor) -> Method:
    """The method; the sensor's number of values is that of one update. Raises ValueError for another filter."""
    n = motion.space.size
    if n > MOST_STATES:
        raise ValueError(f"it unrolls states of {MOST_STATES} components at most, not {n}; set engine=numpy")
    method = _METHODS.get(type(filter))
    if method is None:
        raise ValueError(
            "it compiles ekf, iekf, second_order, ukf, ckf, ghkf, srukf, srckf, dead_reckoning, pf, rpf and apf, "
            "not this filter; set engine=numpy"
        )
    return method(filter, motion, sensor)


def _of_factors(filter: SquareRootFilter, motion: Motion, sensor: Sensor) -> Method:
    transform = filter.transform
    if type(transform) in _POINTS and isinstance(transform, SymmetricSigmaPoints):
        points = _points(transform, motion.space.size)
        return Method("factors", points, points, gated=filter.gate is not None)
    raise ValueError("it cannot compile this transform; set engine=numpy")


def _of_iterated(filter: IteratedFilter, motion: Motion, sensor: Sensor) -> Method:
    if type(filter.transform) is Linearised:
        return Method("linearised", iterations=filter.iterations, gated=filter.gate is not None)
    raise ValueError("it cannot compile this transform; set engine=numpy")


def _of_gaussian(filter: GaussianFilter, motion: Motion, sensor: Sensor) -> Method:
    augmented, transform = filter.noise == "augmented", filter.transform
    updating, gated = filter.traits.reads, filter.gate is not None
    if type(transform) is Linearised:
        # When linearised, both kinds of noise are the same.
        return Method("linearised", updating=updating, gated=gated)
    if type(transform) is SecondOrder:
        return Method(transform.form, augmented=augmented, updating=updating, gated=gated)
    if type(transform) in _POINTS and isinstance(transform, SigmaPoints):
        n, noises = motion.space.size, (motion.noise_size, sensor.space.size)
        of_motion, of_sensor = (_points(transform, n + (size if augmented else 0)) for size in noises)
        return Method("points", of_motion, of_sensor, augmented, updating=updating, gated=gated)
    raise ValueError("it cannot compile this transform; set engine=numpy")


# Of these very classes and transforms: what is derived from one may do something else.
_METHODS: dict[type, Callable[[Any, Motion, Sensor], Method]] = {
    SquareRootFilter: _of_factors,
    IteratedFilter: _of_iterated,
    GaussianFilter: _of_gaussian,
    DeadReckoning: _of_gaussian,
}


def _points(transform: SigmaPoints, axes: int) -> PointSet:
    if isinstance(transform, SymmetricSigmaPoints):
        return PointSet(transform.spread2(axes), bonus=float(transform.bonus()))
    weights = transform.weights(axes)
    if weights.size > _MOST_POINTS:
        raise ValueError(f"it unrolls {_MOST_POINTS} points at most, not {weights.size}; set engine=numpy")
    listed = transform.offsets(np.eye(axes))
    rows = tuple(tuple(map(float, row)) for row in listed)
    return PointSet(listed=rows, weights=tuple(map(float, weights)), bonus=float(transform.bonus()))
