"""A stranger's directory runs no code of his, by whatever word or file he tries it, and a user's own plugins work."""

import json
import os
import pickle
import shutil
import sys
from pathlib import Path

import pytest
import yaml
from hydra import compose, initialize_config_dir

from estlab.cli.main import main
from estlab.config.locations import conf_folder
from estlab.errors import UserError
from estlab.launch import arguments, composition
from estlab.sweeps import allowed, resume
from tests.cli.sweeping import TINY, sweep, table

EVIL = "_target_:pandas.read_pickle,filepath_or_buffer:evil.pkl"


class Evil:
    """What a pickle does when it is read."""

    def __reduce__(self):
        return Path.touch, (Path("ran"),)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("strangers") / "swept"
    assert main(["sweep", *TINY, "plots=false", "filter=ekf", "seed=1", f"sweep.dir={folder}"]) == 0
    return folder


@pytest.fixture
def his(undisturbed):
    """A sweep's directory of his with what his words name, where the user stands."""
    shutil.copytree(undisturbed, "swept")
    shutil.rmtree("swept/0_landmark_ekf")
    Path("evil.pkl").write_bytes(pickle.dumps(Evil()))
    callbacks = "x: {_target_: pandas.read_pickle, filepath_or_buffer: evil.pkl}\n"
    nested = (
        "# @package _global_\nhydra: {callbacks: {x: {_target_: pandas.read_pickle, filepath_or_buffer: evil.pkl}}}\n"
    )
    for group, text in (("hydra/callbacks", callbacks), ("experiment", nested), ("scenario", nested)):
        (Path("swept/conf") / group).mkdir(parents=True)
        (Path("swept/conf") / group / "evil.yaml").write_text(text)
    Path("swept/evil.yaml").write_text(nested)
    Path("evil.py").write_text("from pathlib import Path\nPath('ran').touch()\nclass Evil: pass\n")
    return Path("swept")


def resumed(his: Path, *words: str, typed: tuple[str, ...] = ()) -> int:
    """Resume it with these words in its plan."""
    plan = json.loads((his / "sweep.json").read_text())
    (his / "sweep.json").write_text(json.dumps(plan | {"arguments": [*plan["arguments"], *words]}))
    return main(["sweep", "--resume", str(his), *typed])


def up_to_here(name: str) -> str:
    """A path from conf/experiment to a file where the user stands."""
    return os.path.relpath(name, conf_folder() / "experiment")


# Words of which Hydra without estlab's guards makes the call at once.
AT_ONCE = {
    "a node": [f"++hydra={{callbacks:{{x:{{{EVIL}}}}}}}"],
    "a key": [f"+hydra.callbacks.x={{{EVIL}}}"],
    "above": ["+experiment={up}"],
    "among others": ["+experiment=[smoke,{up}]"],
    "a folder of his": ["--config-dir=swept/conf", "+experiment=evil"],
    "a folder of his, in two words": ["--config-dir", "swept/conf", "+experiment=evil"],
    "a folder of his, in short": ["-cd", "swept/conf", "+experiment=evil"],
    "a place searched": ["hydra.searchpath=[file://swept/conf]", "+experiment=evil"],
    "an interpolated node": [f"+evil={{x:{{{EVIL}}}}}", "++hydra.callbacks=${evil}"],
    "made by a resolver": [f"++hydra.callbacks='${{oc.create:{{x:{{{EVIL}}}}}}}'"],
}

# Others, none of which may count either.
REFUSED = [
    "plugins=[evil]",
    "+plugins=[evil]",
    "++plugins=[evil]",
    "hydra.callbacks.x._target_=evil.Evil",
    "+hydra/callbacks=evil",
    "hydra/callbacks=evil",
    "+hydra/callbacks@hydra.callbacks=evil",
    "+scenario@_global_=evil",
    "scenario@hydra=car",
    "+scenario@hydra.callbacks=car",
    "+filter@hydra.callbacks.x=ekf",
    "+filter@filters._target_=ekf",
    "+filter@filters.x=../../evil",
    "scenario=../../../evil",
    "scenario=/evil",
    "scenario='evil'",
    "scenario=evil.yaml",
    "scenario=./car",
    "scenario={_target_:evil.Evil}",
    "scenario=car,../evil",
    "scenario=choice(car,evil)",
    'noise="../evil"',
    "+experiment=..",
    "+experiment=evil",
    "+experiment=\uff0e\uff0e/evil",
    "scenario=c\u0430r",
    "++hydra\u2024callbacks={x:1}",
    "hydra/launcher=../evil",
    "hydra/launcher=evil",
    "hydra/sweeper=evil",
    "hydra.launcher.setup=[rm]",
    "hydra.launcher.python=evil",
    "hydra.launcher.address=tcp://127.0.0.1:1",
    "hydra.launcher.pre_dispatch='9**9'",
    "hydra.launcher._target_=evil.Evil",
    "hydra.launcher={_target_:evil.Evil}",
    "+hydra.launcher.x={_target_:evil.Evil}",
    "hydra.sweeper.params={hydra.callbacks.x:1}",
    "~hydra.sweeper",
    "hydra.job_logging={formatters:{x:{class:evil.Evil}}}",
    "hydra/job_logging=default",
    "+hydra.job.env_set.PYTHONPATH=swept",
    "+hydra.job.env_copy=[X]",
    "hydra.run.dir=elsewhere",
    "hydra.sweep.subdir='../elsewhere'",
    "hydra.output_subdir=x",
    "hydra.job.name='../x'",
    "hydra.job.name=${oc.env:HOME}",
    "filter={_target_:evil.Evil}",
    "filter._target_=evil.Evil",
    "++filter._target_=evil.Evil",
    "+filter.x={_target_:evil.Evil}",
    "+filter.x=[{_target_:evil.Evil}]",
    "++expect={_target_:evil.Evil}",
    "++expect={a:{'_target_':evil.Evil}}",
    "+evil.x=1",
    "+defaults=[evil]",
    "+_target_=evil.Evil",
    "$hydra=1",
    "seed=${oc.env:SEED}",
    "seed='${oc.env:SEED}'",
    "seed=[${oc.env:SEED}]",
    "+filter.x={a:[1,'${oc.env:SEED}']}",
    "objective=\\${seed}",
    "seed=1,${oc.env:SEED}",
    "output='${oc.env:HOME}'",
    "part=[0,2]",
    "parts=[swept]",
    "--config-name=evil",
    "--config-path=swept",
    "--package=hydra",
    "--cfg=job",
    "--info=all",
    "--shell-completion",
    "--experimental-rerun=x.pickle",
    "seed=" + "[" * 400,
]


def spelt(route: str) -> list[str]:
    return [word.replace("{up}", up_to_here("swept/evil")) for word in AT_ONCE[route]]


@pytest.mark.parametrize("route", AT_ONCE)
def test_what_would_run_his_code_must_be_typed(route, his, capsys):
    assert resumed(his, *spelt(route)) == 2
    assert not Path("ran").exists()
    err = capsys.readouterr().err
    assert "of its command is used only if you type it" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("word", REFUSED)
def test_no_word_counts_but_plain_values_and_names_of_what_there_is(word, his, capsys):
    assert resumed(his, word) == 2
    assert not Path("ran").exists()
    assert not Path("elsewhere").exists()
    assert not list(his.glob("*/status.json")), "nothing ran"
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("word", ["hydra/sweeper=optuna", "sweep.split_runs=2", "sweep.timeout=60"])
def test_a_tuning_parts_and_jobs_in_processes_of_their_own_take_no_more(word, his):
    assert resumed(his, word, *spelt("a key")) == 2
    assert not Path("ran").exists()


@pytest.mark.parametrize("route", AT_ONCE)
def test_what_is_composed_is_checked_whoever_typed_it(route, his, capsys):
    """Before anything is made of it."""
    assert main(["sweep", *TINY, "filter=ekf", *spelt(route)]) == 2
    assert not Path("ran").exists()
    err = capsys.readouterr().err
    assert "pandas.read_pickle is refused: it is not in estlab" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("route", AT_ONCE)
def test_without_the_check_his_code_runs(route, his, monkeypatch):
    """So the tests above can fail."""
    monkeypatch.setattr(composition, "check", lambda config: None)
    main(["sweep", *TINY, "filter=ekf", "sweep.dry_run=true", *spelt(route)])
    assert Path("ran").exists()


def test_without_the_list_of_what_is_allowed_his_words_are_composed(his, monkeypatch):
    monkeypatch.setattr(allowed, "refused", lambda words, folders: "")
    monkeypatch.setattr(composition, "check", lambda config: None)
    resumed(his, *spelt("above"))
    assert Path("ran").exists()


@pytest.mark.parametrize(
    "word",
    [
        "+hydra.callbacks.x._target_=estlab.cli.main.main",
        "+hydra.callbacks.x._target_=estlab.rundir.RunDirectory",
        "+hydra.callbacks.x._target_=estlab.rundir.subprocess.run",
        "+hydra.callbacks.x._target_=os.mkdir",
        "+hydra.callbacks.x={_target_:os.mkdir,path:ran}",
        "+hydra.callbacks.x.y={_target_:os.mkdir,path:ran}",
        "+hydra.callbacks.x={_target_:hydra.utils.call,x:{_target_:os.mkdir,path:ran}}",
        "+hydra.launcher.x={_target_:os.mkdir,path:ran}",
        "+hydra.sweeper.x={_target_:os.mkdir,path:ran}",
        "+hydra.sweeper.x=[[{_target_:os.mkdir,path:ran}]]",
        "hydra.launcher._target_=os.mkdir",
        "+hydra.job_logging={root:{level:INFO},handlers:{x:{class:os.mkdir,path:ran}}}",
        "+hydra.job_logging={root:{level:INFO},formatters:{x:{class:pathlib.Path}}}",
        "+hydra.hydra_logging={root:{level:INFO},filters:{x:{class:os.mkdir,path:ran}}}",
        "+hydra.hydra_logging={root:{level:INFO},handlers:{x:{class:logging.StreamHandler,stream:'ext://os.environ'}}}",
        "+hydra.hydra_logging={root:{level:INFO},handlers:{x:{class:logging.os.mkdir,path:ran}}}",
    ],
)
def test_hydras_own_node_calls_nothing_outside_estlab_and_what_is_listed(word):
    composition.install()
    with (
        initialize_config_dir(str(conf_folder()), version_base="1.3"),
        pytest.raises(UserError, match=r"is refused|is not a callback|there is no"),
    ):
        compose("config", overrides=[word], return_hydra_config=True)


@pytest.fixture
def mine(monkeypatch):
    """A package of the user's own with a callback and an experiment that sweeps."""
    Path("my_callbacks.py").write_text(
        "from pathlib import Path\n"
        "from hydra.experimental.callback import Callback\n"
        "class Noted(Callback):\n"
        "    def __init__(self, file):\n        self.file = Path(file)\n"
        "    def on_job_end(self, config, job_return, **others):\n"
        "        with self.file.open('a') as stream:\n            stream.write(f'{config.seed}\\n')\n"
    )
    Path("conf/experiment").mkdir(parents=True)
    Path("conf/experiment/mine.yaml").write_text("# @package _global_\nrun_index: 0\n")
    monkeypatch.setattr(sys, "path", [*sys.path])
    yield "+hydra.callbacks.mine={_target_:my_callbacks.Noted,file:noted.txt}"
    sys.modules.pop("my_callbacks", None)


def test_a_callback_of_a_listed_plugin_is_called(mine, capsys):
    assert main(["run", *TINY, "plots=false", mine]) == 2
    assert "is refused: it is not in estlab; list its package under plugins" in capsys.readouterr().err
    assert main(["run", *TINY, "plots=false", "report=false", "seed=3", "plugins=[my_callbacks]", mine]) == 0
    assert sweep("filter=ekf", "seed=5", "plugins=[my_callbacks]", mine) == 0
    assert Path("noted.txt").read_text().split() == ["3", "5"]


def test_who_resumes_types_what_he_trusts_of_his_own_sweep(mine, capsys):
    trusted = ["plugins=[my_callbacks]", mine, "--config-dir=conf"]
    assert sweep("filter=ekf", "+experiment=mine", "seed=5", *trusted) == 0
    before = table()
    shutil.rmtree("swept/0_landmark_ekf")
    assert main(["sweep", "--resume", "swept"]) == 2
    assert "--config-dir=conf of its command is used only if you type it" in capsys.readouterr().err
    assert main(["sweep", "--resume", "swept", "--config-dir", "conf"]) == 2
    assert "plugins=[my_callbacks] of its command is used only if you type it" in capsys.readouterr().err
    assert main(["sweep", "--resume=swept", *trusted]) == 0
    assert table() == before
    assert Path("noted.txt").read_text().split() == ["5", "5"]


@pytest.mark.parametrize(
    "words",
    [
        ["hydra.launcher.workers=2", "hydra/launcher=dask"],
        ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"],
        ["filter=[ekf,ukf]", "filters.ukf.alpha=0.5,1"],
        ["filter=ekf,ukf", "filter.gate=0.9"],
        ["filter=ekf", "seed=range(1,3)", "sweep.repeats=1", "~expect"],
        ["+experiment=field_few_particles", "steps=2"],
        ["filter=ekf", "expect.rmse.x=[0,1]", "expect.diverged.max=0", "output='my runs'"],
        ["filter=ekf", "scenario.initial_sd='[0.1,0.2,0.3]'", "hydra.mode=MULTIRUN"],
        ["filter=glob(*kf)", "noise.filter.process_scale=choice(1,2)"],
    ],
)
def test_ones_own_sweep_resumes_without_a_word(words, undisturbed, monkeypatch):
    """Its words are taken as they are; that is all that is tried."""
    monkeypatch.setattr(arguments, "_check_installed", lambda word: None)
    shutil.copytree(undisturbed, "swept")
    plan = json.loads(Path("swept/sweep.json").read_text())
    typed = arguments.prepared(["--multirun", "scenario=landmark", *words, "sweep.dir=swept"])
    Path("swept/sweep.json").write_text(json.dumps(plan | {"arguments": typed}))
    found = resume.without_own_flags(["--resume", "swept"])
    kept = [word for word in typed if word.partition("=")[0] not in ("--multirun", "sweep.dir")]
    assert found == [*kept, f"sweep.dir='{Path('swept').resolve()}'"]


def test_no_command_that_reads_a_run_directory_takes_its_words(undisturbed, capsys):
    """rerun, compare, report and clean never hand them to Hydra, nor build what its files name."""
    shutil.copytree(undisturbed, "runs/day/swept")
    Path("evil.pkl").write_bytes(pickle.dumps(Evil()))
    for job in Path("runs/day/swept").glob("0_*"):
        shutil.copytree(job, f"runs/day/{job.name}")
    target = "{_target_: pandas.read_pickle, filepath_or_buffer: evil.pkl}"
    words = [word for route in AT_ONCE for word in spelt(route)]
    for job in Path("runs").rglob("0_*"):
        (job / "overrides.yaml").write_text("".join(f"- {json.dumps(word)}\n" for word in words))
        facts = json.loads((job / "run.json").read_text())
        names = facts["names"] | {"changes": words}
        (job / "run.json").write_text(json.dumps(facts | {"names": names, "command": ["estlab", "run", *words]}))
        config = (job / "config.yaml").read_text()
        evil = f"hydra: {{callbacks: {{x: {target}}}}}\nplugins: [evil]\n"
        (job / "config.yaml").write_text(config.replace("plugins: []\n", evil))
    plan = Path("runs/day/swept/sweep.json")
    plan.write_text(json.dumps(json.loads(plan.read_text()) | {"arguments": words}))
    job = "runs/day/0_landmark_ekf"
    config = (Path(job) / "config.yaml").read_text().replace(f"hydra: {{callbacks: {{x: {target}}}}}\n", "")
    for key in ("hydra", "filter", "scenario", "noise", "expect"):
        (Path(job) / "config.yaml").write_text(yaml.safe_dump(yaml.safe_load(config) | {key: yaml.safe_load(target)}))
        assert main(["rerun", job]) == 2
        assert "pandas.read_pickle is refused: it is not in estlab" in capsys.readouterr().err
    for command in (["compare", "runs"], ["report", job, "runs/day/swept"], ["clean", "--failed"]):
        main(command)
    assert not Path("ran").exists()
