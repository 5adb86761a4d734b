"""A page read strictly: what is open is closed, what is named is there, and nothing comes from elsewhere."""

import base64
import hashlib
import re
from html.parser import HTMLParser

_VOID = {"img", "meta", "link", "br", "input"}
_ELEMENTS = {"html", "head", "title", "style", "body", "header", "nav", "main", "section", "h1", "h2", "p", "span"}
_ELEMENTS |= {"strong", "code", "pre", "ul", "li", "a", "script", "div", "table", "caption", "thead", "tbody", "tr"}
_ELEMENTS |= {"th", "td", "figure", "figcaption", "details", "summary"}


class Page(HTMLParser):
    """elements: (name, attributes) in their order. texts: of each element's name. tables: by caption, rows of cells."""

    def __init__(self, markup: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict]] = []
        self.texts: dict[str, list[str]] = {}
        self.tables: dict[str, list[list[tuple[str, str | None]]]] = {}
        self._open: list[str] = []
        self._caption = ""
        assert markup.startswith("<!doctype html>\n")
        self.feed(markup)
        self.close()
        assert not self._open, f"left open: {self._open}"
        self._check()

    def handle_starttag(self, name, attributes):
        assert name in _ELEMENTS | _VOID, f"<{name}> is none of ours"
        assert len(dict(attributes)) == len(attributes), f"<{name}> has an attribute twice: {attributes}"
        self.elements.append((name, dict(attributes)))
        if name in _VOID:
            return
        self._open.append(name)
        self.texts.setdefault(name, []).append("")
        if name == "table":
            self._caption = ""
        elif name == "tr":
            self.tables.setdefault(self._caption, []).append([])
        elif name in ("td", "th"):
            self.tables[self._caption][-1].append(("", dict(attributes).get("data-number")))

    def handle_endtag(self, name):
        assert self._open and self._open.pop() == name, f"</{name}> closes nothing"

    def handle_data(self, data):
        for name in dict.fromkeys(self._open):
            self.texts[name][-1] += data
        if "caption" in self._open:
            self._caption += data
        elif {"td", "th"} & set(self._open):
            row = self.tables[self._caption][-1]
            row[-1] = (row[-1][0] + data, row[-1][1])

    def _check(self):
        ids = [given["id"] for _, given in self.elements if "id" in given]
        assert len(ids) == len(set(ids)), "an id twice"
        for name, given in self.elements:
            assert not any(key.startswith("on") or key == "style" for key in given), f"<{name} {given}>"
            assert given.get("aria-labelledby", ids[0]) in ids
            target = given.get("href", "")
            assert target.startswith(("#", "./")) or target in ("", "data:,"), target
            assert not target.startswith("#") or target[1:] in ids, target
            assert given.get("src", "data:image/png;base64,").startswith("data:image/png;base64,")
            assert name != "img" or given["alt"]
        (policy,) = (g["content"] for n, g in self.elements if g.get("http-equiv") == "Content-Security-Policy")
        assert policy.startswith("default-src 'none'; ") and "unsafe" not in policy
        for kind in ("script", "style"):
            (content,) = self.texts[kind]
            fingerprint = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
            assert f"{kind}-src 'sha256-{fingerprint}'" in policy
            assert not re.search(r"https?:|//\w|url\(|@import|fetch|innerHTML", content.replace("// ", ""))
