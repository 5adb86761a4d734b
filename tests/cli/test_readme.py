"""What the README shows is true."""

import re
import sys

import pytest

from estlab.cli.main import main
from tests.conftest import ROOT

README = (ROOT / "README.md").read_text()


def block(name: str) -> str:
    return re.search(rf"<!-- {re.escape(name)} -->\n```\w*\n(.*?)```", README, re.DOTALL)[1]


def test_the_main_command_prints_what_the_readme_shows(capsys):
    shown = re.search(r"\$ estlab run scenario=car filter=ukf\n(.*?)```", README, re.DOTALL)[1].splitlines()
    assert main(["run", "scenario=car", "filter=ukf", "plots=false"]) == 0
    printed = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert len(printed) == len(shown)
    for found, expected in zip(printed[:-1], shown[:-1], strict=True):  # all but the directory's name
        words = re.sub(r"[\d.]+", "#", found).split()
        assert words == re.sub(r"[\d.]+", "#", expected).split()
        # Another processor rounds its sines another way, and a filter near losing its way magnifies that.
        numbers = [[float(x) for x in re.findall(r"\d+\.?\d*", line)] for line in (found, expected)]
        assert numbers[0] == pytest.approx(numbers[1], rel=0.05)


def test_the_expectations_of_the_readme_are_met_or_not_as_it_shows(capsys):
    example = re.search(r"\$ estlab (run [^\n]* expect\.[^\n]*)\n\[\.\.\.\]\n(.*?)```", README, re.DOTALL)
    assert main([*example[1].split(), "plots=false"]) == 1
    printed = capsys.readouterr()
    shown = example[2].splitlines()
    found = [*printed.out.splitlines()[-len(shown) + 1 :], printed.err]
    for line, expected in zip(found, shown, strict=True):
        assert re.sub(r"[\d.]+", "#", line).split() == re.sub(r"[\d.]+", "#", expected).split()
        numbers = [[float(x) for x in re.findall(r"\d+\.?\d*", text)] for text in (line, expected)]
        assert numbers[0] == pytest.approx(numbers[1], rel=0.05)


def test_the_scenario_of_the_readme_works_as_printed(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry])  # as for an installed command
    (tmp_path / "conf/scenario").mkdir(parents=True)
    (tmp_path / "pendulum.py").write_text(block("pendulum.py"))
    (tmp_path / "conf/scenario/pendulum.yaml").write_text(block("pendulum.yaml"))
    command = re.search(r"Then, in that folder,\s+`estlab (run --config-dir conf [^`]*)`", README)[1].split()
    try:
        assert main([*command, "runs=60", "plots=false"]) == 0
        found = re.search(r"^NEES / n +\S+ +(\S+) to (\S+) ", capsys.readouterr().out, re.MULTILINE)
        assert float(found[1]) < 1.05
        assert float(found[2]) > 0.95
        assert main([*command, "runs=2", "steps=20", "filter=ukf", "plots=false"]) == 0
        assert "undecided" not in capsys.readouterr().out
    finally:
        sys.modules.pop("pendulum", None)
    assert main([*command[:-2], "filter=ekf"]) == 2
    assert "pendulum.Pendulum is refused" in capsys.readouterr().err


def test_ci_runs_the_readmes_own_test_command():
    command = block("test")
    assert command == 'python3 -m venv .venv && .venv/bin/pip install -e ".[dev]" && .venv/bin/pytest\n'
    assert "README.md" in (ROOT / ".ci/run").read_text()


def test_the_keys_that_the_readme_names_exist():
    from estlab.config.build import key_paths
    from tests.conftest import composed

    known = {*key_paths(composed()), *key_paths(composed("scenario=landmark"))}
    section = README.split("## Configuration")[1].split("## The run directory")[0]
    named = {
        key for row in re.findall(r"^\| (`.*?) \|", section, re.MULTILINE) for key in re.findall(r"`([\w.]+)`", row)
    }
    assert len(named) > 15
    assert named - known == {"hydra.run.dir"}
