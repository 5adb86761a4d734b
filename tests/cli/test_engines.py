"""The same sweep by other engines: the same table, and a worker that dies takes its own job alone."""

import contextlib
import json
import logging
import os
import signal
import threading
from importlib.util import find_spec
from pathlib import Path

import pytest

from estlab.cli.main import main
from tests.cli.sweeping import TINY, count, rows, status, sweep, table, wait_for
from tests.conftest import ROOT

pytestmark = pytest.mark.slow

WORDS = ["filter=ekf,ukf", "seed=1,2"]


def needs(module: str, extra: str) -> pytest.MarkDecorator:
    try:
        found = find_spec(module) is not None
    except ModuleNotFoundError:
        found = False
    return pytest.mark.skipif(not found, reason=f"{module} is not installed: pip install 'estlab[{extra}]'")


dask = needs("distributed", "dask")


@pytest.fixture
def scheduler():
    """The address of a scheduler on loopback, with two workers that are processes."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=":0", silence_logs=logging.CRITICAL
    ) as cluster:
        yield cluster.scheduler_address


@dask
def test_dask_gives_the_table_of_the_basic_launcher(scheduler, capsys):
    assert sweep(*WORDS, place="basic") == 0
    assert sweep(*WORDS, "hydra/launcher=dask", f"hydra.launcher.address={scheduler}", place="dask") == 0
    assert table("dask") == table("basic")
    assert capsys.readouterr().err == ""
    workers = {status(f"dask/{row['job']}")["pid"] for row in table("dask")}
    assert os.getpid() not in workers


@dask
def test_dask_starts_workers_of_its_own():
    words = ["hydra/launcher=dask", "hydra.launcher.workers=1", "block_runs=1", "keep_runs=1"]
    assert sweep("seed=1,2", *words, place="dask") == 0
    facts = [json.loads(Path("dask", row["job"], "run.json").read_text()) for row in table("dask")]
    assert [one["cores"] for one in facts] == [1, 1], "its workers share the cores, so their jobs do not"
    assert len({status(f"dask/{row['job']}")["pid"] for row in table("dask")} - {os.getpid()}) == 1


@dask
def test_its_own_workers_keep_memory_that_is_freed_for_the_next_array(monkeypatch):
    from hydra_plugins.estlab_sweeps.dask_launcher import DaskLauncher

    monkeypatch.delenv("MALLOC_TRIM_THRESHOLD_", raising=False)  # Dask leaves it in a process that had a cluster
    with DaskLauncher(None, 1, 3, 10.0)._client() as client:
        for name, value in (("MALLOC_TRIM_THRESHOLD_", None), ("OPENBLAS_NUM_THREADS", "1")):
            assert set(client.run(os.getenv, name).values()) == {value}


@dask
def test_workers_that_are_killed_take_their_own_jobs_alone_which_run_again(scheduler):
    words = ["scenario=landmark", "steps=100", "runs=10", "filter=pf", "plots=false", "seed=1,2,3,4,5"]
    killed = {}

    def kill_both_first_workers():
        # Both, so that what only one of them holds is lost.
        while len(killed) < 2:
            wait_for(lambda: count("dask", "running") > 0)
            for path in Path("dask").glob("*/status.json"):
                with contextlib.suppress(OSError, ValueError):
                    stamp = status(path.parent)
                    if stamp["status"] == "running" and stamp["pid"] not in killed:
                        os.kill(stamp["pid"], signal.SIGKILL)
                        killed[stamp["pid"]] = path.parent.name
                        break

    killer = threading.Thread(target=kill_both_first_workers)
    killer.start()
    engine = ["hydra/launcher=dask", f"hydra.launcher.address={scheduler}"]
    assert main(["sweep", *words, *engine, "sweep.dir=dask"]) == 0
    killer.join()
    assert sorted(row["job"] for row in rows("dask/failures.csv")) == sorted(killed.values())
    assert main(["sweep", *words, "sweep.dir=basic"]) == 0
    assert table("dask") == table("basic")


@dask
@pytest.mark.parametrize("word", ["workers=0", "workers=x", "allowed_failures=-1", "patience=nan"])
def test_dask_is_given_no_number_that_it_would_wait_for_without_end(word, capsys):
    assert sweep("seed=1,2", "hydra/launcher=dask", f"hydra.launcher.{word}") == 2
    assert f"hydra.launcher.{word.partition('=')[0]} must be a" in capsys.readouterr().err.splitlines()[-1]


@dask
def test_an_address_without_a_scheduler_is_said_in_one_line(capsys):
    from distributed.utils import open_port

    address = f"tcp://127.0.0.1:{open_port()}"
    assert (
        sweep("seed=1,2", "hydra/launcher=dask", f"hydra.launcher.address={address}", "hydra.launcher.patience=0.5")
        == 2
    )
    err = capsys.readouterr().err
    assert f"hydra.launcher.address={address}: no scheduler answers there" in err
    assert err.count("\n") == 1


@needs("hydra_plugins.hydra_joblib_launcher", "joblib")
def test_joblib_gives_the_table_of_the_basic_launcher():
    from joblib.externals.loky import get_reusable_executor

    try:
        assert sweep("seed=1,2", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2", place="joblib") == 0
    finally:
        get_reusable_executor().shutdown(wait=True)
    assert sweep("seed=1,2", place="basic") == 0
    assert table("joblib") == table("basic")


@needs("hydra_plugins.hydra_submitit_launcher", "submitit")
def test_submitit_on_this_machine_gives_the_table_of_the_basic_launcher(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    assert sweep("seed=1,2", "hydra/launcher=submitit_local", place="submitit") == 0
    assert sweep("seed=1,2", place="basic") == 0
    assert table("submitit") == table("basic")


@pytest.mark.parametrize("engine", ["dask", "joblib", "ray", "submitit_local", "submitit_slurm"])
def test_an_engine_that_is_not_installed_names_what_installs_it(engine, monkeypatch, capsys):
    import estlab.launch.arguments

    monkeypatch.setattr(estlab.launch.arguments.importlib.util, "find_spec", lambda name: None)
    assert main(["sweep", *TINY, f"hydra/launcher={engine}"]) == 2
    extra = engine.partition("_")[0]
    assert f"hydra/launcher={engine} needs more: pip install 'estlab[{extra}]'" in capsys.readouterr().err
