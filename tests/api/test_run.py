"""Runs in this process: as the command line's to the last bit, with nothing printed, and nothing left behind."""

import asyncio
import contextlib
import logging
import os
import signal
import subprocess
import sys
import threading
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hydra import compose, initialize_config_dir
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import OmegaConf
from omegaconf.basecontainer import BaseContainer

import estlab
from estlab.cli.main import main
from estlab.launch import resolvers
from tests.conftest import ROOT

pytestmark = pytest.mark.slow

TINY = {"scenario": "landmark", "runs": 4, "steps": 12, "plots": False, "report": False}
TABLES = ("metrics", "errors", "nees", "nis", "tests", "runs", "comparison", "coverage", "expectations")


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def tiny(*words, **keys):
    return estlab.run(*words, **{**TINY, "save": False, **keys})


def test_a_run_in_memory_is_the_command_line_s_to_the_last_bit(folder):
    words = ("scenario=landmark", "filter=[ekf,pf]", "runs=20", "keep_runs=3", "steps=25", "scenario.duration=2.5")
    mine, theirs = estlab.run(*words, save=False), estlab.load(folder)
    for name in TABLES:
        pd.testing.assert_frame_equal(
            getattr(mine, name).drop(columns="cost_ratio", errors="ignore"),
            getattr(theirs, name).drop(columns="cost_ratio", errors="ignore"),
        )
    for name in ("ekf", "pf"):
        np.testing.assert_array_equal(mine.estimates[name].mean, theirs.estimates[name].mean)
        assert mine.verdict[name] == theirs.verdict[name]
    assert (mine.path, mine.title, mine.filters) == (None, theirs.title, theirs.filters)
    assert mine.figures == theirs.figures
    assert mine.figure("errors")._repr_png_() == theirs.figure("errors")._repr_png_()
    assert list(Path().iterdir()) == []


def test_a_saved_run_leaves_the_directory_that_the_command_line_leaves(capsys):
    mine = estlab.run("filter=ukf", expect={"anees": {"max": 50.0}}, **{**TINY, "plots": True, "report": True})
    assert capsys.readouterr() == ("", "")
    assert main(["run", "filter=ukf", "scenario=landmark", "runs=4", "steps=12", "expect.anees.max=50.0"]) == 0
    theirs = estlab.load("latest")
    assert mine.path.parent.parent == Path("runs")
    files = [sorted(str(file.relative_to(run.path)) for file in run.path.rglob("*")) for run in (mine, theirs)]
    assert files[0] == files[1]
    for file in mine.path.glob("*.csv"):
        assert file.read_bytes() == (theirs.path / file.name).read_bytes()
    again = estlab.load(mine.path)
    for name in TABLES:
        pd.testing.assert_frame_equal(getattr(mine, name), getattr(again, name))
    assert mine.facts["command"][:3] == ["estlab", "run", "filter=ukf"]
    assert mine.status == again.status == "ok"
    assert mine.config == again.config


def test_a_run_can_be_run_again_from_what_it_saved(capsys):
    run = estlab.run("filter=ekf", **TINY)
    assert main(["rerun", str(run.path)]) == 0
    assert "identical to the last bit" in capsys.readouterr().out


SAME = {
    "words": (("filter=ukf", "filter.alpha=0.5", "noise.filter.process_scale=2"), {}),
    "keywords": ((), {"filter": "ukf", "filter.alpha": 0.5, "noise.filter.process_scale": 2}),
    "a mapping": (("filter=ukf",), {"filter": {"alpha": 0.5}, "noise": {"filter": {"process_scale": 2.0}}}),
    "numbers of NumPy": (
        ("filter=ukf",),
        {"filter": {"alpha": np.float64(0.5)}, "noise.filter.process_scale": np.int64(2)},
    ),
}


@pytest.mark.parametrize("form", SAME)
def test_words_keywords_and_mappings_mean_the_same(form):
    words, keys = SAME[form]
    found = tiny(*words, **keys).config
    assert (found["filter"]["alpha"], found["noise"]["filter"]["process_scale"]) == (0.5, 2)


def test_every_kind_of_value_arrives_as_it_is(tmp_path):
    odd = tmp_path / "it's, [odd] {place}"
    run = tiny(filter=["ekf", "ukf"], filters={"ukf": {"points": "julier"}}, output=odd, dropped=0.1, smooth=True,
               steps=None, expect={"diverged": {"max": 3}, "verdict": ["consistent", "undecided"]}, scenario="landmark",
               **{"scenario.duration": 2})  # fmt: skip
    assert run.filters == ("ekf", "ekf_smoothed", "ukf", "ukf_smoothed")
    assert run.config["output"] == str(odd)
    assert run.config["filters"]["ukf"]["points"] == "julier"
    assert run.config["expect"] == {"diverged": {"max": 3}, "verdict": ["consistent", "undecided"]}
    assert len(run.expectations) == 8


def test_an_experiment_by_name_and_a_folder_of_configuration_of_one_s_own(tmp_path):
    (tmp_path / "mine/experiment").mkdir(parents=True)
    (tmp_path / "mine/experiment/small.yaml").write_text(
        "# @package _global_\ndefaults:\n  - override /scenario: landmark\nruns: 3\nsteps: 5\n"
    )
    assert estlab.run(experiment="small", config_dir="mine", save=False).title.startswith("landmark · ukf · 3 runs × 5")
    assert estlab.run("+experiment=smoke", "runs=2", save=False).facts["steps"] == 20


WRONG = {
    "did you mean filter.alpha?": {"filter": {"alfa": 1}},
    "did you mean ukf?": {"filter": "ukff"},
    "got 'many'": {"runs": "many"},
    "runs must be ": {"runs": 0},
    "filter=ekf,ukf: ": {"words": ("filter=ekf,ukf",)},
    "filter.gate must ": {"filter": {"gate": 2}},
    "data.path=x ": {"data": {"path": "x"}},
    "nowhere": {"config_dir": "nowhere"},
    "--cfg=job belongs to the command line": {"words": ("--cfg=job",)},
    "nonsense": {"words": ("nonsense",)},
    "seed is a object; a value must be": {"seed": object()},
    "3 is not a text: write key=value": {"words": (3,)},
    "use estlab.sweep for several": {"words": ("hydra.mode=MULTIRUN",)},
    "Odometry.dat": {"data": "files", "data.path": "."},
}


@pytest.mark.parametrize("message", WRONG)
def test_what_is_wrong_is_raised_in_the_command_line_s_one_line_and_leaves_nothing(message, capsys):
    given = dict(WRONG[message])
    words = given.pop("words", ())
    for save in (False, True):
        with pytest.raises(estlab.UserError) as error:
            tiny(*words, **given, save=save)
        assert message in str(error.value)
        assert "\n" not in str(error.value)
    assert capsys.readouterr() == ("", "")
    assert [path for path in Path().rglob("*") if path.name == "metrics.csv"] == []
    tiny(runs=1)  # and the next call is as any other


def test_an_expectation_that_is_not_met_raises_nothing_and_is_told():
    run = tiny(expect={"anees": [100.0, 200.0]})
    assert run.status == "unmet"
    assert run.unmet.startswith("1 of 1 expectation not met: anees expected 100 to 200")
    assert list(run.expectations["met"]) == [False]


def state():
    """What of the process a run might change."""
    logger = logging.getLogger("estlab")
    return {
        "hydra": GlobalHydra.instance().hydra,
        "config": HydraConfig.instance().cfg,
        "resolvers": dict(BaseContainer._resolvers),
        "path": list(sys.path),
        "argv": list(sys.argv),
        "environment": dict(os.environ),
        "filters": list(warnings.filters),
        "showwarning": warnings.showwarning,
        "log": (
            logger.level,
            logger.propagate,
            list(logger.handlers),
            logging.raiseExceptions,
            list(logging.root.handlers),
        ),
        "signals": [signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)],
        "folder": Path.cwd(),
        "numpy": np.geterr(),
    }


@pytest.mark.parametrize("keys", [{"save": True}, {"save": False}, {"filter": {"alfa": 1}}, {"runs": 0}], ids=str)
def test_a_run_leaves_the_process_as_it_was_also_one_that_fails(keys):
    tiny()
    before = state()
    with contextlib.suppress(estlab.UserError):
        tiny(**keys)
    assert state() == before


def test_a_program_that_uses_hydra_itself_goes_on_with_its_own(tmp_path, monkeypatch):
    monkeypatch.setattr("hydra._internal.hydra.ConfigLoaderImpl", ConfigLoaderImpl)  # whatever tests before have left
    (tmp_path / "conf").mkdir()
    (tmp_path / "conf/mine.yaml").write_text("a: 1\n")
    OmegaConf.register_new_resolver("deg", lambda number: "theirs", replace=True)
    with initialize_config_dir(str(tmp_path / "conf"), version_base="1.2"):
        OmegaConf.register_new_resolver("now", lambda pattern: "later", replace=True)
        try:
            for _ in range(2):
                tiny()
                assert compose("mine").a == 1
                assert OmegaConf.create({"b": "${now:x}, ${deg:1}"}).b == "later, theirs"
        finally:
            OmegaConf.clear_resolver("now")
            resolvers.register()


def test_threads_and_a_running_loop_take_turns():
    found = {}

    def work(seed):
        found[seed] = tiny(seed=seed).metrics["value"].to_numpy()

    threads = [threading.Thread(target=work, args=(seed,)) for seed in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    async def cell():
        return tiny(seed=1)

    np.testing.assert_array_equal(asyncio.run(cell()).metrics["value"], found[1])
    assert not np.array_equal(found[1], found[2], equal_nan=True)


def test_progress_is_shown_only_where_it_is_asked_for(capsys):
    calls = []
    tiny(progress=lambda done, total: calls.append((done, total)))
    assert calls[-1][0] == calls[-1][1] == 12
    assert capsys.readouterr() == ("", "")
    tiny(progress=True)
    assert capsys.readouterr().err.splitlines()[-1] == "landmark ukf: 100 %"


def test_in_a_folder_that_cannot_be_written_a_run_in_memory_runs_and_one_that_is_saved_says_so(monkeypatch):
    Path("closed").mkdir()
    Path("closed/runs").write_text("a file stands here")
    monkeypatch.chdir("closed")
    assert tiny().status == "ok"
    with pytest.raises(estlab.UserError, match="runs/"):
        tiny(save=True)


def test_a_plugin_s_exception_is_raised_with_its_place_and_the_path_to_it_goes(monkeypatch, tmp_path):
    (tmp_path / "broken.py").write_text(
        "from estlab.scenarios.landmark import Landmark\n\n\nclass Broken(Landmark):\n"
        "    def simulate(self, streams, runs, noise):\n        raise ValueError('no wheels')\n"
    )
    wrong = {"plugins": ["broken"], "scenario._target_": "broken.Broken"}
    with pytest.raises(
        estlab.errors.PluginError, match=r"broken.Broken.simulate, line 6, raised ValueError: no wheels"
    ):
        tiny(**wrong)
    with pytest.raises(estlab.errors.PluginError, match="no wheels"):
        tiny(**wrong, save=True)
    assert estlab.load(next(Path("runs").glob("2*/*"))).status == "failed"
    assert str(tmp_path) not in sys.path
    sys.modules.pop("broken")


SCRIPT = """
import estlab
print("once")
run = estlab.run("scenario=landmark", "filter=ekf", runs=40, steps=10, block_runs=10, cores=2, save=False)
print(run.facts["cores"], run.metrics["value"].iloc[0])
"""


def test_a_script_that_does_not_ask_whether_it_is_the_main_one_is_not_run_by_its_workers(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "2"}  # a second thread, so that workers import everything
    done = subprocess.run(
        [sys.executable, "script.py"], env=environment, capture_output=True, text=True, check=True, timeout=120
    )
    words = done.stdout.split()
    assert (words[:2], words.count("once"), done.stderr) == (["once", "2"], 1, "")
    same = estlab.run("scenario=landmark", "filter=ekf", runs=40, steps=10, block_runs=10, cores=1, save=False)
    assert float(words[2]) == same.metrics["value"].iloc[0]
    assert ROOT.is_dir()
