"""A radar's range and bearing as a position in the plane. State before: range [m], bearing [rad]; after: x, y [m]."""

import numpy as np

from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Array, Space, cos_sin
from estlab.maths.stacking import Components, Rows

PLACE = Space(("x", "y"), ("m", "m"), position=(0, 1))


def place(seen: Array, control: Array, noise: Array, dt: float) -> Components:
    """x = r cos th, y = r sin th, without noise and independent of time. Document 000, problem II."""
    distance, bearing = seen
    cos, sin = cos_sin(bearing)
    return distance * cos, distance * sin


def place_jacobians(seen: Array, control: Array, dt: float) -> tuple[Rows, Rows]:
    """Derivatives of :func:`place` in range and bearing, and in the noise, of which there is none."""
    distance, bearing = seen
    cos, sin = np.cos(bearing), np.sin(bearing)
    return ((cos, -distance * sin), (sin, distance * cos)), ((), ())


def place_hessians(seen: Array, control: Array, dt: float) -> tuple[Rows, ...]:
    """Second derivatives of :func:`place` in range and bearing, of x and of y."""
    distance, bearing = seen
    cos, sin = np.cos(bearing), np.sin(bearing)
    return ((0.0, -sin), (-sin, -distance * cos)), ((0.0, cos), (cos, -distance * sin))


def exact_moments(distance: float, bearing: float, distance_sd: float, bearing_sd: float) -> Gaussian:
    """Mean (2,) and covariance (2, 2) of the position for independent Gaussian range and bearing, in closed form.

    Because range and bearing are independent, E[x^2] = E[r^2] E[cos^2 th] and so on. The moments of the bearing are
    the real and imaginary parts of E[e^(ik th)] = e^(ik th - k^2 s^2 / 2) for k = 1, 2, with cos^2 = (1 + cos 2 th) /
    2 and sin cos = sin 2 th / 2.
    """
    once = np.exp(1j * bearing - 0.5 * bearing_sd**2)
    twice = np.exp(2j * bearing - 2.0 * bearing_sd**2)
    mean = distance * np.array([once.real, once.imag])
    square = 0.5 * (distance**2 + distance_sd**2)
    second = square * np.array([[1.0 + twice.real, twice.imag], [twice.imag, 1.0 - twice.real]])
    return Gaussian(mean, second - np.outer(mean, mean))
