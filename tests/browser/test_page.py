"""The page in a real browser: no error, no request, readable, sorted and filtered by hand."""

import re
from pathlib import Path

import pytest

from estlab.cli.main import main
from tests.browser import chromium
from tests.cli.test_report import EVIL, sweep

pytestmark = pytest.mark.slow

WIDTHS, SCHEMES = (1280, 380), (False, True)

CONTRAST = """
(() => {
  const numbers = (colour) => colour.match(/[\\d.]+/g).map(Number);
  const light = (colour) => {
    const linear = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
    const [r, g, b] = numbers(colour).map((c) => linear(c / 255));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ground = (element) => {
    for (let at = element; at; at = at.parentElement) {
      const colour = getComputedStyle(at).backgroundColor;
      if (!/, 0\\)$|transparent/.test(colour)) return colour;
    }
    return "rgb(255, 255, 255)";
  };
  const poor = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  let seen = 0;
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    if (!walker.currentNode.data.trim() || element.tagName === "SCRIPT" || !element.checkVisibility()) continue;
    const [a, b] = [light(getComputedStyle(element).color), light(ground(element))].sort((x, y) => y - x);
    seen += 1;
    if ((a + 0.05) / (b + 0.05) < 4.5) poor.push(element.tagName + ": " + walker.currentNode.data);
  }
  return { seen, poor };
})()
"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    program = chromium.found()
    if program is None:
        pytest.skip("there is no Chromium or Chrome on this machine")
    tab = chromium.Chromium(program, tmp_path_factory.mktemp("profile"))
    yield tab
    tab.close()


@pytest.fixture(scope="module")
def pages(tmp_path_factory) -> dict[str, Path]:
    """A run of two filters, a run that failed, and a sweep."""
    root = tmp_path_factory.mktemp("pages")
    tiny = ["runs=20", "steps=15", f"output={root}"]
    field = ["scenario=field", "filter=[ekf,dead_reckoning]", f"hydra.run.dir={root}/several"]
    assert main(["run", *field, *tiny]) == 0
    assert main(["run", "expect.rmse.x.max=0", "plots=false", f"hydra.run.dir={root}/failed", *tiny]) == 1
    assert (
        main(["report", str(sweep(root / "swept", {"0_car_ekf": "ok", "1_car_ekf": "failed", "2_car_ekf": "left"}))])
        == 0
    )
    return {name: root / name / "report.html" for name in ("several", "failed", "swept")}


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("dark", SCHEMES, ids=("light", "dark"))
@pytest.mark.parametrize("name", ("several", "failed", "swept"))
def test_a_page_shows_without_error_request_or_poor_contrast(browser, pages, name, width, dark):
    browser.show(pages[name], width, dark)
    assert browser.complaints() == []
    assert browser.requests() == [pages[name].resolve().as_uri()]
    assert browser.run("document.documentElement.scrollWidth <= innerWidth"), "tables scroll in boxes of their own"
    found = browser.run(CONTRAST)
    assert found["seen"] > 50 and found["poor"] == []
    ground = browser.run("getComputedStyle(document.body).backgroundColor")
    assert (sum(map(int, re.findall(r"\d+", ground))) < 200) == dark
    assert browser.run(
        "[...document.querySelectorAll('figure img')].every((image) => image.complete && image.naturalWidth > 100)"
    )


def column(browser, table: str, number: int) -> list[str]:
    cells = f"[...document.querySelectorAll('{table} tbody tr')].map((row) => row.cells[{number}]"
    return browser.run(f"{cells}.dataset.number ?? row.cells[{number}].textContent)")


def test_a_column_is_sorted_by_click_and_by_keyboard_as_numbers_with_the_empty_last(browser, pages):
    browser.show(pages["several"])
    heading = "document.querySelectorAll('#metrics th button')[4]"
    before = column(browser, "#metrics", 4)
    browser.run(f"{heading}.click()")
    numbers = [float(cell) for cell in column(browser, "#metrics", 4) if cell]
    assert numbers == sorted(numbers) and len(numbers) > 30
    assert browser.run(f"{heading}.closest('th').getAttribute('aria-sort')") == "ascending"
    browser.run(f"{heading}.focus()")
    browser.press("Enter")
    downward = column(browser, "#metrics", 4)
    assert [float(cell) for cell in downward if cell] == numbers[::-1]
    assert not any(downward[len(numbers) :]), "empty cells last both ways"
    assert sorted(downward) == sorted(before), "no row is lost"
    browser.run("document.querySelector('#metrics th button').click()")
    assert browser.run("document.querySelectorAll('#metrics [aria-sort]').length") == 1


def test_rows_are_filtered_by_words_typed(browser, pages):
    browser.show(pages["several"])
    browser.run("document.querySelector('#metrics input').focus()")
    browser.ask("Input.insertText", text="RMSE position ekf")
    shown = browser.run(
        "[...document.querySelectorAll('#metrics tbody tr')].filter((row) => !row.hidden).map((row) => row.innerText)"
    )
    assert [row.split()[:3] for row in shown] == [["ekf", "rmse", "position"], ["ekf", "rmse_converged", "position"]]
    assert browser.run("document.querySelector('#metrics [role=status]').textContent").startswith("2 of ")


def test_a_plot_is_enlarged_and_closed_by_keyboard(browser, pages):
    browser.show(pages["several"], 380)
    browser.run("document.querySelector('.enlarge').focus()")
    browser.press("Enter")
    assert browser.run("document.querySelector('dialog').open")
    assert browser.run("document.querySelector('dialog img').getBoundingClientRect().width") > 380
    browser.press("Escape")
    assert not browser.run("document.querySelector('dialog').open")
    assert browser.run("document.activeElement.className") == "enlarge", "the focus is where it was"
    assert browser.complaints() == []


def test_markup_of_a_stranger_does_nothing_and_the_policy_would_stop_it(browser, pages, tmp_path):
    browser.show(pages["swept"])
    assert EVIL in browser.run("document.body.innerText")
    assert browser.run("window.pwned") is None
    planted = tmp_path / "planted.html"
    planted.write_text(pages["swept"].read_text().replace("<main", f"<p>{EVIL}</p><main", 1))
    browser.show(planted)
    assert browser.run("window.pwned") is None, "even if it got into the page unescaped"
    assert any("Content Security Policy" in said for said in browser.complaints())


def test_printed_it_is_whole(browser, pages):
    browser.show(pages["several"])
    browser.run("window.dispatchEvent(new Event('beforeprint'))")
    browser.ask("Emulation.setEmulatedMedia", media="print")
    cut = "[...document.querySelectorAll('.box, pre')].filter((box) => box.scrollHeight > box.clientHeight + 1).length"
    assert browser.run(cut) == 0
    assert browser.run("[...document.querySelectorAll('details')].every((part) => part.open)")
    browser.ask("Emulation.setEmulatedMedia", media="")
