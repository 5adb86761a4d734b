"""The polar to Cartesian table: closed forms to 1e-9, published unscented values to 1e-6."""

import numpy as np
import pytest

from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.sigma_points import _NEAREST2, Cubature, GaussHermite, Julier, Scaled, Simplex
from estlab.maths.space import Space
from estlab.maths.transforms import Function, Linearised, SecondOrder

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


@pytest.mark.parametrize("n", [1, 2, 3, 6])
@pytest.mark.parametrize("points", [Simplex(), Cubature(), Scaled(0.3, 2.0, 1.0), Julier(0.5), GaussHermite(3)])
def test_a_set_of_points_has_the_mean_and_covariance_it_stands_for(points, n):
    a = np.random.default_rng(n).standard_normal((n, n))
    factor = np.linalg.cholesky(a @ a.T + np.eye(n))
    offsets, weights = points.offsets(factor), points.weights(n)
    np.testing.assert_allclose(offsets @ weights, 0.0, atol=1e-12)
    np.testing.assert_allclose((weights * offsets) @ offsets.T, factor @ factor.T, atol=1e-10)


@pytest.mark.parametrize("n", [1, 3, 9])
def test_the_nearest_points_that_are_taken_lose_a_twentieth_of_a_sigma_a_thousand_from_zero(n):
    size = np.random.default_rng(n).uniform(500.0, 1000.0, (n, 400))
    # The identity, by way of numbers that are rounded as a model's are.
    same = Function(lambda x: np.tan(np.arctan(x / 700.0)) * 700.0, Space(("x",) * n, ("m",) * n))

    def lost(spread: float) -> float:
        """In sigmas, of the mean."""
        mean, _, _ = Julier(spread**2 - n)(same, Gaussian(size, np.eye(n)[..., None] * np.ones(400)))
        return float(np.sqrt(np.mean((mean - size) ** 2)))

    least = np.sqrt(_NEAREST2)
    # As the inverse square of the distance, since the second differences of the points make the mean.
    assert lost(least) < 0.1 < lost(least / 5.0)
    assert 30.0 < lost(least) / lost(10.0 * least) < 300.0
    Julier(1.01 * least**2 - n).check(n)
    with pytest.raises(ValueError, match=f"kappa puts the points .* from the mean of {n} dimensions, where rounding"):
        Julier(0.9 * least**2 - n).check(n)
    with pytest.raises(ValueError, match="alpha puts the points"):
        Scaled(0.9 * least / np.sqrt(n), 2.0, 0.0).check(n)
    Scaled(1.1 * least / np.sqrt(n), 2.0, 0.0).check(n)


def test_the_highest_order_of_a_rule_has_all_its_digits():
    bent = Function(lambda v: v**4, Space(("x",), ("m",)))
    mean, _, _ = GaussHermite(300)(bent, Gaussian(np.array([0.0]), np.array([[2.0]])))
    np.testing.assert_allclose(mean, 12.0, rtol=1e-12)
    for order in (1, 301):
        with pytest.raises(ValueError, match=f"order must be from 2 to 300, got {order}"):
            GaussHermite(order)


def test_gauss_hermite_moments_of_polynomials_are_exact():
    """E[(x^2, x^2 y)] for a Gaussian, by Isserlis, to the degree that order 4 promises."""
    p = np.array([[1.5, 0.4], [0.4, 0.8]])
    mx, my = 0.7, -1.1
    bent = Function(lambda v: np.stack([v[0] ** 2, v[0] ** 2 * v[1]]), PLANE)
    mean, cov, cross = GaussHermite(4)(bent, Gaussian(np.array([mx, my]), p))
    np.testing.assert_allclose(mean, [mx**2 + 1.5, my * (mx**2 + 1.5) + 2 * mx * 0.4], rtol=1e-12)
    np.testing.assert_allclose(cov[0, 0], 2 * 1.5**2 + 4 * mx**2 * 1.5, rtol=1e-12)
    np.testing.assert_allclose(cross[:, 0], [2 * mx * 1.5, 2 * mx * 0.4], rtol=1e-12)


def test_second_order_moments_of_a_quadratic_are_exact():
    p = np.array([[1.5, 0.4], [0.4, 0.8]])
    bent = Function(lambda v: np.stack([v[0] ** 2, v[0] * v[1]]), PLANE)
    belief = Gaussian(np.array([0.7, -1.1]), p)
    exact = GaussHermite(5)(bent, belief)
    found = SecondOrder("gaussian")(bent, belief)
    for a, b in zip(found, exact, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)
    modified = SecondOrder("modified")(bent, belief)
    np.testing.assert_allclose(modified.mean, exact.mean, atol=1e-6)
    np.testing.assert_allclose(modified.cov, Linearised()(bent, belief).cov, rtol=1e-12)


def test_cubature_moments_are_the_weighted_sums_as_printed():
    belief = Gaussian(np.array([76.0, 0.3]), np.diag([1.0, 0.2**2]))
    root = np.linalg.cholesky(belief.cov) * np.sqrt(2.0)
    points = belief.mean[:, None] + np.concatenate([root, -root], axis=1)
    images = POLAR.evaluate(points)
    mean, cov, cross = Cubature()(POLAR, belief)
    np.testing.assert_allclose(mean, images.mean(axis=1), rtol=1e-12)
    np.testing.assert_allclose(cov, np.cov(images, bias=True), rtol=1e-10)
    np.testing.assert_allclose(cross, (points - belief.mean[:, None]) @ (images - mean[:, None]).T / 4, rtol=1e-10)
