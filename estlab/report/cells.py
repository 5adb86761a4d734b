"""Cells of the page's tables: figures with the digits that their intervals leave sense in, sorted by all digits."""

from collections.abc import Mapping

from estlab.metrics.digits import figure, interval
from estlab.metrics.intervals import Estimate
from estlab.report.contents import as_number
from estlab.report.markup import Cell

CsvRow = Mapping[str, str]


def estimate(row: CsvRow, value: str = "value", low: str = "ci_low", high: str = "ci_high") -> Estimate:
    """The number and the interval in a row, NaN for what is not there."""
    return Estimate(as_number(row.get(value)), as_number(row.get(low)), as_number(row.get(high)), 0)


def figure_cell(row: CsvRow | None, value: str = "value", low: str = "ci_low", high: str = "ci_high") -> Cell:
    """A value, to as many digits as its interval has sense for; a count whole; a word as it is."""
    if row is None:
        return Cell("")
    found = estimate(row, value, low, high)
    if found.value != found.value:
        word = row.get(value, "")
        return Cell("" if word.lower() == "nan" else word)
    if found.low != found.low and found.value.is_integer() and abs(found.value) < 1e15:
        return Cell(f"{found.value:.0f}", found.value)
    return Cell(figure(found, as_number(row.get("expected"))), found.value)


def interval_cell(row: CsvRow | None, value: str = "value", low: str = "ci_low", high: str = "ci_high") -> Cell:
    """Both ends of an interval, sorted by the lower."""
    if row is None:
        return Cell("")
    found = estimate(row, value, low, high)
    shown = interval(found, as_number(row.get("expected")))
    return Cell(shown, found.low) if found.low == found.low and found.high == found.high else Cell("")


def share_cell(row: CsvRow | None, value: str = "value") -> Cell:
    """A share in per cent."""
    share = as_number(row.get(value)) if row else float("nan")
    return Cell("") if share != share else Cell(f"{100.0 * share:.1f} %", share)


def p_cell(text: str | None) -> Cell:
    """A p-value to two digits."""
    p = as_number(text)
    return Cell("") if p != p else Cell("< 0.0001" if p < 1e-4 else f"{p:.2g}", p)


def number_cell(text: str | None, ending: str = "") -> Cell:
    """A number to three digits; a word as it is."""
    number = as_number(text)
    return Cell(text or "") if number != number else Cell(f"{number:.3g}{ending}", number)
