"""Pieces of a job in several processes: each done once, and whatever happens told as in one process."""

import logging
import multiprocessing
import os
import time
from collections import Counter
from functools import partial

import pytest

from estlab.errors import UserError, WorkerLostError
from estlab.parallel import cores, pool
from estlab.parallel.pool import Workers
from tests.tasks import STEPS, work


@pytest.fixture(autouse=True)
def _by_import(monkeypatch):
    """Workers that import everything, as where a process cannot be forked; tests/cli has those that are forked."""
    monkeypatch.setattr(pool, "can_fork", lambda: False)


def together(what, tasks, wanted=2):
    """The tasks' results by number, the steps counted, and how many processes there were."""
    counted = Counter()
    job = partial(work, what)
    with Workers(job, range(tasks), wanted) as pool:
        results = list(pool.results(job, lambda steps: counted.update(steps=steps)))
    assert multiprocessing.active_children() == []
    return results, counted["steps"], pool.cores


@pytest.mark.parametrize(("tasks", "wanted"), [(1, 3), (2, 2), (7, 3)])
def test_every_task_is_done_once_and_every_step_counted(tasks, wanted):
    results, steps, processes = together(None, tasks, wanted)
    assert sorted(number for number, _ in results) == list(range(tasks))
    assert all(number == answered for number, (answered, _) in results)
    assert steps == STEPS * tasks
    assert processes == min(tasks, wanted)
    done_by = {number: process for number, (_, process) in results}
    assert done_by[0] == os.getpid()
    assert tasks == 1 or done_by[1] != os.getpid()


def test_a_job_too_small_to_pay_for_workers_that_import_everything_has_none():
    results, _, processes = together(None, 7, None)
    assert processes == 1
    assert {process for _, (_, process) in results} == {os.getpid()}


def test_workers_come_once_the_first_task_has_shown_that_they_pay(monkeypatch):
    monkeypatch.setattr(cores, "usable", lambda: 2)

    def slow(number, on_step):
        time.sleep(0.6 if number == 0 else 0.0)
        return number, os.getpid()

    with Workers(partial(work, None), range(9), None) as pool:
        results = dict(pool.results(slow, lambda steps: None))
    assert sorted(results) == list(range(9))
    assert len({process for _, process in results.values()}) == pool.cores == 2


@pytest.mark.parametrize("tasks", [2, 3])
def test_what_workers_finish_while_this_process_is_at_its_first_task_is_not_lost(tasks):
    done = set()

    def slow(number, on_step):
        while len(done) < tasks - 1 and number == 0:
            time.sleep(0.01)
            on_step()
        return number, os.getpid()

    with Workers(partial(work, None), range(tasks), tasks) as pool:
        receive = pool._receive

        def heard(end, kind, content):
            receive(end, kind, content)
            done.update(number for number, _ in pool._finished)

        pool._receive = heard
        results = dict(pool.results(slow, lambda steps: None))
    assert sorted(results) == list(range(tasks))


@pytest.mark.parametrize(
    "error", [UserError("write it otherwise"), MemoryError("no room"), ZeroDivisionError("one over nothing")]
)
def test_what_a_worker_raises_is_raised_here_with_its_traceback(error):
    with pytest.raises(type(error), match=str(error)) as caught:
        together(error, 2)
    assert "in a worker process:" in caught.value.__notes__[0]
    assert "tests/tasks.py" in caught.value.__notes__[0]
    assert multiprocessing.active_children() == []


def test_an_error_that_cannot_be_pickled_is_said():
    with pytest.raises(RuntimeError, match="TwoWordsError: one other"):
        together("two words", 2)


def test_a_worker_that_wants_to_exit_does_not_end_in_silence():
    with pytest.raises(SystemExit):
        together("exit", 2)


def test_a_killed_worker_is_one_line_that_names_the_remedy():
    with pytest.raises(WorkerLostError, match="SIGKILL, as the system does when memory runs out; set cores=1"):
        together("die", 3)
    assert multiprocessing.active_children() == []


def test_warnings_of_workers_are_warned_here():
    with pytest.warns(RuntimeWarning, match="task 1"):
        together("warn", 2)


def test_what_workers_log_is_logged_here(caplog):
    with caplog.at_level(logging.INFO, logger="estlab"):
        logging.getLogger("estlab").addHandler(caplog.handler)
        try:
            together("log", 2)
        finally:
            logging.getLogger("estlab").removeHandler(caplog.handler)
    assert "task 1" in caplog.messages


@pytest.mark.parametrize(
    ("files", "expected"),
    [({"max": "150000 100000"}, 2), ({"max": "max 100000"}, 64), ({"quota": "100000", "period": "100000"}, 1),
     ({"quota": "-1", "period": "100000"}, 64), ({}, 64), ({"max": "50000 100000"}, 1)],
)  # fmt: skip
def test_a_containers_share_of_time_limits_the_cores(files, expected, tmp_path, monkeypatch):
    for name, text in files.items():
        (tmp_path / name).write_text(f"{text}\n")
    monkeypatch.setattr(cores, "_QUOTA", (tmp_path / "max", tmp_path / "quota"))
    monkeypatch.setattr(cores, "_PERIOD", tmp_path / "period")
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(64)), raising=False)
    assert cores.usable() == expected


def test_a_process_of_a_pool_leaves_the_cores_to_the_pool(monkeypatch):
    monkeypatch.setattr(cores, "usable", lambda: 8)
    assert cores.processes(None, 100) == 8
    assert cores.processes(None, 3) == 3
    assert cores.processes(20, 100) == 20
    monkeypatch.setattr(multiprocessing, "parent_process", lambda: "a pool")
    assert cores.processes(None, 100) == 1
    assert cores.processes(2, 100) == 2
    monkeypatch.setitem(multiprocessing.current_process()._config, "daemon", True)
    assert cores.processes(2, 100) == 1, "it may start none"


def test_linear_algebra_has_one_thread_meanwhile_unless_the_user_says_how_many(monkeypatch):
    for name in cores._THREADS:
        monkeypatch.delenv(name, raising=False)
    count, set_count = cores._openblas()
    before = count()
    set_count(2)
    try:
        with pytest.raises(AttributeError), cores.one_thread_meanwhile():
            assert count() == 1
            raise AttributeError("of the body")
        assert count() == 2
        monkeypatch.setenv("OMP_NUM_THREADS", "2")
        with cores.one_thread_meanwhile():
            assert count() == 2
    finally:
        set_count(before)
