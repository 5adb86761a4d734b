"""What the tests of the compiled filter loop share: a record through both engines."""

from dataclasses import replace

import numpy as np

from estlab.config.settings import Names
from estlab.experiment.monte_carlo import loop_of, record_of
from estlab.maths.streams import Streams
from tests.conftest import settings


def by_both(*words, change=lambda record: record):
    """Estimates of the NumPy and of the compiled loop for what these words compose, the record changed first."""
    wanted = settings(*words, names=Names("test", "test"))
    record = change(record_of(wanted, wanted.run_numbers))
    loops = [
        loop_of(replace(wanted, engine=engine), wanted.filter, record.landmarks) for engine in ("numpy", "compiled")
    ]
    for loop in loops:
        loop.check()
        loop.check_engine()
    return [estimated(loop, record) for loop in loops]


def with_readings(change):
    """A change of a record's readings (m, N, runs) alone."""

    def changed(record):
        return replace(record, readings=replace(record.readings, values=change(record.readings.values.copy())))

    return changed


def assert_same(expected, found, within, runs=slice(None)):
    """Of these runs: each component the same within this share of its largest value, NaN alike, as many refused."""
    for name in ("mean", "cov", "whitened", "log_scale"):
        a, b = getattr(expected, name)[..., runs], getattr(found, name)[..., runs]
        axes = (2, 3) if name == "cov" else (1, 2)
        assert a.shape == b.shape, name
        assert np.array_equal(np.isnan(a), np.isnan(b)), name
        a, b = np.nan_to_num(a), np.nan_to_num(b)
        assert (np.abs(a - b) <= within * np.abs(a).max(axis=axes, keepdims=True, initial=0.0)).all(), name
    if expected.notes:
        assert np.array_equal(expected.notes["gated"][:, runs], found.notes["gated"][:, runs])
    assert expected.gate == found.gate


def estimated(loop, record):
    """What a loop makes of a record."""
    return loop.estimate(record, Streams(1, "test").generators("filter", range(record.runs)))
