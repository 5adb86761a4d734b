"""Derivatives of a model by differences, for models that do not state them."""

from collections.abc import Callable

import numpy as np

from estlab.maths.space import Array, Space

# The step that balances truncation, of order h^2, against rounding, of order eps / h.
_RELATIVE_STEP = np.finfo(float).eps ** (1 / 3)


def jacobian(function: Callable[[Array], Array], at: Array, space: Space) -> Array:
    """Central-difference Jacobian (m, n, *batch) of a function (n, p, *batch) -> (m, p, *batch) at a point (n, *batch).

    All 2 n points go through the function in one call, and differences are taken in the function's own
    ``space``, so that a bearing on the other side of the cut does not make a slope of 2 pi / h.
    """
    n = at.shape[0]
    step = _RELATIVE_STEP * np.maximum(1.0, np.abs(at))
    offsets = np.zeros((n, n, *at.shape[1:]))
    offsets[range(n), range(n)] = step
    images = function(np.concatenate([at[:, None] + offsets, at[:, None] - offsets], axis=1))
    rise = space.minus(images[:, :n], images[:, n:])
    return np.asarray(rise / (2.0 * step))
