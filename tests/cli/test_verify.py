"""Expectations decide the exit code, of a run and of all experiments together."""

import json
from pathlib import Path

import pandas as pd
import pytest

import estlab.cli.verify
from estlab.cli.main import main
from estlab.filters.engine import CompiledLoop

pytestmark = pytest.mark.slow

TINY = ["scenario=landmark", "filter=ekf", "runs=3", "steps=12", "plots=false"]

EXPERIMENT = """\
# @package _global_
# Does it find what it says?
# {answer}
defaults:
  - override /scenario: landmark
  - override /filter: {filter}

runs: 3
steps: 12
"""


@pytest.fixture
def mine() -> list[str]:
    """A folder with experiments that meet, that miss, that cannot run and that expect nothing."""
    folder = Path("mine/experiment")
    folder.mkdir(parents=True)
    blocks = {
        "meets": "expect: {diverged: 0, rmse: {position: {max: 5.0}}}\n",
        "misses": "expect: {diverged: 0, anees: {ekf: [50.0, 60.0]}}\n",
        "breaks": "expect: {diverged: 0}\ndata: {source: files, path: nowhere}\n",
        "says_nothing": "",
    }
    for name, block in blocks.items():
        (folder / f"{name}.yaml").write_text(EXPERIMENT.format(answer=name, filter="ekf") + block)
    return ["--config-dir", "mine"]


def latest() -> Path:
    return Path("runs/latest").resolve()


def nothing_ran() -> bool:
    return not Path("runs").exists() or not any(Path("runs").iterdir())


def status() -> dict:
    return json.loads((latest() / "status.json").read_text())


def test_a_run_that_meets_its_expectations_is_ok_and_says_so(capsys):
    assert main(["run", *TINY, "expect.rmse.position=[0,5]", "expect.diverged.max=0", "expect.anees.ekf.min=0"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert [line.split()[:2] for line in out.splitlines()[-3:]] == [
        ["ekf", "rmse.position"], ["ekf", "diverged"], ["ekf", "anees"],
    ]  # fmt: skip
    assert all(line.rstrip().endswith("ok") for line in out.splitlines()[-3:])
    assert status()["status"] == "ok"
    metrics = pd.read_csv(latest() / "metrics.csv").set_index(["metric", "component"])["value"]
    table = pd.read_csv(latest() / "expectations.csv").set_index("expectation")
    assert list(table.columns) == ["filter", "expected", "found", "ci_low", "ci_high", "met"]
    assert table.loc["rmse.position", "found"] == metrics["rmse", "position"]
    assert table["met"].all()


def test_a_run_that_does_not_has_exit_code_1_all_its_files_and_says_what_was_found(capsys):
    assert main(["run", *TINY, "expect.rmse.position=[90,91]", "expect.diverged=0"]) == 1
    err = capsys.readouterr().err
    assert err.startswith("estlab: 1 of 2 expectations not met: rmse.position expected 90 to 91, found ")
    assert err.count("\n") == 1
    assert status()["status"] == "unmet"
    assert status()["error"] == err.removeprefix("estlab: ").rstrip()
    assert {"metrics.csv", "estimates.npz", "expectations.csv"} <= {path.name for path in latest().iterdir()}


def test_a_run_without_expectations_has_no_table_of_them(capsys):
    assert main(["run", *TINY]) == 0
    assert "expectation" not in capsys.readouterr().out
    assert not (latest() / "expectations.csv").exists()


def test_a_smoothed_set_is_held_like_a_filter(capsys):
    arguments = [*TINY, "smooth=true", "expect.rmse.position={max: 5}", "expect.rmse.x.ekf_smoothed={max: 5}"]
    assert main(["run", *arguments]) == 0
    table = pd.read_csv(latest() / "expectations.csv")
    assert list(zip(table["filter"], table["expectation"], strict=True)) == [
        ("ekf", "rmse.position"), ("ekf_smoothed", "rmse.position"), ("ekf_smoothed", "rmse.x"),
    ]  # fmt: skip


@pytest.mark.parametrize("none", ["expect=null", "expect={}", "~expect", "expect="])
def test_expectations_are_switched_off_by_one_word(none, mine):
    assert main(["run", *mine, "+experiment=misses", "plots=false"]) == 1
    assert main(["run", *mine, "+experiment=misses", "plots=false", none]) == 0


@pytest.mark.parametrize(
    "typed", ["expect.anees={min: 0}", "expect.anees.ekf=[0,9]", "+expect.anees.ekf={max: 9}", "expect={diverged: 0}"]
)
def test_what_is_typed_replaces_what_the_file_has(typed, mine):
    assert main(["run", *mine, "+experiment=misses", "plots=false", typed]) == 0


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        (["expect.rmse.x=[2,1]"], "expect.rmse.x: write the lower bound first, got [2, 1]"),
        (["expect.rmse.x.efk=1"], "there is no filter x or efk here; did you mean ekf? (one of ekf)"),
        (["expect=5"], "expect must be a group, as in expect.rmse.x=[0.1,0.2], or null for none; got 5"),
        (["expct.rmse.x=1"], "unknown key expct; did you mean expect?"),
        (
            ["expect.rmse=[0,1]", "expect.rmse.x=2"],
            "expect.rmse is a list here; replace it whole, as expect.rmse={x: 2}",
        ),
    ],
)
def test_a_mistake_in_an_expectation_is_said_before_anything_runs(typed, message, capsys):
    assert main(["run", *TINY, *typed]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
    assert nothing_ran()


def test_a_sweep_is_held_to_what_is_typed_and_not_to_the_experiments_file(mine):
    job = [*mine, "+experiment=misses", "plots=false"]
    for sweep in (["sweep", *job], ["run", *job, "-m"], ["run", *job, "hydra.mode=MULTIRUN"]):
        assert main(sweep) == 0
    assert not list(Path("runs").rglob("expectations.csv"))
    assert main(["sweep", *job, "filter.gate=null,0.9", "expect.diverged={min: 1}"]) == 1
    assert len(list(Path("runs").rglob("expectations.csv"))) == 2


def test_verify_runs_each_experiment_and_one_that_fails_stops_no_other(mine, capsys, monkeypatch):
    # The user's own alone: all that are shipped take minutes.
    monkeypatch.setattr(estlab.cli.verify, "conf_folder", lambda: Path("nothing_here"))
    assert main(["verify", *mine]) == 1
    out, err = capsys.readouterr()
    assert err == "estlab: some expectations are not met: 3 of 4 expectations met in 3 experiments; 1 run failed\n"
    lines = [line.split() for line in out.splitlines()]
    assert lines[0][:7] == ["1", "of", "3", "breaks", "failed:", "data.path:", "no"]
    assert lines[1][3:8] == ["meets", "2", "of", "2", "met,"]
    assert lines[2][3:8] == ["misses", "1", "of", "2", "met,"]
    assert lines[3] == ["experiment", "filter", "expectation", "expected", "found"]
    assert [(line[0], line[-1]) for line in lines[4:-1]] == [
        ("meets", "ok"), ("meets", "ok"), ("misses", "ok"), ("misses", "FAILED"), ("breaks", "FAILED"),
    ]  # fmt: skip
    folder = Path(out.split()[-1])
    assert {path.name for path in folder.iterdir()} == {"meets", "misses", "breaks"}
    assert json.loads((folder / "misses" / "status.json").read_text())["status"] == "unmet"
    assert not list(folder.rglob("plots")) and not list(folder.rglob("report.html"))
    command = json.loads((folder / "meets" / "run.json").read_text())["command"]
    assert command == ["estlab", "run", "--config-dir", "mine", "+experiment=meets", "plots=false", "report=false"]


def test_verify_of_a_named_experiment_with_keys_of_ones_own(mine, capsys):
    assert main(["verify", "meets", *mine, "seed=2", "output=elsewhere"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "2 of 2 expectations met in 1 experiment: elsewhere/" in out
    assert main(["verify", "misses", *mine, "expect.anees=null"]) == 0
    assert main(["verify", "says_nothing", *mine, "expect.diverged=0"]) == 0
    assert main(["verify", "says_nothing", *mine]) == 1
    assert "it has no expectations" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["smok"], "there is no experiment smok; did you mean smoke? (see estlab list experiments)"),
        (["smoke", "rnus=2"], "unknown key rnus; did you mean runs?"),
        (["smoke", "runs=0"], "runs must be from 1 to 1e9, got 0"),
        (["smoke", "-m"], "estlab verify has no -m (see estlab verify --help)"),
        (["--config-dir"], "--config-dir takes a folder of configuration (see"),
        (["--config-dir=nowhere"], "--config-dir takes a folder of configuration, got 'nowhere'"),
        (["+experiment=smoke"], "+experiment=smoke: estlab verify sets the experiment and the run's directory itself"),
        (["smoke", "hydra.run.dir=here"], "hydra.run.dir=here: estlab verify sets the experiment"),
        (["expect=null"], "expect=null leaves nothing to verify"),
    ],
)
def test_a_mistake_to_verify_is_one_line_and_leaves_nothing(arguments, message, capsys):
    assert main(["verify", *arguments]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
    assert nothing_ran()


def test_verify_is_interrupted_like_a_run(mine, monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(CompiledLoop, "estimate", interrupted)
    assert main(["verify", "meets", *mine]) == 130
    assert capsys.readouterr().err == "estlab: interrupted\n"
    assert status()["status"] == "interrupted"


def test_verify_says_what_it_does_and_is_completed(monkeypatch, capsys):
    assert main(["verify", "--help"]) == 0
    assert "Runs every experiment whose file has an expect block" in capsys.readouterr().out
    for line, expected in (("estlab verify car_e", {"car_ekf"}), ("estlab verify car_ekf smoke se", {"seed="})):
        monkeypatch.setenv("COMP_LINE", line)
        assert main(["-sc", "query=bash"]) == 0
        assert set(capsys.readouterr().out.split()) == expected
