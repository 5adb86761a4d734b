"""As many digits as an interval justifies."""

import math

from estlab.metrics.intervals import Estimate

_MOST = 7  # digits of any figure


def decimals(value: float, low: float, high: float, expected: float = math.nan) -> int:
    """Decimals that show the interval's half width to two digits and the value to at most seven; three without an
    interval.

    A figure that hardly varies over the runs, such as a covariance that depends on no reading, has an interval of
    rounding errors. expected: more decimals are shown if rounding would move an end onto the expected value or past
    it.
    """
    places = _decimals(value, low, high)
    if not all(map(math.isfinite, (expected, low, high))):
        return places
    most = places + _MOST
    while places < most and any(_side(end, expected) != _side(round(end, places), expected) for end in (low, high)):
        places += 1
    return places


def _side(end: float, expected: float) -> int:
    """On which side of the expected value an end lies."""
    return int(end > expected) - int(end < expected)


def _decimals(value: float, low: float, high: float) -> int:
    half = 0.5 * (high - low)
    scale, digits = (half, 2) if half > 0.0 and math.isfinite(half) else (abs(value), 3)
    if not (scale > 0.0 and math.isfinite(scale)):
        return 0
    places = digits - 1 - math.floor(math.log10(scale))
    if value and math.isfinite(value):
        places = min(places, _MOST - 1 - math.floor(math.log10(max(abs(value), scale))))
    return min(places, 300)


def number(value: float, places: int) -> str:
    """The value to so many decimals, which may be negative; as a power of ten if it would have many zeros."""
    if not math.isfinite(value):
        return "" if math.isnan(value) else f"{value:g}"
    rounded = round(value, places)
    if rounded and not 1e-4 <= abs(rounded) < 1e6:
        return f"{value:.{max(0, places + math.floor(math.log10(abs(rounded))))}e}"
    return f"{rounded + 0.0:.{max(places, 0)}f}"


def figure(found: Estimate, expected: float = math.nan) -> str:
    """The value with as many digits as its interval justifies."""
    return _shown(found, found.value, decimals(found.value, found.low, found.high, expected))


def interval(found: Estimate, expected: float = math.nan) -> str:
    """Both ends with the same digits, on their unrounded side of the expected value; empty without an interval."""
    if math.isnan(found.low):
        return ""
    places = decimals(found.value, found.low, found.high, expected)
    return f"{_shown(found, found.low, places)} to {_shown(found, found.high, places)}"


def _shown(found: Estimate, value: float, places: int) -> str:
    """A value or an end with at least one digit if the interval excludes zero, however wide it is."""
    surely = found.low > 0.0 or found.high < 0.0
    if surely and value and math.isfinite(value) and not round(value, places):
        places = -math.floor(math.log10(abs(value)))
    return number(value, places)


def bracketed(found: Estimate, expected: float = math.nan) -> str:
    """Value and interval: 0.997 [0.944, 1.052]."""
    both = interval(found, expected)
    return f"{figure(found, expected)} [{both.replace(' to ', ', ')}]" if both else figure(found)


def bracket(low: float, high: float) -> str:
    """An interval as it stands behind a value: ' [0.944, 1.052]'; nothing without one."""
    both = interval(Estimate(0.5 * (low + high), low, high, 0))
    return f" [{both.replace(' to ', ', ')}]" if both else ""


def share(value: float) -> str:
    """A share in per cent: 97.1 %; nothing for NaN."""
    return "" if math.isnan(value) else f"{100.0 * value:.1f} %"


def share_interval(low: float, high: float) -> str:
    """Both ends in per cent: 94.4 to 98.2 %; nothing without an interval."""
    return "" if math.isnan(low) or math.isnan(high) else f"{100.0 * low:.1f} to {100.0 * high:.1f} %"


def p_value(p: float) -> str:
    """A p-value to two digits; nothing for NaN."""
    return "" if math.isnan(p) else "< 0.0001" if p < 1e-4 else f"{p:.2g}"
