"""Sweeps that are killed, spoilt, held or out of time: nothing is lost, nothing counted twice, each is told."""

import contextlib
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from estlab import rundir
from estlab.cli.main import main
from estlab.experiment import experiment
from estlab.parallel.signals import interruptible
from estlab.rundir import process
from estlab.sweeps import child, job, state
from tests.cli.sweeping import TINY, count, job_folders, rows, status, sweep, table, wait_for
from tests.conftest import ROOT

pytestmark = pytest.mark.slow

JOBLIB = ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"]
SIX = ["filter=ekf,ukf", "seed=1,2,3"]


def started(*words: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "estlab", "sweep", "plots=false", *words]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def lives(pid: int) -> bool:
    """Whether a process runs; one that is dead but not yet asked for its exit code does not."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


@pytest.mark.parametrize("moment", [lambda: Path("killed/sweep.json").exists(), lambda: count("killed", "ok") >= 2])
def test_a_sweep_that_is_killed_and_resumed_has_the_table_of_one_that_was_not(moment, capsys):
    assert sweep(*SIX, place="undisturbed") == 0
    process = started(*TINY, *SIX, "sweep.dir=killed")
    wait_for(moment)
    process.kill()
    process.communicate()
    wait_for(lambda: not any(lives(status(Path("killed") / folder)["pid"]) for folder in job_folders("killed")))
    ok = [folder for folder in job_folders("killed") if status(Path("killed") / folder)["status"] == "ok"]
    done = {folder: (Path("killed") / folder / "run.json").read_bytes() for folder in ok}
    capsys.readouterr()
    assert main(["sweep", "--resume", "killed"]) == 0
    assert table("killed") == table("undisturbed")
    for folder, was in done.items():
        assert (Path("killed") / folder / "run.json").read_bytes() == was, "what was ok did not run again"
    assert f"{len(done)} of 6 jobs are done, the others will run" in capsys.readouterr().err or not done


def marks_of(pid: int) -> dict:
    """What a status keeps of a process on this machine."""
    return process.marks() | {"pid": pid, "process_began": process._seen(pid).began}


def spoil_status(job: Path) -> None:
    (job / "status.json").write_text("{]")


def spoil_run(job: Path) -> None:
    (job / "run.json").unlink()


def spoil_metrics(job: Path) -> None:
    text = (job / "metrics.csv").read_text()
    (job / "metrics.csv").write_text(text[: len(text) // 2 - 40])


def change_configuration(job: Path) -> None:
    facts = json.loads((job / "run.json").read_text())
    (job / "run.json").write_text(json.dumps(facts | {"fingerprint": "another"}))


def die(job: Path) -> None:
    """As SIGKILL, or the end of the machine, leaves a job."""
    stamp = status(job)
    process = subprocess.Popen(["true"])
    process.wait()
    (job / "status.json").write_text(json.dumps(stamp | {"status": "running", "pid": process.pid}))
    (job / "metrics.csv").unlink()


SPOILT = {
    "status": (spoil_status, "status.json cannot be read"),
    "status empty": (lambda job: (job / "status.json").write_text(""), "status.json cannot be read"),
    "status binary": (lambda job: (job / "status.json").write_bytes(b"\xff\xfe{}"), "status.json cannot be read"),
    "status a list": (lambda job: (job / "status.json").write_text("[]"), "status.json cannot be read"),
    "status strange": (lambda job: (job / "status.json").write_text('{"status": "fine"}'), "holds an unknown status"),
    "run": (spoil_run, "run.json cannot be read"),
    "configuration": (change_configuration, "belongs to another configuration"),
    "metrics": (spoil_metrics, "metrics.csv cannot be read"),
    "metrics gone": (lambda job: (job / "metrics.csv").unlink(), "metrics.csv cannot be read"),
    "dead": (die, ""),
    "gone": (shutil.rmtree, ""),
}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """A sweep that nothing happened to."""
    folder = tmp_path_factory.mktemp("undisturbed") / "swept"
    assert main(["sweep", *TINY, "plots=false", "filter=ekf", "seed=1,2", f"sweep.dir={folder}"]) == 0
    return folder


@pytest.mark.parametrize("fault", SPOILT)
def test_a_spoilt_job_is_told_kept_and_run_again(fault, undisturbed, capsys):
    shutil.copytree(undisturbed, "swept")
    spoil, message = SPOILT[fault]
    spoil(Path("swept/1_landmark_ekf"))
    capsys.readouterr()
    assert main(["sweep", "--resume", "swept"]) == 0
    assert table() == table(str(undisturbed))
    err = capsys.readouterr().err
    assert "1 of 2 jobs are done, the others will run" in err
    assert message in err
    assert "failed" not in err
    assert Path("swept/attempts/1_landmark_ekf.1").exists() == (fault != "gone")
    assert len(rows("swept/failures.csv")) == (fault != "gone")


def test_the_same_command_with_the_directory_resumes_it_and_another_is_refused(undisturbed, capsys):
    shutil.copytree(undisturbed, "swept")
    before = Path("swept/sweep.csv").read_bytes()
    assert sweep("filter=ekf", "seed=1,2") == 0
    assert Path("swept/sweep.csv").read_bytes() == before, "wall times too: nothing ran"
    capsys.readouterr()
    for other in (["filter=ekf", "seed=1,2,3"], ["filter=ukf", "seed=1,2"], ["filter=ekf", "seed=1,2", "steps=6"]):
        assert sweep(*other) == 2
        assert "swept: holds another sweep (2 jobs, " in capsys.readouterr().err
    assert Path("swept/sweep.csv").read_bytes() == before
    Path("mine").mkdir()
    Path("mine/precious.txt").write_text("mine")
    assert sweep("filter=ekf", "seed=1,2", place="mine") == 2
    assert "sweep.dir must be a sweep's directory or a new one" in capsys.readouterr().err
    assert [path.name for path in Path("mine").iterdir() if path.name[0] != "."] == ["precious.txt"]


@pytest.mark.parametrize(
    "word",
    ["plugins=[evil]", "hydra.launcher.setup=[rm]", "hydra.searchpath=[.]", "--config-dir=.", "+hydra/callbacks=evil"],
)
def test_what_a_strangers_directory_could_run_must_be_typed(word, undisturbed, capsys):
    shutil.copytree(undisturbed, "swept")
    plan = json.loads(Path("swept/sweep.json").read_text())
    Path("swept/sweep.json").write_text(json.dumps(plan | {"arguments": [*plan["arguments"], word]}))
    capsys.readouterr()
    assert main(["sweep", "--resume", "swept"]) == 2
    assert f"swept: {word} of its command is used only if you type it" in capsys.readouterr().err


def test_a_second_sweep_on_a_directory_is_told_and_the_child_dies_with_the_first(capsys):
    words = ["scenario=landmark", "filter=ekf", "runs=3000000", "sweep.timeout=1000", "sweep.dir=busy"]
    process = started(*words)
    with process:
        wait_for(lambda: count("busy", "running") == 1)
        assert main(["sweep", *words]) == 2
        assert f"another sweep is at work there (process {process.pid} on " in capsys.readouterr().err
        at_work = status("busy/0_landmark_ekf")["pid"]
        assert lives(at_work)
        assert at_work != process.pid
        process.kill()
    wait_for(lambda: not lives(at_work))
    with state.locked(Path("busy")):
        pass  # the lock went with its process


def test_a_job_that_an_earlier_sweep_left_at_work_is_not_run_twice(undisturbed, capsys):
    shutil.copytree(undisturbed, "swept")
    job = Path("swept/1_landmark_ekf")
    with subprocess.Popen(["sleep", "60"]) as other:
        (job / "status.json").write_text(json.dumps(status(job) | {"status": "running", **marks_of(other.pid)}))
        assert main(["sweep", "--resume", "swept"]) == 2
        assert f"process {other.pid} of an earlier sweep is still at work on it" in capsys.readouterr().err
        other.kill()
    assert main(["sweep", "--resume", "swept"]) == 0


def test_control_c_leaves_tables_and_says_how_to_go_on(capsys):
    process = started("scenario=landmark", "filter=ekf", "runs=2,3000000", "steps=5", "sweep.dir=stopped")
    wait_for(lambda: count("stopped", "running") == 1 and count("stopped", "ok") == 1)
    process.send_signal(signal.SIGTERM)  # as Ctrl-C, which a shell's background jobs ignore
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err == f"estlab: interrupted; continue with estlab sweep --resume {Path('stopped').resolve()}\n"
    assert [row["status"] for row in table("stopped")] == ["ok", "left"]


@pytest.fixture
def children(monkeypatch):
    """The processes that jobs with a limit run in."""
    found = []

    class Popen(subprocess.Popen):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            found.append(self)

    monkeypatch.setattr(child.subprocess, "Popen", Popen)
    return found


def test_a_job_that_takes_too_long_is_ended(children, capsys):
    words = ["plots=false", "scenario=landmark", "filter=ekf", "runs=3000000", "sweep.timeout=2.5", "sweep.dir=swept"]
    assert main(["sweep", *words]) == 1
    assert children[0].returncode == -signal.SIGKILL
    assert "took longer than sweep.timeout=2.5 s and was ended" in capsys.readouterr().err
    assert status("swept/0_landmark_ekf")["status"] == "failed"


def test_a_limit_that_is_not_reached_changes_no_figure(undisturbed, children):
    assert sweep("filter=ekf", "seed=1,2", "sweep.timeout=300") == 0
    assert len(children) == 2
    assert table() == table(str(undisturbed))


def test_a_job_whose_process_says_nothing_failed(monkeypatch):
    monkeypatch.setattr(child.sys, "executable", "/bin/sh")  # which takes none of our flags
    assert sweep("filter=ekf", "seed=1", "sweep.timeout=300") == 1
    (failure,) = rows("swept/failures.csv")
    assert failure["error"].startswith("its process ended with exit code")


def test_a_directory_that_cannot_be_made_fails_its_job_alone(monkeypatch):
    def claim(path: Path, *more: object, **facts: object) -> rundir.RunDirectory:
        if path.name == "1_landmark_ekf":
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return rundir.RunDirectory(path, *more, **facts)

    with monkeypatch.context() as patch:
        patch.setattr(job, "RunDirectory", claim)
        assert sweep("filter=ekf", "seed=1,2,3") == 3
    assert [row["status"] for row in table()] == ["ok", "failed", "ok"]
    assert "1_landmark_ekf" in rows("swept/failures.csv")[0]["error"]


def test_workers_of_an_engine_end_with_the_sweep_that_is_killed():
    pytest.importorskip("joblib")
    process = started("scenario=landmark", "filter=ekf", "runs=3000000", "seed=1,2", "sweep.dir=killed", *JOBLIB)
    with process:
        wait_for(lambda: count("killed", "running") == 2)
        workers = [status(folder)["pid"] for folder in Path("killed").glob("[01]_*")]
        process.kill()
    wait_for(lambda: not any(lives(worker) for worker in workers))


def test_a_terminal_that_closes_interrupts_and_nohup_keeps_it_from_that(monkeypatch):
    before = signal.getsignal(signal.SIGHUP)
    try:
        monkeypatch.setattr(experiment, "run", lambda *_: os.kill(os.getpid(), signal.SIGHUP))
        words = ["run", *TINY, "filter=ekf", "report=false", "hydra.run.dir=closed"]
        assert main(words) == 130
        assert status("closed")["status"] == "interrupted"
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        interruptible()
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
