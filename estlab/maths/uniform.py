"""A uniform belief: it knows only the bounds."""

from typing import NamedTuple

import numpy as np

from estlab.earlier_names import renamed
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Array
from estlab.maths.streams import Generators


@renamed(of="take")
class Uniform(NamedTuple):
    """Uniform over the box from low (n,) to high (n,), the same for each of the runs."""

    low: Array
    high: Array
    runs: int

    def take(self, runs: Array) -> "Uniform":
        """The belief in some of the runs."""
        return self._replace(runs=runs.size)

    def fitted(self) -> Gaussian:
        """The Gaussian with the same mean (n, runs) and covariance (n, n)."""
        mean = np.repeat(0.5 * (self.low + self.high)[:, None], self.runs, axis=1)
        return Gaussian(mean, np.diag((self.high - self.low) ** 2 / 12.0))

    def sample(self, generators: Generators, count: int) -> Array:
        """Points (n, count, runs)."""
        width = (self.high - self.low)[:, None, None]
        return self.low[:, None, None] + width * generators.uniforms((self.low.size, count))
