"""A run on several cores: the same bytes, and in order however it ends."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from estlab.cli.main import main
from estlab.parallel import pool
from estlab.sweeps.state import fingerprint
from tests.cli.sweeping import status, wait_for
from tests.cli.test_sweep_faults import lives
from tests.conftest import ROOT, composed

pytestmark = pytest.mark.slow

WORDS = ["scenario=field", "filter=[ekf,pf]", "filters.pf.particles=40", "runs=21", "steps=10"]
WORDS += ["block_runs=3", "keep_runs=4", "plots=false", "report=false"]
LONG = ["scenario=landmark", "filter=ekf", "runs=100000", "plots=false", "report=false", "cores=3"]


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The run in one process."""
    folder = tmp_path_factory.mktemp("alone") / "run"
    assert main(["run", *WORDS, "cores=1", f"hydra.run.dir={folder}"]) == 0
    return folder


def started(*words: str, folder: str) -> "subprocess.Popen[str]":
    """A process of one thread, as a user's is, in a group of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "estlab", "run", *words, f"hydra.run.dir={folder}"],
        env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        start_new_session=True, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip


def assert_same_figures(folder: Path, other: Path) -> None:
    names = {path.name for path in folder.iterdir() if path.suffix in (".csv", ".npz")} - {"comparison.csv"}
    assert {"metrics.csv", "errors.csv", "nis.csv", "runs.csv", "estimates.npz"} <= names
    for name in names:
        assert (folder / name).read_bytes() == (other / name).read_bytes(), name
    without_cost = [
        [line.rpartition(",")[0].rpartition(",")[0] for line in (place / "comparison.csv").read_text().splitlines()]
        for place in (folder, other)
    ]
    assert without_cost[0] == without_cost[1]


def cores_of(folder: str) -> int:
    return json.loads(Path(folder, "run.json").read_text())["cores"]


@pytest.mark.parametrize("cores", [2, 3])
def test_a_run_on_several_cores_has_the_bytes_of_one(cores, alone):
    process = started(*WORDS, f"cores={cores}", folder="many")
    assert process.communicate()[1] == ""
    assert process.returncode == 0
    assert cores_of("many") == cores
    assert_same_figures(alone, Path("many"))


def test_workers_that_import_everything_give_the_same_bytes(alone, monkeypatch, capsys):
    monkeypatch.setattr(pool, "can_fork", lambda: False)
    assert main(["run", *WORDS, "cores=2", "hydra.run.dir=many"]) == 0
    assert capsys.readouterr().err == ""
    assert cores_of("many") == 2
    assert_same_figures(alone, Path("many"))


def test_a_users_own_scenario_runs_in_workers_that_import_everything(monkeypatch):
    """Of a class in the folder where the user stands."""
    Path("own_field.py").write_text("from estlab.scenarios.field import Field\n\n\nclass Mine(Field):\n    pass\n")
    Path("conf/scenario").mkdir(parents=True)
    text = (ROOT / "conf/scenario/field.yaml").read_text().replace("estlab.scenarios.field.Field", "own_field.Mine")
    assert "own_field.Mine" in text
    Path("conf/scenario/mine.yaml").write_text(text)
    monkeypatch.setattr(pool, "can_fork", lambda: False)
    monkeypatch.syspath_prepend(".")
    words = ["scenario=mine", "plugins=[own_field]", "filter=ekf", "runs=4", "block_runs=2", "keep_runs=1", "steps=5"]
    words += ["plots=false", "cores=2", "hydra.run.dir=own"]
    assert main(["run", "--config-dir", "conf", *words]) == 0
    assert cores_of("own") == 2


def test_parts_of_a_run_use_the_cores_too(alone):
    for i in range(2):
        process = started(*WORDS, f"part=[{i},2]", "cores=2", folder=f"part{i}")
        assert process.communicate()[1] == ""
        assert cores_of(f"part{i}") == 2
    assert main(["run", *WORDS, "parts=[part0,part1]", "hydra.run.dir=whole"]) == 0
    assert_same_figures(alone, Path("whole"))


def children(process: "subprocess.Popen[str]") -> list[int]:
    return [int(word) for word in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()]


@pytest.fixture
def at_work():
    """A long run whose two workers have begun, and they."""
    process = started(*LONG, folder="long")
    wait_for(lambda: Path("long/run.json").exists() and '"steps"' in Path("long/run.json").read_text())
    workers = children(process)
    assert len(workers) == 2
    yield process, workers
    process.kill()
    process.communicate()
    wait_for(lambda: not any(lives(worker) for worker in workers))


@pytest.mark.parametrize(("send", "number"), [(os.killpg, signal.SIGINT), (os.killpg, signal.SIGHUP)])
def test_an_interruption_of_all_ends_all_in_order(send, number, at_work):
    process, workers = at_work
    send(process.pid, number)
    assert process.communicate(timeout=60)[1] == "estlab: interrupted\n"
    assert process.returncode == 130
    assert status("long")["status"] == "interrupted"
    assert not any(lives(worker) for worker in workers)


def test_a_killed_worker_fails_the_run_in_one_line(at_work):
    process, workers = at_work
    os.kill(workers[0], signal.SIGKILL)
    said = (
        "a worker process ended by SIGKILL, as the system does when memory runs out; "
        "set cores=1 or a smaller block_runs"
    )
    assert process.communicate(timeout=60)[1] == f"estlab: {said}\n"
    assert process.returncode == 1
    assert (status("long")["status"], status("long")["error"]) == ("failed", said)
    assert not lives(workers[1])


def test_workers_end_when_their_parent_is_killed(at_work):
    process, workers = at_work
    process.kill()
    process.communicate(timeout=60)  # its standard error is theirs
    wait_for(lambda: not any(lives(worker) for worker in workers))


def test_how_many_cores_a_job_had_is_no_part_of_it():
    plain = composed("scenario=field")
    assert fingerprint(plain | {"cores": 7}, "field", "ukf") == fingerprint(plain, "field", "ukf")


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("cores=0", "cores must be >= 1, got 0"),
        ("cores=all", "cores"),
        ("cores=100000", "cores=100000 is far more than"),
    ],
)
def test_a_wrong_number_of_cores_is_one_line(word, said, capsys):
    assert main(["run", *WORDS, word]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1


def test_linear_algebra_has_one_thread_unless_the_user_says():
    code = (
        "import os, sys; from estlab.cli.main import main; main(['run', 'scenario=radar', 'runs=2', 'plots=false', "
        "'report=false', 'hydra.run.dir=' + sys.argv[1]]); print(os.environ.get('OPENBLAS_NUM_THREADS'))"
    )
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
    clean = {key: value for key, value in os.environ.items() if key not in names} | {"PYTHONPATH": str(ROOT)}
    for typed, expected in (({}, "1"), ({"OMP_NUM_THREADS": "2"}, "None")):
        command = [sys.executable, "-c", code, f"run{expected}"]
        out = subprocess.run(command, env=clean | typed, capture_output=True, text=True, check=True).stdout
        assert out.splitlines()[-1] == expected


def test_pictures_drawn_by_two_are_those_of_one_and_one_that_fails_is_told_alike(monkeypatch):
    Path("own_pictures.py").write_text(
        "from estlab.scenarios.field import Field\n\n\n"
        "class Mine(Field):\n    def pictures(self, histories):\n        raise ValueError('no picture today')\n"
    )
    monkeypatch.syspath_prepend(Path.cwd())
    words = ["scenario=field", "scenario._target_=own_pictures.Mine", "plugins=[own_pictures]", "filter=ekf", "runs=4"]
    words += ["steps=10", "report=false"]
    assert main(["run", *words, "cores=1", "hydra.run.dir=one"]) == 0
    process = started(*words, "cores=2", folder="two")
    process.communicate()
    assert process.returncode == 0
    pictures = {path.name: path.read_bytes() for path in Path("one/plots").iterdir()}
    assert {"errors.png", "nees.png", "nis.png", "trajectory.png"} <= set(pictures)
    assert {path.name: path.read_bytes() for path in Path("two/plots").iterdir()} == pictures
    for folder in ("one", "two"):
        missing = json.loads(Path(folder, "run.json").read_text())["missing"]
        assert missing == {"the problem's own pictures": missing["the problem's own pictures"]}
        assert "no picture today" in missing["the problem's own pictures"]
        assert "in pictures\n" in Path(folder, "log.txt").read_text()
