"""The documents as a person reads them in an editor or a terminal."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import ROOT

WIDTH = 100
PAGES = ["README.md", "CONTRIBUTING.md", *(str(path.relative_to(ROOT)) for path in sorted(ROOT.glob("docs/**/*.md")))]
# Commands, figures and links that are one word to a reader cannot be divided.
WORD = re.compile(r"`[^`]*`|!?\[[^]]*]\([^)]*\)|\S+")


def prose(text: str) -> Iterator[tuple[int, str]]:
    """Each line of running text with its number: no code, table, heading, picture or comment."""
    code = False
    for number, line in enumerate(text.splitlines(), 1):
        code ^= line.lstrip().startswith("```")
        if not code and not line.startswith(("```", "    ", "|", "#", "![", "<!--")):
            yield number, line


@pytest.mark.parametrize("page", PAGES)
def test_prose_is_wrapped_where_a_line_can_be_read(page):
    text = (ROOT / page).read_text()
    wide = [f"{page}:{number}" for number, line in prose(text) if len(line) > WIDTH and len(WORD.findall(line)) > 1]
    assert wide == [], f"wrap these at {WIDTH} columns"


def headings(path: Path) -> set[str]:
    """The anchors of a page's headings, as a code host makes them."""
    found = re.findall(r"^#+ (.*)$", path.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in found}


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_to_files_and_headings_that_exist(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", (ROOT / page).read_text()):
        file, _, anchor = target.partition("#")
        if "://" in target:
            continue
        path = (ROOT / page).parent / file if file else ROOT / page
        assert path.exists(), f"{page}: {target}"
        assert not anchor or anchor in headings(path), f"{page}: {target}"
