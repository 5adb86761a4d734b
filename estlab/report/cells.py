"""Cells of the page's tables: figures with the digits that their intervals justify, sorted at full precision."""

from collections.abc import Mapping

from estlab.metrics.digits import figure, interval, p_value, share, share_interval
from estlab.metrics.intervals import Estimate
from estlab.metrics.vocabulary import written
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
    text = interval(found, as_number(row.get("expected")))
    return Cell(text, found.low) if found.low == found.low and found.high == found.high else Cell("")


def share_cell(row: CsvRow | None, value: str = "value") -> Cell:
    """A share in per cent."""
    found = as_number(row.get(value)) if row else float("nan")
    return Cell(share(found), found)


def share_interval_cell(row: CsvRow | None) -> Cell:
    """An interval of shares in per cent, sorted by the lower end."""
    if row is None:
        return Cell("")
    low, high = as_number(row.get("ci_low")), as_number(row.get("ci_high"))
    return Cell(share_interval(low, high), low)


def p_cell(text: str | None) -> Cell:
    """A p-value to two digits."""
    p = as_number(text)
    return Cell(p_value(p), p)


def number_cell(text: str | None, ending: str = "") -> Cell:
    """A number to three digits; a word as it is."""
    number = as_number(text)
    return Cell(text or "") if number != number else Cell(f"{number:.3g}{ending}", number)


def metric_cell(name: str, row: CsvRow | None) -> Cell:
    """A metric's value, in the form that it has in every table."""
    found = estimate(row or {})
    return Cell(written(name, found), found.value)
