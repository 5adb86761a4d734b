"""Who is at work: a process is known by more than its number."""

import json
import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from estlab.rundir import RunDirectory, process, worker
from estlab.rundir.finished import unfinished

OURS = process.marks()
OLD = {"pid": os.getpid(), "node": OURS["node"], "began": "2100-01-01T00:00:00+00:00"}  # an earlier estlab's
GONE = 2**22 + 1  # a number that Linux gives to none


def test_a_run_is_the_work_of_its_own_process(tmp_path):
    RunDirectory(tmp_path / "run")
    status = json.loads((tmp_path / "run/status.json").read_text())
    assert worker(status) == "alive"
    assert unfinished(status) == "still running"
    assert worker(status | {"status": "interrupted"}) == "gone"


@pytest.mark.parametrize(
    ("marks", "life"),
    [
        (OURS, "alive"),
        (OURS | {"pid": GONE}, "gone"),
        (OURS | {"pid": 1}, "gone"),  # which is there, but began at another time
        (OURS | {"boot": "another"}, "gone"),
        (OURS | {"node": "another"}, "unknown"),
        (OURS | {"node": "another", "boot": "another"}, "unknown"),
        (OURS | {"namespace": "another"}, "unknown"),
        (OURS | {"pid": "1"}, "unknown"),
        (OURS | {"pid": True}, "unknown"),
        (OURS | {"pid": 2**40}, "unknown"),
        ({}, "unknown"),
        (OLD, "alive"),
        (OLD | {"pid": GONE}, "gone"),
        (OLD | {"began": "2000-01-01T00:00:00+00:00"}, "gone"),  # before the process with its number
        (OLD | {"node": "another"}, "unknown"),
    ],
)
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="numbers of processes are those of Linux")
def test_a_process_is_known_by_number_machine_boot_and_beginning(marks, life):
    assert process.life(marks) == life


def test_another_program_with_the_number_is_not_an_earlier_estlab():
    with subprocess.Popen(["sleep", "60"]) as other:
        assert process.life(OLD | {"pid": other.pid}) == "gone"
        other.kill()


@pytest.mark.parametrize("look", ["_seen", "_seen_by_ps"])
def test_a_zombie_is_dead(look, monkeypatch):
    monkeypatch.setattr(process, "_seen", getattr(process, look))
    other = subprocess.Popen(["sleep", "60"])
    if process._seen(other.pid) is None:
        other.kill()
        other.wait()
        pytest.skip("there is no ps on this machine")
    marks = process.marks() | {"pid": other.pid, "process_began": process._seen(other.pid).began}
    assert process.life(marks) == "alive"
    other.send_signal(signal.SIGKILL)
    while not process._seen(other.pid).zombie:
        time.sleep(0.001)
    assert process.life(marks) == "gone"
    other.wait()
    assert process.life(marks) == "gone"


def test_without_any_view_of_processes_one_that_answers_is_alive(monkeypatch):
    monkeypatch.setattr(process, "_seen", lambda pid: None)
    marks = process.marks()
    assert marks["process_began"] is None
    assert process.life(marks) == "alive"
    assert process.life(marks | {"pid": GONE}) == "gone"
