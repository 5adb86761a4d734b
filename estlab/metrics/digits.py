"""As many digits as an interval leaves sense in."""

import math

from estlab.metrics.intervals import Estimate

_MOST = 7  # digits of any figure


def decimals(value: float, low: float, high: float) -> int:
    """Decimals that show the interval's half width to two digits, the value to no more than seven; without one three.

    What hardly varies over the runs, as a covariance that hangs on no reading, has an interval of rounding errors.
    """
    half = 0.5 * (high - low)
    scale, digits = (half, 2) if half > 0.0 and math.isfinite(half) else (abs(value), 3)
    if not (scale > 0.0 and math.isfinite(scale)):
        return 0
    places = digits - 1 - math.floor(math.log10(scale))
    if value and math.isfinite(value):
        places = min(places, _MOST - 1 - math.floor(math.log10(max(abs(value), scale))))
    return min(places, 300)


def number(value: float, places: int) -> str:
    """The value to so many decimals, which may be negative; in powers of ten where it would have many zeros."""
    if not math.isfinite(value):
        return "" if math.isnan(value) else f"{value:g}"
    rounded = round(value, places)
    if rounded and not 1e-4 <= abs(rounded) < 1e6:
        return f"{value:.{max(0, places + math.floor(math.log10(abs(rounded))))}e}"
    return f"{rounded + 0.0:.{max(places, 0)}f}"


def figure(found: Estimate) -> str:
    """The value with as many digits as its interval leaves sense in."""
    return number(found.value, decimals(found.value, found.low, found.high))


def interval(found: Estimate) -> str:
    """Both ends with the same digits; empty where there is no interval."""
    if math.isnan(found.low):
        return ""
    places = decimals(found.value, found.low, found.high)
    return f"{number(found.low, places)} to {number(found.high, places)}"


def bracketed(found: Estimate) -> str:
    """Value and interval: 0.997 [0.944, 1.052]."""
    both = interval(found)
    return f"{figure(found)} [{both.replace(' to ', ', ')}]" if both else figure(found)
