"""Derivatives of a model by differences, for models that do not state them."""

from collections.abc import Callable

import numpy as np

from estlab.maths.space import Array, Space

# The step that balances truncation, of order h^2, against rounding, of order eps / h.
RELATIVE_STEP = np.finfo(float).eps ** (1 / 3)
_RELATIVE_STEP_2 = 2.0 * np.finfo(float).eps ** (1 / 4)  # the same for second differences


def jacobian(function: Callable[[Array], Array], at: Array, space: Space) -> Array:
    """Central-difference Jacobian (m, n, *batch) of a function (n, p, *batch) -> (m, p, *batch) at a point (n,
    *batch).

    All 2 n points go through the function in one call. Differences are taken in the function's own ``space``, so a
    bearing on the other side of the cut does not make a derivative of 2 pi / h.
    """
    n = at.shape[0]
    step = RELATIVE_STEP * np.maximum(1.0, np.abs(at))
    offsets = np.zeros((n, n, *at.shape[1:]))
    offsets[range(n), range(n)] = step
    images = function(np.concatenate([at[:, None] + offsets, at[:, None] - offsets], axis=1))
    rise = space.minus(images[:, :n], images[:, n:])
    return np.asarray(rise / (2.0 * step))


def hessian(function: Callable[[Array], Array], at: Array, space: Space) -> Array:
    """Central-difference Hessians (m, n, n, *batch) of a function as in :func:`jacobian`, at a point (n, *batch).

    Second differences along x_i + x_j and x_i - x_j; all points go through the function in one call.
    """
    n = at.shape[0]
    step = _RELATIVE_STEP_2 * np.maximum(1.0, np.abs(at))
    first, second = np.triu_indices(n)
    directions = []
    for sign in (1.0, -1.0):
        direction = np.zeros((n, first.size, *at.shape[1:]))
        direction[first, range(first.size)] += 0.5 * step[first]
        direction[second, range(first.size)] += 0.5 * sign * step[second]
        directions.append(direction)
    sum_, difference = directions
    points = [at[:, None], at[:, None] + sum_, at[:, None] - sum_, at[:, None] + difference, at[:, None] - difference]
    images = function(np.concatenate(points, axis=1))
    rise = space.minus(images[:, 1:], images[:, :1])
    forward, backward, aside, back = np.split(rise, 4, axis=1)
    # f(x+s) + f(x-s) - f(x+d) - f(x-d) = h_i h_j H_ij with s, d = (h_i e_i +- h_j e_j) / 2; for i = j, d is zero.
    entries = (forward + backward - aside - back) / (step[first] * step[second])
    result = np.empty((images.shape[0], n, n, *at.shape[1:]))
    result[:, first, second] = entries
    result[:, second, first] = entries
    return result
