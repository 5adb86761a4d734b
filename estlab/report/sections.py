"""A page's parts, and those that the pages of a run and of a sweep share: plots, log, facts, files."""

import json
import re
import struct
from base64 import b64encode
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from estlab import rundir
from estlab.report.contents import Contents, UnusableError, size
from estlab.report.markup import Cell, Html, folded, join, link, note, section, table, tag
from estlab.rundir.layout import OUTPUT, REPORT

_LOG_BYTES = 2**17
_WARNINGS = 50
_LONG = 2000  # characters of a fact that are shown

_PLOTS = {
    "errors": "Error of the first run, ±3 sigma, and RMSE of the ensemble over time, one panel per component",
    "nees": "NEES / n over time with the 95 % band of a consistent filter",
    "nis": "NIS / m over time with the 95 % band of a consistent filter",
    "components": "RMSE and mean sigma of every component, over all time",
    "cloud": "The cloud of particles at six moments, of the best and the worst run of those kept",
    "repeats": "The runs over one recording side by side",
    "ess": "Effective sample size over time",
    "distribution": "Distribution over runs of RMSE and NEES",
    "trajectory": "Trajectory of the first run, true and estimated",
}
_STATES = {"ok": "good", "unmet": "doubt", "failed": "bad", "interrupted": "doubt", "running": "doubt", "left": "doubt"}


class Page(NamedTuple):
    """Title, the heading above everything, and the sections: anchor, heading, content."""

    title: str
    head: Html
    sections: list[tuple[str, str, Html]]

    def contents(self) -> Html:
        """The list of the sections."""
        return tag("ul", [tag("li", tag("a", heading, href=f"#{name}")) for name, heading, _ in self.sections])

    def body(self) -> Html:
        """The sections."""
        return join([section(name, heading, content) for name, heading, content in self.sections])


def made(make: Callable[[], Html]) -> Html:
    """A part of the page, or why it cannot be made."""
    try:
        return make()
    except UnusableError as error:
        return note(str(error))
    except Exception as error:
        return note(f"This part cannot be made ({type(error).__name__}: {error}).")


def status(word: str) -> Html:
    """A status as a coloured word."""
    return tag("span", word, class_=f"status {_STATES.get(word, '')}".strip())


def plots(contents: Contents, title: str) -> Html:
    """The pictures, inlined."""
    found, remarks = contents.plots(rundir.PLOTS)
    figures = []
    known = [name for stem in _PLOTS if (name := f"{stem}.png") in found]
    for name in dict.fromkeys([*known, *found]):
        content = found[name]
        stem = name.removesuffix(".png")
        caption = _PLOTS.get(stem, stem.replace("_", " "))
        width, height = struct.unpack(">II", content[16:24].ljust(8, b"\0"))
        source = f"data:image/png;base64,{b64encode(content).decode()}"
        image = tag("img", src=source, alt=f"{caption}: {title}", width=str(width), height=str(height))
        figures.append(tag("figure", image, tag("figcaption", caption)))
    if not found and not remarks:
        return note("There are no plots in this directory; plots=true draws them.")
    return join([tag("div", figures, class_="plots"), [note(remark) for remark in remarks]])


def warnings(contents: Contents) -> list[str]:
    """The first warnings of log.txt; empty without a log."""
    try:
        text, _ = contents.text(rundir.LOG, _LOG_BYTES, last=True)
    except UnusableError:
        return []
    found = re.findall(r"^\S+ \S+ (?:WARNING|ERROR) (.*)$", text, re.MULTILINE)
    more = [f"and {len(found) - _WARNINGS} more in {rundir.LOG}"] if len(found) > _WARNINGS else []
    return found[:_WARNINGS] + more


def file_text(contents: Contents, name: str, last: bool = False) -> Html:
    """A text file unchanged, folded."""
    text, remark = contents.text(name, _LOG_BYTES, last)
    return join([note(remark), folded(name, tag("pre", text, tabindex="0", aria_label=name))])


def facts(record: Mapping[str, Any], caption: str) -> Html:
    """A record as a table of two columns; groups as keys with dots."""
    rows = []
    for key, value in record.items():
        parts = value.items() if isinstance(value, dict) else [(None, value)]
        rows += [(f"{key}.{part}" if part is not None else key, _as_text(content)) for part, content in parts]
    return tag("div", table(caption, ("fact", "value"), rows), class_="prose")


def _as_text(value: Any) -> str:
    if isinstance(value, str):
        text = value
    elif isinstance(value, list) and all(isinstance(word, str) for word in value):
        text = " ".join(value)
    else:
        text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _LONG else text[:_LONG] + " ..."


def files(contents: Contents, held: Mapping[str, str]) -> Html:
    """The files of the directory with their content, by name."""
    rows = []
    for name, count in contents.files(rundir.PLOTS, rundir.PLUGINS):
        if name != REPORT:
            weight = Cell("") if name == OUTPUT else Cell(size(count), count)
            usual = "source of a plugin's module" if name.startswith(f"{rundir.PLUGINS}/") else ""
            usual = "a picture" if name.endswith(".png") else usual
            rows.append((link(name), held.get(name, usual), weight))
    return tag("div", table("Files of this directory", ("file", "content", "size"), rows), class_="prose")
