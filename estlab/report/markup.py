"""HTML from values. Every text is escaped; markup has its own type."""

from collections.abc import Iterable, Sequence
from html import escape
from typing import NamedTuple
from urllib.parse import quote

_VOID = frozenset({"img", "meta", "link", "br"})
# Control characters and surrogate halves are not HTML, and the latter not UTF-8; direction marks can hide names.
_REPLACED = dict.fromkeys(
    (*range(9), 11, 12, *range(14, 32), *range(127, 160), *range(0xD800, 0xE000))
    + (0x200E, 0x200F, *range(0x202A, 0x202F), *range(0x2066, 0x206A)),
    "\ufffd",
)


class Html(str):
    """Text that is already markup."""


Content = str | None | Iterable["Content"]


class Cell(NamedTuple):
    """What a cell shows, and the number by which it is sorted."""

    text: str
    number: float = float("nan")


def text(content: str) -> Html:
    """A text escaped, for content and attributes."""
    return Html(escape(content.translate(_REPLACED), quote=True))


def join(content: Content) -> Html:
    """Markup from texts and markup in order; None adds nothing."""
    if content is None or isinstance(content, Html):
        return content or Html()
    return text(content) if isinstance(content, str) else Html("".join(map(join, content)))


def tag(name: str, *content: Content, **attributes: str | bool | None) -> Html:
    """An element. Attributes: class_ is class, data_x is data-x, True is one without value, None and False none."""
    given = "".join(
        f" {key.rstrip('_').replace('_', '-')}" + ("" if value is True else f'="{text(str(value))}"')
        for key, value in attributes.items()
        if value is not None and value is not False
    )
    return Html(f"<{name}{given}>" if name in _VOID else f"<{name}{given}>{join(content)}</{name}>")


def table(caption: str, headings: Sequence[str], rows: Iterable[Sequence[str | Cell]], filtered: bool = False) -> Html:
    """A table in its own scrolling box. The script makes its columns sortable and, if requested, its rows filterable.

    Columns of cells with numbers are right-aligned; the first column heads its row.
    """
    lines = [[cell if isinstance(cell, Cell) else Cell(cell) for cell in row] for row in rows]
    numeric = [any(line[i].number == line[i].number for line in lines) for i in range(len(headings))]
    head = [
        tag("th", heading, scope="col", class_="number" if right else None)
        for heading, right in zip(headings, numeric, strict=True)
    ]
    body = [
        tag("tr", [_cell(cell, right, first=i == 0) for i, (cell, right) in enumerate(zip(line, numeric, strict=True))])
        for line in lines
    ]
    content = tag("table", tag("caption", tag("span", caption)), tag("thead", tag("tr", head)), tag("tbody", body))
    return tag("div", content, class_="box", role="region", aria_label=caption, tabindex="0", data_filtered=filtered)


def _cell(cell: Cell, right: bool, first: bool) -> Html:
    number = repr(float(cell.number)) if cell.number == cell.number else None
    name, scope = ("th", "row") if first else ("td", None)
    return tag(name, cell.text, scope=scope, class_="number" if right else None, data_number=number)


def section(name: str, heading: str, *content: Content) -> Html:
    """A part of the page, with an anchor."""
    return tag("section", tag("h2", heading, id=f"{name}-heading"), content, id=name, aria_labelledby=f"{name}-heading")


def note(remark: str) -> Html:
    """A remark on what is missing; empty without one."""
    return tag("p", remark, class_="note") if remark else Html()


def folded(summary: str, *content: Content) -> Html:
    """Content that is shown on request."""
    return tag("details", tag("summary", summary), content)


def link(path: str, label: str | None = None) -> Html:
    """A link to a file below the page. The leading dot keeps a name such as javascript: from being a scheme."""
    return tag("a", label or path, href="./" + quote(path, safe="/", errors="replace"))
