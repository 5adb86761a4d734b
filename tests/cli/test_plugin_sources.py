"""The source of plugins is kept as text beside the figures; where figures are set side by side, its change is said."""

import json
import shutil
import sys
from hashlib import sha256
from pathlib import Path

import pytest

from estlab.cli.main import main
from estlab.config.locations import conf_folder
from estlab.rundir.sources import sources

SOURCE = "from estlab.scenarios.field import Field\nfrom own.deep import VALUE\n\n\nclass Mine(Field):\n    pass\n"
WORDS = ["--config-dir=conf", "scenario=mine", "plugins=[own]", "runs=2", "steps=3", "filter=ekf", "plots=false"]


@pytest.fixture(autouse=True)
def plugin(_in_an_empty_folder, monkeypatch):
    """A package of two modules, imported anew, and a third that nobody uses."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    Path("own").mkdir()
    Path("own/__init__.py").write_text(SOURCE)
    Path("own/deep.py").write_text("VALUE = 1\n")
    Path("own/unused.py").write_text("raise SystemExit\n")
    Path("conf/scenario").mkdir(parents=True)
    text = (conf_folder() / "scenario/field.yaml").read_text()
    text = "".join(
        "_target_: own.Mine\n" if "_target_: estlab.scen" in line else line for line in text.splitlines(True)
    )
    Path("conf/scenario/mine.yaml").write_text(text)
    yield
    forget()


def forget() -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "own"]:
        del sys.modules[name]


def edited(module: str) -> None:
    forget()
    with open(module, "a") as stream:
        stream.write("# another line\n")


def digest(file: str) -> str:
    return sha256(Path(file).read_bytes()).hexdigest()


def test_what_was_imported_is_kept_as_text_with_its_hash_and_shown(capsys):
    assert main(["run", *WORDS, "hydra.run.dir=run"]) == 0
    kept = {path.name: path.read_text() for path in Path("run/plugins").iterdir()}
    assert kept == {"own.txt": SOURCE, "own.deep.txt": "VALUE = 1\n"}
    listed = json.loads(Path("run/run.json").read_text())["plugins"]
    assert {one["module"]: one["sha256"] for one in listed} == {
        "own": digest("own/__init__.py"),
        "own.deep": digest("own/deep.py"),
    }
    page = Path("run/report.html").read_text()
    assert "Modules of plugins that took part" in page
    assert digest("own/deep.py") in page
    assert "plugins/own.deep.txt" in page


def test_a_run_without_plugins_keeps_none():
    assert main(["run", "scenario=field", *WORDS[3:], "hydra.run.dir=run"]) == 0
    assert not Path("run/plugins").exists()
    assert "plugins" not in json.loads(Path("run/run.json").read_text())


def test_rerun_and_compare_say_which_module_has_changed_and_run_what_is_there_now(capsys):
    assert main(["run", *WORDS, "hydra.run.dir=run"]) == 0
    before = digest("own/deep.py")[:12]
    capsys.readouterr()
    assert main(["rerun", "run", "plugins=[own]", "hydra.run.dir=same"]) == 0
    assert "source of" not in capsys.readouterr().out
    edited("own/deep.py")
    Path("run/plugins/own.txt").write_text("raise SystemExit")  # it is data
    assert main(["rerun", "run", "plugins=[own]", "hydra.run.dir=again"]) == 0
    now = digest("own/deep.py")[:12]
    said = f"source of own.deep: SHA-256 {before} before, {now} now; figures may differ because of it"
    out = capsys.readouterr().out
    assert said in out
    assert "source of own:" not in out
    assert said in json.loads(Path("again/run.json").read_text())["changed"]
    assert said in Path("again/report.html").read_text()
    assert main(["compare", "run", "same", "again"]) == 0
    assert (
        f"warning: the source of plugins differs: own.deep SHA-256 {before} (rows 1, 2), "
        f"own.deep SHA-256 {now} (row 3); figures may differ because of it"
    ) in capsys.readouterr().err


def test_of_an_earlier_estlab_it_is_said_that_nobody_knows(capsys):
    assert main(["run", *WORDS, "hydra.run.dir=run"]) == 0
    facts = json.loads(Path("run/run.json").read_text())
    del facts["plugins"]
    Path("run/run.json").write_text(json.dumps(facts))
    assert main(["rerun", "run", "plugins=[own]", "hydra.run.dir=again"]) == 0
    assert "source of own: not stored before" in capsys.readouterr().out


def test_a_sweep_resumed_with_an_edited_plugin_says_so(capsys):
    words = ["sweep", *WORDS, "seed=1,2", "sweep.dir=swept"]
    assert main(words) == 0
    assert "the source of" not in capsys.readouterr().out
    edited("own/deep.py")
    shutil.rmtree("swept/1_mine_ekf")
    assert main(words) == 0
    assert "note: the source of own.deep differs between jobs (SHA-256 " in capsys.readouterr().out


def test_what_is_kept_is_bounded(monkeypatch):
    sys.path.insert(0, str(Path.cwd()))
    Path("own/__init__.py").write_text("x = 1\n")
    Path("own/deep.py").write_text("#" * 2**20 + "\n")
    __import__("own.deep")
    found = {one.module: one for one in sources(["own"])}
    assert found["own"].text == b"x = 1\n"
    assert found["own.deep"].text is None
    assert found["own.deep"].sha256 == digest("own/deep.py")
    Path("own/deep.py").unlink()
    assert [one.module for one in sources(["own"])] == ["own"]
