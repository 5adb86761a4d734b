"""A run made again from its directory: the same to the last bit, or what is not; and nothing of a stranger's runs."""

import json
import re
import shutil
import sys
from pathlib import Path

import pandas as pd
import pytest
import yaml

from estlab.cli.main import main
from tests.cli.finished import edit, made

pytestmark = pytest.mark.slow

PENDULUM = """
from pathlib import Path
from estlab.scenarios.landmark import Landmark
Path("ran").touch()
class Mine(Landmark):
    pass
"""


@pytest.fixture(scope="module")
def original(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("original")
    return made(folder / "run", "filter=[ukf,pf]", "filters.pf.particles=30", "smooth=false", "expect.diverged.max=12")


@pytest.fixture(autouse=True)
def _in_a_folder_with(original, _in_an_empty_folder):
    shutil.copytree(original, "runs/day/run")
    Path("runs/latest").symlink_to("day/run")


def configure(**changes: object) -> None:
    file = Path("runs/day/run/config.yaml")
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | changes, sort_keys=False))


def newest() -> Path:
    return Path("runs/latest").resolve()


def test_what_an_engine_of_before_found_is_found_again(capsys):
    configure(engine="numba")
    assert main(["rerun", "runs/latest"]) == 0
    assert "identical to the last bit" in capsys.readouterr().out
    assert yaml.safe_load((newest() / "config.yaml").read_text())["engine"] == "auto"


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("cores=0", "cores=0: write an integer from 1"),
        ("cores=\u0663", "write an integer from 1"),
        ("cores=" + "9" * 100, "write an integer from 1"),
        ("output=", "output=: output needs a value"),
        ("plugins=[no_such_package]", "estlab: plugins: Python finds no package 'no_such_package'"),
    ],
)
def test_what_is_typed_wrongly_is_not_said_of_the_runs_files(word, said, capsys):
    assert main(["rerun", "runs/latest", word]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert "config.yaml" not in err


def test_a_run_made_again_is_the_same_to_the_last_bit_and_keeps_what_was_typed(capsys):
    assert main(["rerun", "runs/latest"]) == 0
    out = capsys.readouterr().out
    assert "the figures equal those of runs/day/run: identical to the last bit" in out
    assert newest().name.endswith("_landmark_ukf-pf")
    for name in ("overrides.yaml", "metrics.csv", "runs.csv", "errors.csv", "nees.csv"):
        assert (newest() / name).read_bytes() == Path("runs/day/run", name).read_bytes()
    one, other = (yaml.safe_load((folder / "config.yaml").read_text()) for folder in (newest(), Path("runs/day/run")))
    assert one == other | {"output": "runs"}
    facts = json.loads((newest() / "run.json").read_text())
    assert facts["rerun_of"] == str(Path("runs/day/run").resolve())
    assert facts["command"] == ["estlab", "rerun", "runs/latest"]
    assert main(["rerun", str(newest()), "hydra.run.dir=third"]) == 0
    assert "identical to the last bit" in capsys.readouterr().out
    assert Path("third/status.json").exists()


@pytest.mark.parametrize(
    ("factor", "code", "said"), [(1 + 1e-13, 0, "to 1e-12"), (1 + 1e-10, 0, "to 1e-9"), (1.001, 1, "")]
)
def test_a_figure_that_differs_is_told_by_how_much_and_in_which_table(factor, code, said, capsys):
    file = Path("runs/day/run/metrics.csv")
    metrics = pd.read_csv(file)
    at = metrics.index[(metrics["filter"] == "pf") & (metrics["metric"] == "anees")][0]
    metrics.loc[at, "value"] *= factor
    metrics.to_csv(file, index=False)
    edit(file.parent / "run.json", estlab="0.0.1", packages={"numpy": "1.0"})
    assert main(["rerun", "runs/day/run"]) == code
    out, err = capsys.readouterr()
    assert re.search(r"^changed: estlab 0\.0\.1 before, \S+ now; numpy 1\.0 before, \S+ now", out, re.MULTILINE)
    if said:
        assert f"identical {said}" in out
    else:
        line = re.search(r"^metrics.csv +pf anees all value +(\S+) +(\S+) +(\S+)$", out, re.MULTILINE)
        assert float(line[1]) == pytest.approx(float(line[2]) * factor, rel=1e-8)
        assert 0.0 < float(line[3]) < 1.1e-3
        assert err == "estlab: the figures differ from those of runs/day/run\n"


def test_missing_lines_arrays_and_files_are_differences_or_said(capsys):
    file = Path("runs/day/run/nees.csv")
    file.write_text("".join(file.read_text().splitlines(keepends=True)[:-1]))
    assert main(["rerun", "runs/day/run"]) == 1
    assert re.search(r"nees.csv +49 lines of 8 columns, now 50 of 8 .* inf", capsys.readouterr().out)
    Path("runs/day/run/estimates.npz").write_bytes(b"PK")
    assert main(["rerun", "runs/day/run"]) == 1
    said = "estlab: the figures cannot be compared: runs/day/run/estimates.npz: is not an archive of a run\n"
    assert capsys.readouterr().err == said


def test_a_run_that_was_not_whole_is_run_and_compared_with_nothing(capsys):
    edit(Path("runs/day/run/status.json"), status="interrupted", error="by the user")
    assert main(["rerun", "runs/day/run"]) == 1
    assert "there will be nothing to compare with: runs/day/run has no complete result" in capsys.readouterr().err
    assert json.loads((newest() / "status.json").read_text())["status"] == "ok"


@pytest.mark.parametrize("plugins", [[], ["mine"]])
def test_a_strangers_own_plugins_do_not_count_and_nothing_of_them_is_imported(plugins, capsys):
    Path("mine.py").write_text(PENDULUM)
    scenario = yaml.safe_load(Path("runs/day/run/config.yaml").read_text())["scenario"]
    configure(scenario=scenario | {"_target_": "mine.Mine"}, plugins=plugins)
    before = set(Path("runs/day").iterdir())
    assert main(["rerun", "runs/day/run"]) == 2
    err = capsys.readouterr().err
    assert err.startswith("estlab: runs/day/run/config.yaml: scenario._target_ mine.Mine is refused: ")
    assert len(err.splitlines()) == 1
    assert set(Path("runs/day").iterdir()) == before
    assert len(list(Path("runs").iterdir())) == 2
    assert not Path("ran").exists()


def test_a_plugin_that_is_typed_is_trusted(capsys, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    Path("mine.py").write_text(PENDULUM)
    scenario = yaml.safe_load(Path("runs/day/run/config.yaml").read_text())["scenario"]
    configure(scenario=scenario | {"_target_": "mine.Mine"}, plugins=["another"])
    try:
        assert main(["rerun", "runs/day/run", "plugins=[mine]"]) == 0
    finally:
        sys.modules.pop("mine", None)
    assert Path("ran").exists()
    assert yaml.safe_load((newest() / "config.yaml").read_text())["plugins"] == ["mine"]


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ("os.system", "is refused"),
        ("estlabx.Evil", "is refused"),
        ("estlab.launch.launcher.complain", "does not make a Scenario"),
        ("estlab.launch.launcher.os.system", "there is no"),
        ("estlab.rundir.files.Path", "does not make a Scenario"),
        ("estlab.filters.gaussian.extended", "does not make a Scenario"),
    ],
)
def test_no_target_but_estlabs_own_of_the_kind_is_called(target, said, capsys):
    configure(scenario={"_target_": target, "command": "touch ran"})
    assert main(["rerun", "runs/day/run"]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert len(err.splitlines()) == 1
    assert not Path("ran").exists()


@pytest.mark.parametrize(
    "spoil",
    [
        lambda run: edit(run / "run.json", names={"scenario": "../../../out", "filter": "ukf"}),
        lambda run: edit(run / "run.json", names={"scenario": "/out", "filter": "ukf"}),
        lambda run: configure(output="/nowhere/out", scenario={}),
        lambda run: configure(filters={"../out": {}, "a\x1b": {}}),
        lambda run: (run / "config.yaml").write_text("scenario: !!python/object/apply:os.system ['touch ran']\n"),
        lambda run: (run / "config.yaml").write_text("runs: ${oc.env:HOME}\n"),
    ],
)
def test_names_and_values_of_a_stranger_lead_nowhere_and_run_nothing(spoil, capsys):
    spoil(Path("runs/day/run"))
    assert main(["rerun", "runs/day/run"]) == 2
    err = capsys.readouterr().err
    assert re.fullmatch(r"estlab: runs/day/run/[^\n\x1b]*\n", err)
    assert not Path("ran").exists()
    assert not list(Path.cwd().rglob("out*"))


def test_a_strangers_output_is_not_written_to_and_his_file_not_followed(capsys):
    configure(output="elsewhere")
    assert main(["rerun", "runs/day/run"]) == 0
    assert not Path("elsewhere").exists()
    Path("secret").write_text("- secret")
    Path("runs/day/run/overrides.yaml").unlink()
    Path("runs/day/run/overrides.yaml").symlink_to(Path("secret").resolve())
    assert main(["rerun", "runs/day/run"]) == 2
    assert "overrides.yaml: is a link, which is not followed" in capsys.readouterr().err
    assert len(list(Path("runs").rglob("status.json"))) == 2


def test_data_that_have_moved_changed_or_gone_are_said_before_the_run(capsys, monkeypatch):
    assert main(["simulate", "scenario=landmark", "steps=25", "data.path=recorded"]) == 0
    made(Path("runs/day/files"), "filter=ukf", "data=files", "data.path=recorded")
    capsys.readouterr()
    assert main(["rerun", "runs/day/files"]) == 0
    Path("deep").mkdir()
    monkeypatch.chdir("deep")  # from where the relative path leads nowhere
    assert main(["rerun", "../runs/day/files"]) == 0
    monkeypatch.chdir("..")
    Path("recorded").rename("moved")
    capsys.readouterr()
    assert main(["rerun", "runs/day/files"]) == 2
    assert re.fullmatch(
        r"estlab: \S+: the data file is gone; give its folder as data.path=FOLDER\n", capsys.readouterr().err
    )
    assert main(["rerun", "runs/day/files", "data.path=moved"]) == 0
    with open("moved/Measurement.dat", "a") as stream:
        stream.write("\n")
    capsys.readouterr()
    assert main(["rerun", "runs/day/files", "data.path=moved"]) == 0
    out, err = capsys.readouterr()
    assert re.match(r"estlab: warning: moved/Measurement.dat has changed: SHA-256 \w{12} before, \w{12} now\n", err)
    assert "identical to the last bit" in out
    assert "data files, by their SHA-256" in out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "takes one run directory"),
        (["runs/day/run", "runs/day"], "takes one run directory"),
        (["runs/day"], "not a run directory"),
        (
            ["runs/day/run", "seed=3"],
            "repeats a run; it only takes plugins, data.path, cores, output, hydra.run.dir",
        ),
        (["runs/day/run", "--fast"], "estlab rerun has no --fast (see estlab rerun --help)"),
        (["runs/day/run", "plugins=mine"], "write a list"),
        (["runs/day/run", "data.path=x"], "the run's data were simulated"),
        (["runs/day/run", "hydra.run.dir=runs/day/run"], "already holds a run"),
    ],
)
def test_a_mistake_is_one_line_and_code_2(words, said, capsys):
    assert main(["rerun", *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(rf"estlab: [^\n]*{re.escape(said)}[^\n]*\n", err)


def test_a_run_of_an_earlier_estlab_takes_the_shipped_values_of_keys_that_it_did_not_have(capsys):
    file = Path("runs/day/run/config.yaml")
    config = yaml.safe_load(file.read_text())
    del (
        config["dropped"],
        config["scenario"]["sightings"],
        config["data"]["clock_gap"],
        config["filters"]["pf"]["recovery"],
    )
    file.write_text(yaml.safe_dump(config, sort_keys=False))
    metrics = Path("runs/day/run/metrics.csv")
    lines = metrics.read_text().splitlines(keepends=True)
    metrics.write_text("".join([lines[0], lines[2], lines[1], *lines[4:]]))
    assert main(["rerun", "runs/day/run"]) == 0
    said = capsys.readouterr()
    assert (
        "earlier estlab; these keys take their default values: dropped, scenario.sightings, "
        "data.clock_gap, filters.pf.recovery" in said.err
    )
    assert "identical to the last bit" in said.out
    now = yaml.safe_load((newest() / "config.yaml").read_text())
    assert now["filters"]["pf"]["recovery"] == "flatten"


def test_a_class_of_a_plugins_own_is_not_given_the_shipped_ones_keys():
    from estlab.config.earlier import completed

    own = {"_target_": "mine.Landmark", "dt": 0.1}
    filter = {"_target_": "estlab.filters.gaussian.extended", "noise": "additive"}
    config = {"scenario": own, "filter": filter, "filters": {}, "data": {"source": "files"}}
    found, added = completed(config, "landmark", "ekf")
    assert found["scenario"] == own
    assert found["filter"]["gate"] is None
    assert "filter.gate" in added and not any(key.startswith("scenario.") for key in added)
    assert found["data"]["source"] == "files"
