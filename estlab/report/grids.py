"""One table for a terminal, for Markdown and for LaTeX."""

import re
from collections.abc import Sequence
from typing import NamedTuple

from rich.table import Table
from rich.text import Text

from estlab.errors import printable
from estlab.report.console import console

_MARKDOWN = {**{c: f"\\{c}" for c in "\\`*_|~"}, "<": "&lt;", "&": "&amp;", "](": r"]\("}
_LATEX = {
    **{c: f"\\{c}" for c in "&%$#_{}"},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
    # After a line break, LaTeX would read a bracket as an argument.
    **{"[": "{[}", "]": "{]}", "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}"},
    **{"×": r"$\times$", "·": r"$\cdot$", "…": r"\dots{}", "±": r"$\pm$", "²": r"$^2$", "−": "$-$"},
}
FAILED = "FAILED"  # in a cell
_STYLES = {FAILED: "bold red"}


class Grid(NamedTuple):
    """A title, headings and lines of as many cells. left: columns of words, before those of numbers."""

    title: str
    headings: Sequence[str]
    lines: Sequence[Sequence[str]]
    left: int = 1


def show(grid: Grid) -> None:
    """Print it on the terminal."""
    table = Table(title=Text(printable(grid.title)), title_justify="left", title_style="bold", box=None, pad_edge=False)
    for i, heading in enumerate(grid.headings):
        table.add_column(Text(printable(heading)), justify="left" if i < grid.left else "right", overflow="fold")
    for line in grid.lines:
        table.add_row(*(Text(printable(cell), style=_STYLES.get(cell, "")) for cell in line))
    console().print(table)


def markdown(grid: Grid) -> str:
    """A table of GitHub's Markdown."""
    rule = [":--" if i < grid.left else "--:" for i in range(len(grid.headings))]
    cells = [[_escaped(cell, _MARKDOWN) for cell in line] for line in (grid.headings, *grid.lines)]
    lines = [f"| {' | '.join(line)} |" for line in (cells[0], rule, *cells[1:])]
    return "\n".join([f"**{_escaped(grid.title, _MARKDOWN)}**", "", *lines, ""])


def latex(grid: Grid) -> str:
    """A tabular for the package booktabs."""
    columns = "l" * grid.left + "r" * (len(grid.headings) - grid.left)
    head, *lines = [" & ".join(_escaped(c, _LATEX) for c in line) + r" \\" for line in (grid.headings, *grid.lines)]
    return "\n".join(
        [
            f"% {printable(grid.title)}",
            rf"\begin{{tabular}}{{{columns}}}",
            r"\toprule",
            head,
            r"\midrule",
            *lines,
            r"\bottomrule",
            r"\end{tabular}",
            "",
        ]
    )


def _escaped(text: str, signs: dict[str, str]) -> str:
    found = "|".join(map(re.escape, signs))
    return re.sub(found, lambda match: signs[match[0]], printable(text))
