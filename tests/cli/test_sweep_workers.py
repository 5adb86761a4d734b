"""Jobs are composed once, and run on all cores of this machine, with the same figures as in turn."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from estlab.cli.main import main
from estlab.launch.composition import CheckedLoader
from tests.cli.sweeping import TINY, count, job_folders, status, sweep, table, wait_for
from tests.conftest import ROOT

pytestmark = pytest.mark.slow

SIX = ["filter=ekf,ukf", "seed=1,2,3"]
LONG = ["scenario=sonar", "filter=pf", "filter.particles=5000", "runs=2000", "seed=range(1,5)"]


def started(*words: str, **options) -> "subprocess.Popen[str]":
    """A sweep of two workers in a process of its own."""
    command = [sys.executable, "-m", "estlab", "sweep", "plots=false", "sweep.workers=2", *words]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, **options
    )


def lives(pid: int) -> bool:
    """Whether a process runs, and is not just waiting to be asked for its exit code."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def at_work(place: str) -> list[int]:
    """The processes of the jobs that are running."""
    found = [status(Path(place) / folder) for folder in job_folders(place)]
    return [one["pid"] for one in found if one["status"] == "running"]


def test_jobs_that_differ_in_numbers_alone_are_composed_once(monkeypatch):
    composed = []
    real = CheckedLoader.load_configuration

    def counted(self, *arguments, **options):
        composed.append(arguments)
        return real(self, *arguments, **options)

    monkeypatch.setattr(CheckedLoader, "load_configuration", counted)
    assert sweep(*SIX) == 0
    assert len(composed) == 1 + 2, "the sweep, and the jobs of each filter"


def test_a_jobs_files_say_what_was_typed_for_it_in_the_words_of_a_run():
    assert sweep("filter=ekf", "noise.filter.process_scale=1,2", "output='my runs'") == 0
    assert main(["run", *TINY, "filter=ekf", "noise.filter.process_scale=2", "expect=null", "expect_files=null",
                 "report=false", "plots=false", "output='my runs'", "hydra.run.dir=alone"]) == 0  # fmt: skip
    job = Path("swept/1_landmark_ekf")
    lines = [[line for line in (folder / "config.yaml").read_text().splitlines() if " dir: " not in line]
             for folder in (job, Path("alone"))]  # fmt: skip
    assert lines[0] == lines[1]
    typed = (job / "overrides.yaml").read_text().splitlines()
    assert "- noise.filter.process_scale=2" in typed
    for file in ("metrics.csv", "errors.csv", "runs.csv"):
        assert (job / file).read_bytes() == (Path("alone") / file).read_bytes()


def test_callbacks_of_the_users_are_given_each_jobs_whole_configuration(tmp_path, monkeypatch, capsys):
    Path("mine.py").write_text(
        "from hydra.experimental.callback import Callback\n"
        "class Told(Callback):\n"
        "    def on_job_start(self, config, **_):\n"
        "        with open('told.txt', 'a') as file:\n"
        "            job = config.hydra.job.num, config.seed, config.scenario.duration, config.hydra.sweep.subdir\n"
        "            print(*job, file=file)\n"
    )
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    assert sweep("seed=3,4", "plugins=[mine]", "+hydra.callbacks.told._target_=mine.Told") == 0
    assert Path("told.txt").read_text() == "0 3 0.5 0_landmark_ukf\n1 4 0.5 1_landmark_ukf\n"


@pytest.mark.skipif(sys.platform != "linux", reason="workers are forked on Linux")
def test_jobs_on_two_cores_find_what_they_find_in_turn():
    assert sweep(*SIX, place="in_turn") == 0
    process = started(*TINY, *SIX, "sweep.dir=forked")
    assert (process.communicate()[1], process.returncode) == ("", 0)
    assert table("forked") == table("in_turn")
    pids = {status(Path("forked") / folder)["pid"] for folder in job_folders("forked")}
    assert process.pid not in pids
    assert len(pids) == 2


@pytest.mark.skipif(sys.platform != "linux", reason="workers are forked on Linux")
def test_a_worker_that_is_killed_costs_its_job_a_second_attempt_and_nothing_else():
    process = started(*LONG, "sweep.dir=killed", "scenario.duration=0.5")
    wait_for(lambda: len(at_work("killed")) == 2)
    os.kill(at_work("killed")[0], signal.SIGKILL)
    errors = process.communicate()[1]
    assert (process.returncode, count("killed", "ok")) == (0, 4), errors
    assert len(list(Path("killed/attempts").iterdir())) == 1


@pytest.mark.skipif(sys.platform != "linux", reason="workers are forked on Linux")
@pytest.mark.parametrize("ended", ["interrupted", "killed"])
def test_workers_end_with_their_sweep(ended):
    process = started(*LONG, "sweep.dir=ended", start_new_session=True)
    wait_for(lambda: len(at_work("ended")) == 2 and len(list(Path("ended").glob("*/log.txt"))) == 2)
    pids = at_work("ended")
    if ended == "killed":
        process.kill()
    else:
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to all of its processes
    process.communicate()
    wait_for(lambda: not any(map(lives, pids)))
    assert process.returncode == (130 if ended == "interrupted" else -signal.SIGKILL)
    words = [status(Path("ended") / folder)["status"] for folder in job_folders("ended")]
    assert words == (["interrupted"] * 2 if ended == "interrupted" else ["running"] * 2)


def test_workers_are_a_whole_number(capsys):
    assert sweep("seed=1,2", "sweep.workers=0") == 2
    assert "sweep.workers" in capsys.readouterr().err
