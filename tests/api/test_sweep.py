"""Sweeps in a process of their own, and their directories as objects."""

import contextlib
import io
import os
import signal
import threading
import time
from pathlib import Path

import pandas as pd
import pytest

import estlab
from estlab.cli.main import main

pytestmark = pytest.mark.slow

TINY = {"scenario": "landmark", "runs": 3, "steps": 5}


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """A sweep with two jobs that fail, and what was printed meanwhile."""
    place = tmp_path_factory.mktemp("swept") / "it's one"
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        found = estlab.sweep("filter=ekf,ukf", "filter.gate=0.9,2.0", **TINY, sweep={"dir": place})
    return found, printed.getvalue()


def test_a_sweep_runs_quietly_and_its_tables_have_numbers_where_its_files_do(swept):
    found, printed = swept
    assert printed == ""
    assert found.path.name == "it's one"
    there = pd.read_csv(found.path / "sweep.csv")
    assert list(found.table) == list(there)
    assert list(found.table["filter.gate"]) == [0.9, 2.0] * 2
    assert list(found.table["status"]) == ["ok", "failed"] * 2
    assert found.table["rmse.position"].equals(there["rmse.position"])
    assert found.groups.empty
    assert found.failures["error"].str.startswith("filter.gate must ").all()
    assert repr(found) == f"Sweep(4 jobs: 2 ok, 2 failed; {found.path})"
    assert "<table" in found._repr_html_()


def test_each_job_of_a_sweep_is_a_run(swept):
    found, _ = swept
    assert list(found) == ["0_landmark_ekf", "1_landmark_ekf", "2_landmark_ukf", "3_landmark_ukf"]
    assert found["0_landmark_ekf"].metrics["value"].iloc[0] == found.table["rmse.x"].iloc[0]
    with pytest.raises(estlab.UserError, match=r"1_landmark_ekf: has no result \(failed: filter.gate must "):
        _ = found["1_landmark_ekf"]
    with pytest.raises(KeyError, match="9_landmark_ekf"):
        _ = found["9_landmark_ekf"]
    with pytest.raises(estlab.UserError, match="not the directory of a finished sweep"):
        estlab.Sweep(found.path / "0_landmark_ekf")


def test_a_comparison_has_the_lines_that_the_command_writes(swept):
    place = swept[0].path
    with pytest.warns(UserWarning, match="failed") as warned:
        found = swept[0].compare(metrics=["rmse.position"], against=2)
    assert len(warned) == 2
    assert main(["compare", str(place), "--metric", "rmse.position", "--against", "2", "--csv", "compared.csv"]) == 0
    there = pd.read_csv("compared.csv")
    assert list(found) == list(there)
    assert list(found["label"]) == ["ekf", "ukf"] == list(there["label"])
    for name in ("rmse.position", "difference.position"):
        assert found[name].astype(float).equals(there[name])
    with pytest.raises(estlab.UserError, match="5"):
        estlab.compare(place / "0_landmark_ekf", against="5")


def test_what_is_wrong_with_a_sweep_is_raised_in_one_line(capfd):
    with pytest.raises(estlab.UserError) as error:
        estlab.sweep("filter=ekf,ukff", **TINY)
    assert str(error.value).startswith("there is no filter ukff")
    assert "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")


def test_an_interruption_ends_a_sweep_in_order(tmp_path):
    place = tmp_path / "swept"

    def interrupt():
        while not list(place.glob("*/status.json")):
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        estlab.sweep("filter=ukf", "seed=range(1,30)", scenario="car", runs=100, sweep={"dir": place})
    signal.signal(signal.SIGINT, before)
    thread.join()
    states = list(estlab.runs(place)["status"])
    assert "running" not in states
    assert len(states) < 29
    assert (Path(place) / "sweep.csv").is_file()
