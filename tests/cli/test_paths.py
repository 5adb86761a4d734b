"""Folders of any name: as data, as output, as a sweep's, in what is printed to be pasted, and again from there."""

import contextlib
import io
import json
import shlex
import shutil
from pathlib import Path

import pytest

from estlab.cli.main import main
from estlab.launch.quoting import quoted
from tests.cli.sweeping import TINY, status, table
from tests.conftest import ROOT

STRANGE = 'my run, v=2 [a] {b} it\'s "c" $x #1:2 \\ ä日'
QUIET = ("plots=false", "report=false")


@pytest.fixture
def data():
    """A recording in such a folder."""
    shutil.copytree(ROOT / "data" / "landmark", STRANGE)
    return STRANGE


def printed(*words: str) -> str:
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        assert main(list(words)) == 0
    return out.getvalue()


def test_a_run_reads_from_and_writes_to_such_folders_and_runs_again(data, monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path / f"home {STRANGE}"))
    words = ["scenario=landmark", "filter=ekf", "data=files", f"data.path={data}", "steps=9", *QUIET]
    printed("run", *words, f"output=~/{STRANGE}")
    (folder,) = (tmp_path / f"home {STRANGE}" / STRANGE).glob("*/*_landmark_ekf")
    assert not Path("~").exists()
    assert json.loads((folder / "run.json").read_text())["command"][-1] == f"output=~/{STRANGE}"
    printed("run", *words, f"hydra.run.dir={STRANGE}/again")
    assert status(f"{STRANGE}/again")["status"] == "ok"
    said = printed("rerun", f"{STRANGE}/again", f"data.path={data}", f"hydra.run.dir=~/{STRANGE}/third")
    assert "identical to the last bit" in said
    assert status(tmp_path / f"home {STRANGE}" / STRANGE / "third")["status"] == "ok"


def test_a_sweep_over_and_in_such_folders_is_resumed(data):
    shutil.copytree(data, "plain")
    words = ["scenario=landmark", "filter=ekf", "data=files", "steps=9", *QUIET]
    place = f"swept {STRANGE}"
    assert main(["sweep", *words, f"data.path=plain,{quoted(data)}", f"sweep.dir={place}"]) == 0
    before = table(place)
    assert [row["data.path"] for row in before] == ["plain", data]
    shutil.rmtree(Path(place) / "1_landmark_ekf")
    assert main(["sweep", "--resume", place]) == 0
    assert table(place) == before


def test_the_best_of_a_tuning_can_be_pasted(data):
    pytest.importorskip("optuna")
    words = ["filter=ekf", "data=files", f"data.path={data}", "scenario=landmark", "steps=9", *QUIET]
    tuned = ["hydra/sweeper=optuna", "sweep.trials=1", "noise.filter.process_scale=interval(1,2)"]
    said = printed("sweep", *words, *tuned, f"sweep.dir=tuned {STRANGE}")
    (best,) = [line.removeprefix("best: ") for line in said.splitlines() if line.startswith("best: ")]
    command = shlex.split(best)
    assert f"data.path={data}" in command
    printed(*command[1:], *QUIET)


def test_parts_of_a_job_lie_in_such_folders():
    words = [*TINY, "filter=ekf", "block_runs=1", "keep_runs=1", "sweep.split_runs=2", *QUIET]
    assert main(["sweep", *words, f"sweep.dir=in {STRANGE}"]) == 0
