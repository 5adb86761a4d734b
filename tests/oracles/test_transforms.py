"""The polar to Cartesian table: closed forms to 1e-9, published unscented values to 1e-6."""

import numpy as np
import pytest

from estlab.maths.gaussian import Gaussian
from estlab.maths.sigma_points import Cubature, Scaled
from estlab.maths.space import Space
from estlab.maths.transforms import Function, Linearised

PLANE = Space(("x", "y"), ("m", "m"))
POLAR = Function(lambda p: np.stack([p[0] * np.cos(p[1]), p[0] * np.sin(p[1])]), PLANE)

TABLE = [
    (1.0, Linearised(), (75.8958446413, -3.9775326745, 1.0020802287, 0.0396931273, 1.757389988), 1e-9),
    (1.0, Scaled(1e-3, 2.0, 0.0), (75.8842850, -3.9769269, 1.0023475, 0.0396791, 1.7573907), 1e-6),
    (15.0, Linearised(), (75.8958446413, -3.9775326745, 2.0815991663, 20.6381415339, 394.7991995885), 1e-9),
    (15.0, Scaled(1e-3, 2.0, 0.0), (73.29493507, -3.84122478, 15.6110671, 19.9290912, 394.8363413), 1e-6),
    (15.0, Scaled(1.0, 2.0, 0.0), (73.3245102152, -3.8427747474, 21.8682318589, 18.6703306768, 377.140892939), 1e-9),
]


@pytest.mark.parametrize(("degrees", "transform", "expected", "tolerance"), TABLE)
def test_polar_to_cartesian(degrees, transform, expected, tolerance):
    belief = Gaussian(np.array([76.0, np.radians(-3.0)]), np.diag([1.0, np.radians(degrees) ** 2]))
    mean, cov, _ = transform(POLAR, belief)
    np.testing.assert_allclose([*mean, cov[0, 0], cov[0, 1], cov[1, 1]], expected, atol=tolerance)


@pytest.mark.parametrize("transform", [Linearised(), Scaled(1e-3, 2.0, 0.0), Scaled(1.0, 2.0, 0.0), Cubature()])
def test_a_linear_function_is_transformed_exactly(transform):
    a = np.array([[1.0, 2.0, -1.0], [0.5, 0.0, 3.0]])
    p = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.2], [0.0, 0.2, 0.7]])
    belief = Gaussian(np.array([1.0, -2.0, 0.5]), p)
    mean, cov, cross = transform(Function(lambda x: np.einsum("ij,j...->i...", a, x), PLANE), belief)
    np.testing.assert_allclose(mean, a @ belief.mean, atol=1e-9)
    np.testing.assert_allclose(cov, a @ p @ a.T, atol=1e-8)
    np.testing.assert_allclose(cross, p @ a.T, atol=1e-8)


def test_cubature_moments_are_the_weighted_sums_as_printed():
    belief = Gaussian(np.array([76.0, 0.3]), np.diag([1.0, 0.2**2]))
    root = np.linalg.cholesky(belief.cov) * np.sqrt(2.0)
    points = belief.mean[:, None] + np.concatenate([root, -root], axis=1)
    images = POLAR.evaluate(points)
    mean, cov, cross = Cubature()(POLAR, belief)
    np.testing.assert_allclose(mean, images.mean(axis=1), rtol=1e-12)
    np.testing.assert_allclose(cov, np.cov(images, bias=True), rtol=1e-10)
    np.testing.assert_allclose(cross, (points - belief.mean[:, None]) @ (images - mean[:, None]).T / 4, rtol=1e-10)
