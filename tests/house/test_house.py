"""The rules of the house, each by the tool that knows it."""

import re
import subprocess
import sys
from collections import Counter, defaultdict
from pathlib import Path

import pytest

from tests.conftest import ROOT

CHECKS = {
    "format": ["ruff", "format", "--check", "."],
    "lint": ["ruff", "check", "."],
    "types": ["mypy"],
    "imports": ["lint-imports"],
}


@pytest.mark.parametrize("check", CHECKS)
def test_the_house_is_in_order(check):
    tool, *arguments = CHECKS[check]
    command = [str(Path(sys.executable).parent / tool), *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}{done.stderr}"


def test_no_file_is_too_large_to_read():
    long = {p.name: n for p in (ROOT / "estlab").rglob("*.py") if (n := len(p.read_text().splitlines())) > 300}
    assert not long, "a file over 300 lines must be divided"


def test_a_module_is_named_once_and_the_table_of_rooms_names_it():
    names = Counter(path.stem for path in (ROOT / "estlab").rglob("*.py") if not path.stem.startswith("__"))
    assert [name for name, count in names.items() if count > 1] == []
    rooms = (ROOT / "docs" / "design.md").read_text().partition("## Rooms")[2].partition("\n## ")[0]
    assert sorted(set(names) - set(re.findall(r"\w+", rooms))) == [], "docs/design.md, Rooms"


def test_a_public_class_is_named_once():
    homes = defaultdict(list)
    for path in (ROOT / "estlab").rglob("*.py"):
        for name in re.findall(r"^class ([A-Z]\w*)", path.read_text(), re.MULTILINE):
            homes[name].append(str(path.relative_to(ROOT)))
    assert {name: paths for name, paths in homes.items() if len(paths) > 1} == {}
