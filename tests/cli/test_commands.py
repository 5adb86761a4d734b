"""The commands as a user types them: output, files, exit codes."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

import estlab
from estlab import __version__
from estlab.cli.main import main
from estlab.experiment import statistics
from estlab.filters.engine import CompiledLoop
from estlab.metrics import tabulated
from tests.conftest import ROOT

TINY = ["runs=4", "steps=15"]
COMMANDS = ("run", "sweep", "verify", "compare", "report", "rerun", "clean", "simulate", "list")


def latest() -> Path:
    return Path("runs/latest").resolve()


def status(folder: Path) -> dict:
    return json.loads((folder / "status.json").read_text())


def test_help_and_version_name_every_command(capsys):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    assert all(f"estlab {command}" in text for command in COMMANDS)
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"estlab {__version__}\n"


@pytest.mark.parametrize("command", ["", "list", "compare", "rerun", "clean", "verify", "report"])
def test_a_help_is_80_columns_wide_and_shown_whatever_else_is_typed(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert main([*command.split(), "--help"]) == 0
    text = capsys.readouterr().out
    assert text.startswith(f"usage: estlab {command}")
    assert max(map(len, text.splitlines())) <= 80
    assert main([*command.split(), "-h", "--nothing-like-it"]) == 0
    assert capsys.readouterr() == (text, "")


def test_help_version_and_list_import_nothing_heavy():
    code = (
        "import sys; from estlab.cli.main import main; main(['--help']); main(['--version']); main(['list']);"
        "heavy = {'numpy', 'scipy', 'pandas', 'matplotlib', 'hydra', 'rich', 'yaml', 'subprocess', 'estlab.rundir'};"
        "print(sorted(heavy & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.endswith("[]\n")


def test_list_shows_what_is_in_conf(capsys):
    assert main(["list"]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in ("scenarios", "car", "landmark", "ukf", "dead_reckoning", "smoke"))
    assert main(["list", "filters"]) == 0
    assert "scenarios" not in capsys.readouterr().out
    assert main(["list", "fruits"]) == 2
    Path("mine/scenario").mkdir(parents=True)
    Path("mine/scenario/kite.yaml").write_text("# A kite in the wind\n# @package _group_\n_target_: kite.Kite\n")
    Path("mine/scenario/bytes.yaml").write_bytes(b"# \x1b[31m\xff\n")
    capsys.readouterr()
    assert main(["list", "scenarios", "--config-dir", "mine"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"^  kite +A kite in the wind$", out, re.MULTILINE)
    assert re.search(r"^  car ", out, re.MULTILINE)
    assert "\x1b" not in out


def test_a_run_writes_everything_the_contract_names(capsys):
    assert main(["run", "scenario=car", "filter=ukf", *TINY]) == 0
    folder = latest()
    assert re.fullmatch(r"\d\d-\d\d-\d\d-\d{6}_car_ukf", folder.name)
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", folder.parent.name)
    files = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    tables = {"errors.csv", "nees.csv", "nis.csv", "notes.csv", "metrics.csv", "estimates.npz"}
    tables |= {"runs.csv", "tests.csv", "verdicts.csv", "coverage.csv", "histograms.csv"}
    records = {"config.yaml", "overrides.yaml", "run.json", "status.json", "log.txt", "report.html"}
    assert files == tables | records | {f"plots/{name}.png" for name in ("errors", "nees", "nis", "trajectory")}
    assert status(folder)["status"] == "ok"

    run = json.loads((folder / "run.json").read_text())
    assert run["seed"] == 1
    assert run["command"] == ["estlab", "run", "scenario=car", "filter=ukf", *TINY]
    assert {"estlab", "python", "packages", "git", "machine", "data", "wall_time_s", "peak_memory_mb"} <= set(run)
    assert yaml.safe_load((folder / "overrides.yaml").read_text()) == ["scenario=car", "filter=ukf", *TINY]
    assert yaml.safe_load((folder / "config.yaml").read_text())["filter"]["alpha"] == 1.0

    errors = pd.read_csv(folder / "errors.csv")
    assert len(errors) == 15 * 6
    np.testing.assert_allclose(errors["upper3"], 3 * errors["sigma"])
    with np.load(folder / "estimates.npz") as arrays:
        assert arrays["mean"].shape == (6, 15, 4)
        assert arrays["cov"].shape == (6, 6, 15, 4)
        first = arrays["mean"][:, :, 0] - arrays["truth"][:, :, 0]
    np.testing.assert_allclose(errors[errors["component"] == "length"]["error"], first[4], atol=1e-12)
    metrics = pd.read_csv(folder / "metrics.csv")
    assert list(metrics.columns) == ["filter", "metric", "component", "unit", "value", "ci_low", "ci_high", "n", "seed"]
    nees = pd.read_csv(folder / "nees.csv")
    assert list(nees.columns) == ["filter", "time", "anees", "expected", "lower", "upper", "runs_scored", "seed"]
    out = capsys.readouterr().out
    assert "RMSE" in out
    assert str(Path("runs") / folder.parent.name / folder.name) in out


def test_tables_of_the_ensemble_are_those_of_the_kept_runs():
    """Every figure again, from the estimates alone, by other code."""
    run = estlab.run("scenario=landmark", "filter=ekf", runs=5, steps=40, save=False)
    found = run.estimates["ekf"]
    truth, mean, cov = (np.moveaxis(array, -1, 0) for array in (found.truth, found.mean, found.cov))
    error = mean - truth
    error[:, 2] = np.arctan2(np.sin(error[:, 2]), np.cos(error[:, 2]))
    metrics = run.metrics.set_index(["metric", "component"])["value"]
    np.testing.assert_allclose(metrics["rmse", "y"], np.sqrt((error[:, 1] ** 2).mean()))
    np.testing.assert_allclose(metrics["rmse", "position"], np.sqrt((error[:, :2] ** 2).sum(axis=1).mean()))
    nees = [
        [e @ np.linalg.solve(p, e) for e, p in zip(es.T, np.moveaxis(ps, -1, 0), strict=True)]
        for es, ps in zip(error, cov, strict=True)
    ]
    np.testing.assert_allclose(metrics["anees", "all"], np.mean(nees) / 3)
    np.testing.assert_allclose(run.nees["anees"], np.mean(nees, axis=0) / 3)
    medians = np.median(np.abs(error[:, 0]), axis=1)
    np.testing.assert_allclose(metrics["median_abs_error", "x"], medians.mean())
    sigma = np.sqrt(cov[:, 2, 2])
    np.testing.assert_allclose(metrics["inside_3sigma", "heading"], (np.abs(error[:, 2]) <= 3 * sigma).mean())


def test_the_same_run_gives_the_same_tables_whatever_the_block():
    one, other = (
        estlab.run("scenario=landmark", runs=7, steps=30, keep_runs=2, block_runs=block, save=False)
        for block in (500, 3)
    )
    np.testing.assert_allclose(one.metrics["value"], other.metrics["value"], rtol=1e-10)
    np.testing.assert_allclose(one.metrics["ci_low"], other.metrics["ci_low"], rtol=1e-9)
    for name in ("mean", "cov", "truth"):
        arrays = (getattr(run.estimates["ukf"], name) for run in (one, other))
        np.testing.assert_allclose(*arrays, rtol=1e-10, atol=1e-12)


def test_a_wrong_key_is_one_line_and_leaves_no_directory(capsys):
    assert main(["run", "filter.alhpa=1"]) == 2
    assert capsys.readouterr().err == "estlab: unknown key filter.alhpa; did you mean filter.alpha?\n"
    assert main(["run", "+filter.alhpa=1"]) == 2
    assert capsys.readouterr().err == "estlab: unknown key filter.alhpa; did you mean filter.alpha?\n"
    assert not Path("runs").exists() or not any(Path("runs").iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "filter=ukff"], "there is no filter ukff; did you mean ukf? (one of "),
        (["run", "filter=[ekf,ekf]"], "name each filter once in one list"),
        (["sweep", "filter=[ekf,ukf],pf"], "lists cannot be swept"),
        (["run", "scenario=[car,field]"], "a run has one scenario"),
        (["run", "+experiment=field_errors", "filter=ukf"], "the experiment has its own filters, ekf,pf; leave it out"),
        (["run", "filter=[ekf,ukf]", "filters.ukf.alhpa=1"], "did you mean filters.ukf.alpha?"),
        (["run", "experiment=smoke"], "write +experiment=smoke"),
        (["run", "--runs=1"], "unknown flag --runs=1; write runs=1 without dashes"),
        (["run", "output="], "output must be a folder"),
        (["run", "plugins=[no_such_package]"], "Python finds no package 'no_such_package'"),
        (["run", "filter.alpha=${undefined}"], "Interpolation key 'undefined' not found"),
        (["run", "scenario.duration=0.01"], "scenario.duration must be from one to ten million steps"),
        (["run", "filter=pf", "filter.particles=1e9"], "filter.particles must be from 2 to 2e7"),
        (["simulate", "scenario=radar", "data.path=made"], "Radar has no file layout to write"),
        (["run", "fliter=ukf"], "unknown key fliter; did you mean filter?"),
        (
            ["run", "filter=[ekf,pf]", "filters.pf.resample_below=1"],
            "filters.pf takes particles, resampling, threshold",
        ),
        (["run", "+experiment=field_errors", "filters.pf.partcles=9"], "did you mean filters.pf.particles?"),
        (
            ["run", "filter=[ekf,pf]", "filter.gate=0.9"],
            "would not be used, because there are several filters; write filters.<ekf|pf>.gate",
        ),
        (["run", "filter=ekf", "filters.pf.particles=9"], "none of these filters is called pf"),
        (["sweep", "filter=pf,ukf", "filter.particels=9,10"], "did you mean filter.particles?"),
        (["run", "+expriment=smoke"], "unknown key expriment; did you mean +experiment?"),
        (["run", "+experiment=smok"], "there is no experiment smok; did you mean smoke? (one of car_document, "),
        (["run", "hydra/lancher=dask"], "unknown key hydra/lancher; did you mean hydra/launcher?"),
        (["run", "hydra.rnu.dir=x"], "unknown key hydra.rnu.dir; did you mean hydra.run.dir?"),
        (["run", "~filter.alhpa"], "unknown key filter.alhpa; did you mean filter.alpha?"),
        (["run", "--config-dir", "nowhere"], "--config-dir: there is no folder"),
        (["run", "--confg-dir", "x"], "unknown flag --confg-dir; did you mean --config-dir?"),
        (["sweep", "--resme", "x"], "unknown flag --resme; did you mean --resume?"),
        (["run", "seed=a b]", "runs=2"], "seed=a b]: write key=value"),
        (["list", "experimnts"], "got experimnts; did you mean experiments?"),
        (["list", "--config-dir", "nowhere"], "--config-dir takes a folder of configuration, got 'nowhere'"),
        (["list", "--cfg", "job"], "estlab list has no --cfg (see estlab list --help)"),
        (["simulate", "dta.path=x"], "unknown key dta.path; did you mean data.path?"),
        (["run", "seed=1e30"], "seed is too large"),
        (["run", "filter=ekf", "filter.alpha=1"], "unknown key filter.alpha; filter takes noise, gate"),
        (["run", "filter.kappa=-6"], "filter.kappa must be > -n = -6 for 6 dimensions, got -6"),
        (["run", "filter.alpha=="], "filter.alpha==: write key=value"),
        (["run", "data.path=somewhere"], "data.path=somewhere would not be read: add data=files"),
        (["run", "output=/proc/estlab"], "set output or --config-dir to another"),
        (["run", "scenario=landmark", "data=files", "data.path=nowhere"], "data.path: no folder nowhere"),
        (["run", "data=files", "data.path=."], "problem3data.mat: no such file; data.path must be the folder"),
        (["simulate"], "data.path is required"),
        (["rnu"], "unknown command rnu; did you mean run?"),
        (["run", "parts={}"], "parts={}: is a list; write parts=[...]"),
        (["run", "sweep=[]"], "sweep=[]: is a group of keys; write sweep={...}"),
        (["run", "hydra.mode=x"], "hydra.mode=x: Invalid value 'x'"),
        (["run", "scenario=null"], "scenario=null: write the name of one"),
        (["run", "scenario=/etc/passwd"], "there is no scenario /etc/passwd (one of car, "),
        (["run", "~scenario"], "scenario is missing, but every run needs one"),
        (["run", "~filter"], "filter is missing, but every run needs one"),
        (["run", "~filters"], "filters is missing"),
        (["run", "filters=2.5"], "filters must be "),
        (["run", "~sweep.dir"], "sweep.dir is missing, but other keys refer to it"),
        (["run", "hydra.run.dir=???"], "hydra.run.dir must be a folder"),
        (["run", "hydra.run.dir="], "hydra.run.dir must be a folder"),
        (["sweep", "sweep.dir=null"], "sweep.dir must be a folder"),
        (["run", "=1"], "'=1': write key=value"),
        (["run", "data=[1,2]"], "data=[1,2]: write the name of one"),
        (["run", "filter=???"], "filter=???: write the name of one"),
        (["run", "scenario=car,field"], "scenario=car,field: a run takes one value; use estlab sweep for several"),
        (["run", "runs={}"], "runs must be an integer, got {}"),
        (["sweep", "seed=range(1,3,0)"], "seed=range(1,3,0): range() arg 3 must not be zero"),
        (["sweep", "--resume", "x", "--resume", "x"], "--resume takes the directory of a sweep, once"),
        (["sweep", "--resume", "--dry-run"], "--resume takes the directory of a sweep, once"),
        (["sweep", "--resume=x", "sweep.dir=y"], "sweep.dir=y: --resume already names the directory"),
        (["sweep", "sweep.dir=/proc/estlab"], "No such file or directory; give this sweep another sweep.dir"),
        *(
            (["sweep", f"hydra.sweep.subdir={name}"], "gives a job the folder ")
            for name in ("..", "", "plots", "attempts", "parts", "sweep.json", ".lock", "x" * 250)
        ),
        (["sweep", "sweep.timeout=1e30"], "sweep.timeout must be > 0 and at most 1e9, got 1e+30"),
        (["simulate", "data.path="], "data.path is required"),
        (["simulate", f"data.path={'x' * 300}"], "File name too long"),
        (["run", ""], "'': write key=value"),
        (["run", "--cfg=jobs"], "--cfg takes job, hydra, all; got jobs; did you mean job?"),
        (["run", "--info=plugin"], "got plugin; did you mean plugins?"),
        (["run", "--multirun=1"], "--multirun takes no value"),
        (["run", "--config-name=x"], "--config-name: there is no configuration x"),
        (["run", "+hydra.callbacks.x=1"], "hydra.callbacks.x names no class"),
        (["run", "+hydra.callbacks.x._target_=[]"], "hydra.callbacks.x names no class"),
    ],
)
def test_a_mistake_is_one_line_that_names_it_and_exit_code_2(arguments, message, capsys):
    assert main(arguments) == 2
    text = capsys.readouterr().err
    assert text.startswith("estlab: ")
    assert message in text
    assert text.count("\n") == 1


def test_a_file_named_latest_stays_where_runs_go():
    Path("latest").write_text("precious")
    assert main(["run", "scenario=landmark", "runs=2", "steps=2", "plots=false", "report=false", "output=."]) == 0
    assert Path("latest").read_text() == "precious"


def test_who_asks_for_hydras_traceback_gets_it(monkeypatch):
    from hydra.errors import HydraException

    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    for word in ("filter=ukff", "filter.alhpa=1", "seed=a b]"):
        with pytest.raises(HydraException):
            main(["run", word])


def test_a_typing_error_removes_nothing_that_was_there(tmp_path):
    (tmp_path / "kept").mkdir()
    os.utime(tmp_path / "kept", (0, 0))
    assert main(["run", "hydra.run.dir=.", "runs=0"]) == 2
    assert main(["run", "hydra.run.dir=new", "runs=0"]) == 2
    assert tmp_path.is_dir()
    assert (tmp_path / "kept").is_dir()
    assert not (tmp_path / "new").exists()


def test_a_reader_that_leaves_does_not_end_the_run():
    command = (
        f"{sys.executable} -m estlab run runs=2 steps=5 plots=false hydra.run.dir=piped | true; exit ${{PIPESTATUS[0]}}"
    )
    done = subprocess.run(
        ["bash", "-c", command], stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert status(Path("piped"))["status"] == "ok"


def test_several_filters_meet_the_same_truth_and_readings(capsys):
    assert main(["run", "scenario=landmark", "filter=[ekf,ukf]", "filters.ukf.alpha=0.5", *TINY, "plots=false"]) == 0
    assert latest().name.endswith("_landmark_ekf-ukf")
    assert "filters.ukf.alpha=0.5" in capsys.readouterr().out
    together = estlab.load("latest")
    assert list(dict.fromkeys(together.metrics["filter"])) == ["ekf", "ukf"]
    alone = estlab.run("scenario=landmark", "filter=ekf", *TINY, save=False)
    np.testing.assert_array_equal(together.estimates["ekf"].mean, alone.estimates["ekf"].mean)
    np.testing.assert_array_equal(together.runs["readings_mark"], [*alone.runs["readings_mark"]] * 2)
    assert main(["run", "filter=[ekf,ekf]"]) == 2
    assert main(["run", "filter=[ekf,nope]"]) == 2


def test_order_of_filters_changes_no_figure():
    found = []
    for names in (["pf", "ukf"], ["ukf", "pf"]):
        run = estlab.run("scenario=landmark", *TINY, filter=names, save=False)
        found.append(run.metrics.sort_values(["filter", "metric", "component"]))
    np.testing.assert_array_equal(found[0]["value"].to_numpy(), found[1]["value"].to_numpy())


def test_smoothing_is_a_second_set_of_tables():
    run = estlab.run("scenario=landmark", smooth=True, runs=6, steps=60, save=False)
    metrics = run.metrics.set_index(["filter", "metric", "component"])["value"]
    assert metrics["ukf_smoothed", "rmse", "position"] < metrics["ukf", "rmse", "position"]
    # The bound is of the readings so far, which a smoother is not bound by.
    assert metrics["ukf", "efficiency", "position"] < 1.5
    assert ("ukf_smoothed", "efficiency", "position") not in metrics
    with pytest.raises(
        estlab.UserError, match="smooth=true with pf: this filter has no smoother; use one of the Gaussian"
    ):
        estlab.run("scenario=landmark", "filter=pf", smooth=True, save=False)


def test_gated_readings_are_counted(capsys):
    arguments = ["scenario=landmark", "filter=ekf", "filter.gate=0.9", "runs=5", "steps=100", "plots=false"]
    assert main(["run", *arguments]) == 0
    count = int(re.search(r"(\d+) readings gated", capsys.readouterr().out)[1])
    assert count > 0


def test_repeats_of_one_recording_have_no_interval():
    run = estlab.run("scenario=landmark", "data=files", runs=3, save=False, **{"data.path": ROOT / "data/landmark"})
    assert run.metrics["ci_low"].isna().all()
    assert run.nees["upper"].min() > 3.0, "the band of a single run"


def test_a_directory_holds_one_run_only(capsys):
    assert main(["run", *TINY, "plots=false", "hydra.run.dir=mine"]) == 0
    before = {path.name: path.read_bytes() for path in Path("mine").iterdir() if path.is_file()}
    assert main(["run", *TINY, "plots=false", "hydra.run.dir=mine"]) == 2
    assert "mine: already holds a run" in capsys.readouterr().err
    assert before == {path.name: path.read_bytes() for path in Path("mine").iterdir() if path.is_file()}


def test_a_full_disk_is_said_and_the_status_is_failed(monkeypatch, capsys):
    real, calls = os.replace, []

    def full(*names, **folders):
        calls.append(names)
        if len(calls) > 5:
            raise OSError(28, "No space left on device")
        return real(*names, **folders)

    monkeypatch.setattr(os, "replace", full)
    assert main(["run", *TINY, "plots=false"]) == 1
    assert "No space left on device; the run is incomplete, free some space" in capsys.readouterr().err
    folder = next(Path("runs").glob("*/*_car_ukf"))
    assert status(folder)["status"] == "failed"
    assert "No space left" in status(folder)["error"]
    assert not list(folder.rglob("*.part")), "nothing half-written is left"
    assert not (folder / "metrics.csv").exists()


def test_an_interruption_leaves_the_status_interrupted(monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(CompiledLoop, "estimate", interrupted)
    assert main(["run", *TINY]) == 130
    assert status(latest())["status"] == "interrupted"
    assert capsys.readouterr().err == "estlab: interrupted\n"


def test_control_c_stops_a_real_process_in_order():
    import signal
    import time

    process = subprocess.Popen(
        [sys.executable, "-m", "estlab", "run", "runs=200000", "plots=false", "hydra.run.dir=long"],
        stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    for _ in range(600):
        if Path("long/log.txt").exists() and "car with ukf" in Path("long/log.txt").read_text():
            break
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err == "estlab: interrupted\n"
    assert status(Path("long"))["status"] == "interrupted"


def test_a_bug_is_said_with_where_the_traceback_is(monkeypatch, capsys):
    def broken(*_):
        raise ZeroDivisionError("one over nothing")

    monkeypatch.setattr(CompiledLoop, "estimate", broken)
    assert main(["run", *TINY]) == 1
    text = capsys.readouterr().err
    assert re.fullmatch(
        r"estlab: internal error, ZeroDivisionError: one over nothing; the traceback is in \S+log\.txt\n", text
    )
    assert status(latest())["status"] == "failed"
    assert "Traceback" in (latest() / "log.txt").read_text()


def test_a_statistic_that_breaks_is_a_remark_and_a_run_without_errors_has_failed(monkeypatch, capsys):
    def broken(*_):
        raise ZeroDivisionError("one over nothing")

    words = ["run", "scenario=field", *TINY, "plots=false", "expect.efficiency.x=[0,9]"]
    monkeypatch.setattr(statistics, "posterior_bound", broken)
    assert main([*words, "expect=null", "hydra.run.dir=remark"]) == 0
    said = "missing: Cramér-Rao bound (ZeroDivisionError: one over nothing); the traceback is in log.txt"
    assert said in capsys.readouterr().out
    assert status(Path("remark"))["status"] == "ok"
    missing = {"Cramér-Rao bound": "ZeroDivisionError: one over nothing"}
    assert json.loads(Path("remark/run.json").read_text())["missing"] == missing
    assert "one over nothing" in Path("remark/report.html").read_text()
    # What is expected of what is missing is not met.
    assert main([*words, "hydra.run.dir=expected"]) == 1
    monkeypatch.setattr(tabulated, "_errors", broken)
    capsys.readouterr()
    assert main([*words, "expect=null", "hydra.run.dir=failed"]) == 1
    assert capsys.readouterr().err.startswith("estlab: the run is incomplete, errors of ukf is missing (ZeroDivision")
    assert status(Path("failed"))["status"] == "failed"
    kept = {path.name for path in Path("failed").iterdir()}
    assert kept >= {"metrics.csv", "tests.csv", "verdicts.csv", "nees.csv", "estimates.npz", "report.html"}


def test_a_filter_that_diverges_is_counted_and_the_run_is_ok(capsys):
    # Weights that make covariances indefinite: a centre that counts -1 with the outer points drawn in.
    arguments = ["filter.beta=0", "filter.kappa=-3", "filter.noise=additive", "runs=40", "plots=false"]
    assert main(["run", "scenario=car", *arguments]) == 0
    count = int(re.search(r"(\d+) of 40 runs diverged", capsys.readouterr().out)[1])
    assert 0 < count < 40
    metrics = pd.read_csv(latest() / "metrics.csv").set_index(["metric", "component"])
    assert metrics.loc[("diverged", "all"), "value"] == count
    assert metrics.loc[("diverged", "all"), "n"] == 40
    assert metrics.loc[("not_definite", "all"), "value"] == count
    assert re.search(r"ukf not definite in runs: \d+ ", (latest() / "log.txt").read_text())
    assert metrics.loc["verdict"].index.tolist() == ["lost"]


@pytest.mark.slow
def test_figures_are_the_same_for_one_and_two_threads():
    texts = []
    for threads in ("1", "2"):
        environment = os.environ | dict.fromkeys(
            ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), threads
        )
        folder = f"out{threads}"
        command = ["run", "scenario=landmark", "runs=30", "steps=40", "plots=false", f"hydra.run.dir={folder}"]
        subprocess.run([sys.executable, "-m", "estlab", *command], env=environment, check=True, capture_output=True)
        texts.append([(Path(folder) / name).read_bytes() for name in ("metrics.csv", "tests.csv", "errors.csv")])
    assert texts[0] == texts[1]


def test_several_filters_are_compared_and_each_gets_a_verdict(capsys):
    assert main(["run", "scenario=field", "filter=[ekf,ukf,dead_reckoning]", "runs=30", "plots=false"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"^ekf is consistent: NEES / n = \S+ \[\S+, \S+\], NIS / m", out, re.MULTILINE)
    assert re.search(r"dead_reckoning .* yes ", out)
    compared = pd.read_csv(latest() / "comparison.csv")
    assert len(compared) == 3 * 4
    row = compared[(compared["component"] == "position") & (compared["filter"] == "dead_reckoning")].iloc[0]
    assert row["against"] == "ekf"
    assert row["real"]
    assert row["difference"] == pytest.approx(row["rmse"] - row["rmse_against"])
    verdicts = pd.read_csv(latest() / "verdicts.csv")
    assert list(verdicts.columns) == ["filter", "word", "sentence", "key", "p", "seed"]
    assert set(verdicts["filter"]) == {"ekf", "ukf", "dead_reckoning"}


@pytest.mark.slow
def test_parts_of_an_ensemble_put_together_are_what_one_process_finds():
    common = ["run", "scenario=field", "filter=[ekf,pf]", "filters.pf.particles=40", "runs=23", "steps=30"]
    common += ["plots=false", "block_runs=3", "keep_runs=4"]
    assert main([*common, "hydra.run.dir=one"]) == 0
    for i in (2, 0, 1):
        assert main([*common, f"part=[{i},3]", f"hydra.run.dir=part{i}"]) == 0
    assert main([*common, "parts=[part1,part0,part2]", "hydra.run.dir=merged"]) == 0
    tables = ("metrics", "tests", "errors", "nees", "nis", "coverage", "histograms", "verdicts", "runs")
    for name in tables:
        assert (Path("one") / f"{name}.csv").read_bytes() == (Path("merged") / f"{name}.csv").read_bytes(), name
    with np.load("one/estimates.npz") as one, np.load("merged/estimates.npz") as merged:
        for name in one:
            np.testing.assert_array_equal(one[name], merged[name])


def test_parts_that_are_missing_or_of_another_ensemble_are_named(capsys):
    common = ["run", "scenario=field", "filter=ekf", "runs=8", "steps=10", "plots=false", "block_runs=2", "keep_runs=2"]
    assert main([*common, "part=[0,2]", "hydra.run.dir=part0"]) == 0
    assert main([*common, "parts=[part0]", "hydra.run.dir=a"]) == 2
    assert "its parts contain 2 of 4 blocks" in capsys.readouterr().err
    assert main([*common, "parts=[part0,part1]", "hydra.run.dir=b"]) == 2
    assert "part1/part.npz: not a part of this ensemble" in capsys.readouterr().err
    assert main([*common, "part=[2,2]"]) == 2
    assert "part must be [which, of how many]" in capsys.readouterr().err


def test_one_run_of_an_ensemble_can_be_made_again_alone(capsys):
    common = ["run", "scenario=field", "filter=pf", "filter.particles=50", "steps=20", "plots=false"]
    assert main([*common, "runs=6", "hydra.run.dir=all"]) == 0
    assert main([*common, "run_index=4", "hydra.run.dir=one"]) == 0
    assert "run 4 alone" in capsys.readouterr().out
    with np.load("all/estimates.npz") as among, np.load("one/estimates.npz") as alone:
        assert alone["run"].tolist() == [4]
        np.testing.assert_allclose(alone["mean"][..., 0], among["mean"][..., 4], rtol=1e-10)


def test_hydras_own_flags_work(capsys):
    assert main(["run", "--cfg", "job", "-p", "filter"]) == 0
    assert yaml.safe_load(capsys.readouterr().out)["kappa"] == 0.0
    assert main(["run", "--help"]) == 0
    assert "ckf, dead_reckoning, ekf, enkf" in capsys.readouterr().out


def test_a_users_own_folder_of_configuration_is_found(capsys):
    Path("mine/scenario").mkdir(parents=True)
    text = (ROOT / "conf/scenario/car.yaml").read_text().replace("duration: 20.0", "duration: 0.5")
    Path("mine/scenario/short_car.yaml").write_text(text)
    assert main(["run", "--config-dir", "mine", "scenario=short_car", "runs=2", "plots=false"]) == 0
    assert "short_car · ukf · 2 runs × 5 steps" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("estlab ru", {"run"}),
        ("estlab sweep filter=ek", {"filter=ekf"}),
        ("estlab run scenario=car filter.al", {"filter.alpha="}),
        ("estlab c", {"compare", "clean"}),
        ("estlab compare ru", set()),
        ("estlab compare runs --m", {"--metric", "--md"}),
        ("estlab clean --", {"--failed", "--older-than", "--keep-last", "--yes", "--help"}),
        ("estlab list --c", {"--config-dir"}),
        ("estlab list ", {"scenarios", "filters", "experiments"}),
    ],
)
def test_the_shell_completes_through_the_subcommand(line, expected, monkeypatch, capsys):
    monkeypatch.setenv("COMP_LINE", line)
    assert main(["-sc", "query=bash"]) == 0
    assert set(capsys.readouterr().out.split()) == expected


def test_completion_installs_for_estlab(capsys):
    assert main(["run", "-sc", "install=bash"]) == 0
    assert capsys.readouterr().out.rstrip().endswith("estlab")


def test_an_interruption_while_python_executes_a_text_has_the_exit_code_too():
    """As when a dataclass is being defined; Python itself would end by the signal."""
    program = (
        "import sys, estlab.cli.main as cli\n"
        "def interrupted(arguments):\n    exec('raise KeyboardInterrupt')\n"
        "cli._dispatch = interrupted\nsys.exit(cli.main(['list']))\n"
    )
    Path("interrupted_in_a_text.py").write_text(program)
    command = [sys.executable, "-m", "interrupted_in_a_text"]
    found = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": f".:{ROOT}"})
    assert (found.returncode, found.stderr) == (130, "estlab: interrupted\n")
