"""A Gaussian belief: replaced by every step, never edited."""

from typing import NamedTuple

import numpy as np

from estlab.earlier_names import renamed
from estlab.maths.linalg import block_diagonal, cholesky, matmul, matvec
from estlab.maths.space import Array, Space
from estlab.maths.streams import Generators


@renamed(of="take", put="replaced")
class Gaussian(NamedTuple):
    """Mean (n, *batch) and covariance (n, n, *batch)."""

    mean: Array
    cov: Array

    def take(self, runs: Array) -> "Gaussian":
        """The belief in some of the runs; the covariance may be shared by all runs."""
        return Gaussian(self.mean[..., runs], self.cov[..., runs] if self.cov.ndim > 2 else self.cov)

    def replaced(self, runs: Array, part: "Gaussian") -> "Gaussian":
        """The belief with those of some runs replaced."""
        return Gaussian(replaced(self.mean, runs, part.mean), replaced(self.cov, runs, part.cov))

    def fitted(self) -> "Gaussian":
        """Itself: any prior can return the Gaussian with its moments."""
        return self

    def sample(self, generators: Generators, count: int) -> Array:
        """Points (n, count, *batch). Angles are not wrapped: the points spread about their mean."""
        z = generators.normals((self.mean.shape[0], count))
        return self.mean[:, None] + matmul(cholesky(self.cov), z)

    def joined(self, noise_cov: Array) -> "Gaussian":
        """The joint belief in (state, noise): independent noise of zero mean and this covariance (q, q, *batch)."""
        q = noise_cov.shape[0]
        zeros = np.zeros((q, *self.mean.shape[1:]))
        return Gaussian(np.concatenate([self.mean, zeros]), block_diagonal(self.cov, noise_cov))


def draw(space: Space, belief: Gaussian, standard_normal: Array) -> Array:
    """x = A z + b with A A' = P: Gaussian vectors from standard normal ones (n, *batch). Document 000, problem I."""
    return space.plus(belief.mean, matvec(cholesky(belief.cov), standard_normal))


def replaced(whole: Array, runs: Array, part: Array) -> Array:
    """A copy of (*shape, runs) with some of the runs replaced."""
    copy = whole.copy()
    copy[..., runs] = part
    return copy


def ellipses(mean: Array, cov: Array, sigmas: float = 3.0) -> Array:
    """Outlines (2, 60, N) of the covariance ellipses of means (2, N) and covariances (2, 2, N)."""
    around = np.linspace(0.0, 2.0 * np.pi, 60)
    circle = sigmas * np.stack([np.cos(around), np.sin(around)])
    return np.asarray(mean[:, None] + np.einsum("ikn,kp->ipn", cholesky(cov), circle))
