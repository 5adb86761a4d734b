"""The table of what was expected and what was found."""

from collections.abc import Sequence

from estlab.report.grids import Grid

HEADINGS = ("filter", "expectation", "expected", "found", "")


def expected_grid(headings: Sequence[str], lines: Sequence[Sequence[str]]) -> Grid:
    """A table of words, whose last column has the outcome."""
    return Grid("", headings, lines, len(headings))
