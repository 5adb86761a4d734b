"""Sums over what counts against NumPy's masked sums, to the last bit."""

import numpy as np
import pytest

from estlab.metrics.masked import count, mean, total

SHAPES = [((3, 7, 40), -1), ((3, 7, 40), 1), ((3, 7, 500), (0, 1)), ((1, 1), 0), ((2, 300, 1), 1), ((0, 5), 1)]


@pytest.mark.parametrize("share", [0.0, 0.7, 1.0])
@pytest.mark.parametrize(("shape", "axis"), SHAPES, ids=str)
def test_totals_are_numpys_masked_sums_to_the_last_bit(shape, axis, share):
    rng = np.random.default_rng(6)
    where = rng.random(shape) < share
    for values in (rng.standard_normal(shape), rng.random(shape) < 0.5, np.broadcast_to(0.1, shape)):
        expected = np.sum(values, axis=axis, where=where)
        np.testing.assert_array_equal(total(values, where, axis), expected, strict=True)
        numbers = where.sum(axis=axis)
        np.testing.assert_array_equal(count(where, axis), numbers, strict=True)
        with np.errstate(invalid="ignore"):
            np.testing.assert_array_equal(mean(values, where, axis), np.where(numbers > 0, expected / numbers, np.nan))
