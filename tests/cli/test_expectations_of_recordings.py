"""Expectations belong to data: those of a simulation are not held against a recording, which may have its own."""

import hashlib
from pathlib import Path

import pandas as pd
import pytest

import estlab
from estlab.cli.main import main
from estlab.launch.arguments import prepared
from tests.conftest import ROOT, composed, options

pytestmark = pytest.mark.slow

KNOWN = {name: sets for name in options("experiment") if (sets := composed(f"+experiment={name}")["expect_files"])}
FOLDERS = {"epuck": "epuck", "field": "field", "landmark": "me469_ds1"}

SIMULATED = "the experiment's expectations apply to its simulation and were left out"
EPUCK = [
    "+experiment=epuck_smooth",
    "data=files",
    f"data.path={ROOT / 'data' / 'epuck'}",
    "plots=false",
    "report=false",
]


def held() -> list[tuple[str, bool]]:
    path = Path("runs/latest/expectations.csv")
    return list(pd.read_csv(path)[["expectation", "met"]].itertuples(index=False, name=None)) if path.exists() else []


@pytest.mark.parametrize("experiment", sorted(name for name in KNOWN if not name.startswith("sonar")))
def test_what_is_expected_of_a_real_recording_is_found(experiment, shared, capsys):
    """Of the long recording one experiment, the one with a filter of each kind, stands for all."""
    if experiment.startswith("landmark") and experiment != "landmark_dead_reckoning":
        pytest.skip("the long recording is run once, by landmark_dead_reckoning")
    folder = shared / FOLDERS[experiment.partition("_")[0]]
    prefix = ["data.prefix=ds1_"] if folder.name == "me469_ds1" else []
    words = [f"+experiment={experiment}", "data=files", f"data.path={folder}", *prefix, "plots=false", "report=false"]
    assert main(["run", *words]) == 0
    assert held() and all(met for _, met in held())
    assert f"{SIMULATED}; those of this recording apply" in " ".join(capsys.readouterr().out.split())


def test_every_set_is_of_a_file_that_there_is(shared):
    files = [path for folder in (shared, ROOT / "data") for path in folder.rglob("*") if path.is_file()]
    found = {hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    for experiment, sets in KNOWN.items():
        assert all(any(digest.startswith(key) for digest in found) for key in sets), experiment


def test_many_particles_find_the_robot_of_one_recording_again_and_again_and_few_do_not():
    """Document 000, IV b i, on the recording in the repository."""
    recording = {"data": "files", "data.path": ROOT / "data" / "sonar"}
    run = estlab.run(experiment="sonar_particles", runs=40, save=False, **recording)
    assert run.status == "ok"
    assert list(run.expectations["expectation"]) == ["found", "found"]


def test_of_an_unknown_recording_nothing_is_held_and_that_is_said(capsys):
    assert main(["run", *EPUCK]) == 0
    assert held() == []
    assert f"{SIMULATED}; this recording has none" in " ".join(capsys.readouterr().out.split())


def test_what_is_typed_holds_of_any_data(capsys):
    assert main(["run", *EPUCK, "expect.anis={max: 0}"]) == 1
    assert held() == [("anis", False)] * 3
    assert main(["verify", "epuck_smooth", *EPUCK[1:3], "expect.anis={min: 0}"]) == 0
    assert main(["verify", "epuck_smooth", *EPUCK[1:3]]) == 1
    assert "it has no expectations of this recording" in capsys.readouterr().out


def test_a_file_of_ones_own_has_expectations_of_its_recordings_too(tmp_path, capsys):
    digest = hashlib.sha256((ROOT / "data" / "epuck" / "XYData_cm.csv").read_bytes()).hexdigest()
    folder = tmp_path / "mine" / "experiment"
    folder.mkdir(parents=True)
    (folder / "mine.yaml").write_text(
        "# @package _global_\n# Is it so?\n# It is.\ndefaults:\n  - override /scenario: epuck\n"
        f"expect: {{anis: {{min: 1000}}}}\nexpect_files:\n  {digest[:12]!r}: {{anis: [0.1, 9], diverged: 0}}\n"
    )
    words = ["run", "--config-dir", str(folder.parent), "+experiment=mine", "filter=ekf", *EPUCK[1:]]
    assert main(words) == 0
    assert held() == [("anis", True), ("diverged", True)]
    assert main([*words, "expect.anis=null", "expect.diverged=1"]) == 1
    assert held() == [("diverged", False)]
    assert main([*words, "expect=null"]) == 0
    assert held() == []


def test_an_experiment_that_is_made_for_a_recording_keeps_what_it_expects(tmp_path):
    """Only data=files on the command line takes other data than the file's."""
    folder = tmp_path / "mine" / "experiment"
    folder.mkdir(parents=True)
    (folder / "mine.yaml").write_text(
        "# @package _global_\n# Is it so?\n# It is.\ndefaults:\n  - override /scenario: epuck\n"
        "  - override /data: files\n"
        f"data: {{path: {ROOT / 'data' / 'epuck'}}}\nexpect: {{diverged: 0}}\n"
    )
    assert main(["run", "--config-dir", str(folder.parent), "+experiment=mine", "plots=false", "report=false"]) == 0
    assert held() == [("diverged", True)]


def test_the_number_of_runs_of_an_experiment_is_of_its_simulation():
    assert prepared(["+experiment=radar_i", "data=files", "seed=2"])[:2] == ["expect=null", "runs=1"]
    assert prepared(["scenario=epuck", "data=files"]) == ["scenario=epuck", "data=files"]
