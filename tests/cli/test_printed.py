"""What a terminal shows of names and messages, whoever gave them: no control character reaches it."""

import csv
import io
import json
import re
import shutil
from pathlib import Path

import pytest

from estlab.cli.main import main
from estlab.report import terminal
from estlab.report.console import console
from tests.cli.finished import edit, made
from tests.cli.sweeping import TINY

STEER = "\x1b[31m\x07\x9b2J\u202eevil"
UNSEEN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return made(tmp_path_factory.mktemp("printed") / "run", "filter=ekf")


def test_names_in_a_run_directory_do_not_steer_the_terminal(run, capsys):
    """Of its folder, of its metrics and filters, in its status: through every command that prints them."""
    place = Path(f"runs/{STEER}")
    shutil.copytree(run, place)
    table = (place / "metrics.csv").read_text().replace("ekf,", f"{STEER},").replace(",nees_", f",{STEER}_")
    (place / "metrics.csv").write_text(table.replace("m,", f"{STEER},"))
    shutil.copytree(place, "runs/failed")
    edit(Path("runs/failed/status.json"), status="failed", error=STEER)
    (Path("runs/failed") / "expectations.csv").unlink(missing_ok=True)
    for command in (
        ["report", str(place)],
        ["report", str(place / "nothing")],
        ["compare", str(place)],
        ["compare", "runs", "--csv", "-"],
        ["compare", "runs", "--md"],
        ["compare", "runs", "--latex"],
        ["clean", "--failed"],
        ["rerun", str(place / "nothing")],
        ["run", f"seed={STEER}"],
        ["run", f"{STEER}=1"],
        ["list", STEER],
        [STEER],
    ):
        main(command)
        out, err = capsys.readouterr()
        assert not UNSEEN.search(out + err), command
    assert main(["compare", str(place), "--csv", "table.csv"]) == 0
    assert not UNSEEN.search(Path("table.csv").read_text())


def test_names_and_errors_in_a_sweep_do_not_steer_the_terminal(capsys):
    place = f"swept{STEER}"
    words = [*TINY, "plots=false", "filter=ekf", "seed=1,2", f"sweep.dir={place}"]
    assert main(["sweep", *words]) == 0
    job = Path(place) / "0_landmark_ekf"
    metrics = (job / "metrics.csv").read_text()
    (job / "metrics.csv").write_text(metrics.replace("ekf,", f"{STEER},"))
    edit(Path(place) / "1_landmark_ekf" / "status.json", status="failed", error=STEER, exit_code=1)
    assert main(["sweep", *words, "sweep.dry_run=true"]) == 0
    assert main(["sweep", "--resume", place]) == 0
    assert main(["report", place]) == 0
    out, err = capsys.readouterr()
    assert not UNSEEN.search(out + err)


def test_the_console_keeps_its_own_signs_and_lines(capsys):
    console().print(f"one\ntwo {STEER}", markup=False)
    assert capsys.readouterr().out == "one\ntwo �[31m�2J�evil\n"


def test_a_table_as_csv_is_still_one(run, capsys):
    assert main(["compare", str(run), "--csv", "-"]) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert [row["filter"] for row in rows] == ["ekf"]
    assert json.loads(rows[0]["rmse.position"]) > 0.0


def test_tables_that_cannot_be_printed_lose_neither_verdict_nor_path(monkeypatch, capsys):
    def broken(*_) -> None:
        raise ZeroDivisionError("nothing")

    monkeypatch.setattr(terminal, "_tests", broken)
    assert main(["run", "scenario=field", "filter=ekf", "runs=2", "steps=5", "plots=false", "report=false"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "ekf is consistent as far as its innovations tell: " in "\n".join(lines)
    assert "note: missing: tables on the terminal (ZeroDivisionError: nothing); the traceback is in log.txt" in lines
    assert lines[-1].startswith("runs/")
