"""The particle filter against the plain one that its speed is measured by: the same numbers drawn, the same answers."""

import numpy as np
import pytest

from benchmarks.speed.particles import Case


@pytest.mark.parametrize("engine", ["numpy", "compiled"])
@pytest.mark.parametrize(("particles", "steps"), [(1000, 60), (25_003, 6)])
def test_the_particle_filter_finds_what_the_plain_reference_finds(particles, steps, engine):
    """Among three runs, over several resamplings, whether or not a run is gone through in pieces."""
    case = Case(particles, range(3), steps, engine)
    found = case.estimated()
    for run in range(3):
        plain = case.plain(run)
        assert (plain.size[:-1] < 0.5 * particles).sum() >= 2, "nothing was resampled"
        np.testing.assert_allclose(found.mean[..., run].T, plain.mean, rtol=0, atol=1e-9)
        np.testing.assert_allclose(np.moveaxis(found.cov[..., run], 2, 0), plain.cov, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.whitened[..., run].T, plain.whitened, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.notes["ess"][:, run], plain.size, rtol=1e-9)
