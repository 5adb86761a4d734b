"""A prediction of clouds: the motion and its noise."""

from typing import Any, NamedTuple

import numpy as np

from estlab.maths import cloud
from estlab.maths.linalg import cholesky
from estlab.maths.space import Array
from estlab.maths.streams import Generators
from estlab.models.contract import Motion


class Step(NamedTuple):
    """A prediction over dt [s] from the points (n, N, runs) before it; the noise is a factor times z.

    control: (c, runs or 1). factor: (q, q, runs or 1). z: (q, N, runs), standard normal.
    """

    motion: Motion
    before: Array
    control: Array
    factor: Array
    z: Array
    dt: float

    @classmethod
    def drawn(cls, motion: Motion, before: Array, control: Array, dt: float, generators: Generators) -> "Step":
        """A prediction with random noise."""
        factor = cholesky(motion.noise_cov(control, dt))
        z = generators.normals((motion.noise_size, before.shape[1]))
        return cls(motion, before, control, factor if factor.ndim > 2 else factor[..., None], z, dt)

    def take(self, runs: Array | slice) -> "Step":
        """The prediction in some of the runs."""
        before, z = cloud.take(self.before, runs), cloud.take(self.z, runs)
        return self._replace(before=before, control=own(self.control, runs), factor=own(self.factor, runs), z=z)

    def silent(self) -> "Step":
        """The prediction without noise."""
        return self._replace(z=np.zeros_like(self.z))

    def points(self) -> Array:
        """The points (n, N, runs) after the prediction."""
        after = cloud.empty(*self.before.shape)
        for runs in cloud.groups(*after.shape[1:]):
            self.take(runs)._move(after[..., runs])
        return after

    def _move(self, after: Array) -> None:
        def move(part: slice) -> None:
            noise = cloud.combined(self.factor, self.z[:, part])
            cloud.fill(after[:, part], self.motion.move(self.before[:, part], self.control, noise, self.dt))

        cloud.each(move, after.shape[1])


def own(values: Array, runs: Any) -> Array:
    """The values of some of the runs, if they differ between runs: (..., runs or 1)."""
    return values if values.shape[-1] == 1 else values[..., runs]
