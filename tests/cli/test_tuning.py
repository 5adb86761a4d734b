"""Tuning by Optuna: what it finds, and that it may be stopped at any time."""

import json
import math
import shlex
import shutil
from pathlib import Path

import pandas as pd
import pytest

from estlab.cli.main import main
from estlab.experiment import experiment
from tests.cli.sweeping import count, rows, status, table, wait_for
from tests.cli.test_engines import needs
from tests.cli.test_sweep_faults import started
from tests.html import Page

pytestmark = pytest.mark.slow

optuna = needs("optuna", "optuna")
Q, R = "noise.filter.process_scale", "noise.filter.measurement_scale"
SMALL = ["hydra/sweeper=optuna", "scenario=landmark", "filter=ekf", "runs=4", "scenario.duration=1"]
WORDS = [*SMALL, f"{Q}=tag(log,interval(0.2,5))", f"{R}=interval(0.2,5)", "sweep.trials=6"]


def tune(*words: str, place: str = "tuned") -> int:
    return main(["sweep", *WORDS, "plots=false", f"sweep.dir={place}", *words])


def tuning(place: str = "tuned") -> list[dict[str, str]]:
    return rows(f"{place}/tuning.csv")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """A tuning that nothing happened to."""
    folder = tmp_path_factory.mktemp("undisturbed") / "tuned"
    assert tune(place=str(folder)) == 0
    return folder


@optuna
def test_the_likelihood_finds_the_noises_of_the_truth():
    words = [
        *SMALL[:3],
        "runs=10",
        "scenario.duration=6",
        f"{Q}=tag(log,interval(0.2,5))",
        f"{R}=tag(log,interval(0.2,5))",
    ]
    assert main(["sweep", *words, "plots=false", "sweep.trials=30", "sweep.dir=tuned"]) == 0
    best = min(tuning(), key=lambda row: float(row["objective"]))
    for key in (Q, R):
        # Of 25 times the scale that may be chosen from; ten runs of sixty steps tell it no better.
        assert 1 / 1.3 < float(best[key]) < 1.3


@optuna
def test_each_trial_is_a_job_and_the_best_is_told_as_a_command(capsys):
    assert tune("plots=true", "sweep.trials=3") == 0
    found = tuning()
    assert [row["trial"] for row in found] == [str(i) for i in range(3)]
    values = [float(row["objective"]) for row in found]
    for row, value in zip(found, values, strict=True):
        own = pd.read_csv(f"tuned/{row['job']}/metrics.csv").set_index(["metric", "component"])
        assert value == -own.loc[("loglik", "all"), "value"]
        assert 0.2 <= float(row[Q]) <= 5.0
        assert 0.2 <= float(row[R]) <= 5.0
    assert [float(row["best"]) for row in found] == [min(values[: i + 1]) for i in range(3)]
    assert [(row["job"], row[Q]) for row in table("tuned")] == [(row["job"], row[Q]) for row in found]
    assert Path("tuned/plots/tuning.png").stat().st_size > 0
    captured = capsys.readouterr()
    # On a machine that is busy it may last long enough for its progress to be told.
    assert not [line for line in captured.err.splitlines() if not line.startswith("estlab: sweep, ")]
    lines = captured.out.splitlines()
    best = found[values.index(min(values))]["job"]
    assert lines[-2:] == [str(Path("tuned", best).resolve()), str(Path("tuned").resolve())]
    shown = Page(Path("tuned/report.html").read_text()).tables["Trials in order; a smaller objective is better"]
    assert [line[0][0] for line in shown[1:]] == [row["job"] for row in found]
    assert [line[-2][1] for line in shown[1:]] == [row["best"] for row in found]
    command = shlex.split(lines[-3].removeprefix("best: estlab "))
    assert command[1:] == [*WORDS[1:5], *(f"{key}={next(r[key] for r in found if r['job'] == best)}" for key in (Q, R))]
    assert main([*command, "hydra.run.dir=alone"]) == 0
    assert Path("alone/metrics.csv").read_text() == Path("tuned", best, "metrics.csv").read_text()


@optuna
@pytest.mark.parametrize("done", [0, 3])
def test_a_tuning_that_is_killed_and_resumed_is_one_that_was_not(done, undisturbed):
    process = started(*WORDS, "sweep.dir=tuned")
    wait_for(lambda: Path("tuned/sweep.json").exists() and count("tuned", "ok") >= done)
    process.kill()
    process.communicate()
    kept = {
        path: path.read_bytes() for path in Path("tuned").glob("*/status.json") if status(path.parent)["status"] == "ok"
    }
    assert main(["sweep", "--resume", "tuned"]) == 0
    assert tuning() == tuning(str(undisturbed))
    assert table("tuned") == table(str(undisturbed))
    assert all(path.read_bytes() == was for path, was in kept.items()), "what was ok did not run again"


@optuna
def test_a_tuning_goes_on_with_more_trials_and_not_with_another_space(undisturbed, capsys):
    shutil.copytree(undisturbed, "tuned")
    assert tune("sweep.trials=8") == 0
    assert tuning()[:6] == tuning(str(undisturbed))
    assert len(tuning()) == 8
    assert len(json.loads(Path("tuned/sweep.json").read_text())["jobs"]) == 8
    capsys.readouterr()
    for other in (f"{R}=interval(0.2,4)", "objective=nis", "seed=2", "sweep.batch=2", "runs=5"):
        assert tune(other) == 2
        assert "tuned: holds another sweep (there: Optuna " in capsys.readouterr().err
    assert main(["sweep", *SMALL[1:], "seed=1,2", "sweep.dir=tuned"]) == 2


@optuna
def test_a_damaged_trial_is_told_and_runs_again(undisturbed, capsys):
    shutil.copytree(undisturbed, "tuned")
    Path("tuned/2_landmark_ekf/metrics.csv").unlink()
    assert tune() == 0
    assert "2_landmark_ekf: metrics.csv cannot be read; it runs again" in capsys.readouterr().err
    assert tuning() == tuning(str(undisturbed))


@pytest.fixture
def failing(monkeypatch):
    """Make trials of small process noise fail; what it returns mends them."""
    real = experiment.run

    def run(settings, *others):
        if settings.noise.filter.process_scale < 0.6:
            raise ZeroDivisionError("one over nothing")
        return real(settings, *others)

    monkeypatch.setattr(experiment, "run", run)
    return lambda: monkeypatch.setattr(experiment, "run", real)


@optuna
def test_a_failed_trial_stops_no_other_and_stays_failed(failing, capsys):
    assert tune() == 3
    found = tuning()
    failed = [row for row in found if float(row[Q]) < 0.6]
    assert 0 < len(failed) < 6
    assert all((row["state"] == "failed") == (row in failed) for row in found)
    assert all("one over nothing" in row["error"] and row["objective"] == "" for row in failed)
    assert f"{6 - len(failed)} ok, {len(failed)} failed" in capsys.readouterr().out
    failing()
    assert tune() == 3
    assert tuning() == found


@optuna
def test_fail_fast_begins_no_trial_after_a_failed_one(failing):
    assert tune("sweep.fail_fast=true") == 3
    assert [row["state"] for row in tuning()].index("failed") == len(tuning()) - 1 < 5


@optuna
def test_trials_without_the_objective_are_said(capsys):
    assert tune("filter=dead_reckoning", "objective=nis", "sweep.trials=2") == 1
    assert [row["state"] for row in tuning()] == ["no objective", "no objective"]
    out = capsys.readouterr().out
    assert "no objective: 0_landmark_dead_reckoning: there is no anis all of dead_reckoning" in out
    assert "2 no objective" in out


@optuna
def test_choices_and_ranges_are_chosen_from():
    swept = ["filter=ekf,ukf", "keep_runs=range(1,8,3)", f"{Q}=range(0.5,1.1,0.25)", f"{R}=int(interval(1,3))"]
    assert main(["sweep", *SMALL, *swept, "plots=false", "sweep.trials=6", "sweep.dir=tuned", "objective=rmse:x"]) == 0
    found = tuning()
    for key, words in (("filter", {"ekf", "ukf"}), ("keep_runs", {"1", "4", "7"}), (R, {"1", "2", "3"})):
        assert len({row[key] for row in found} & words) > 1
        assert {row[key] for row in found} <= words
    assert {float(row[Q]) for row in found} <= {0.5, 0.75, 1.0}
    assert all(row["filter"] in row["job"] for row in found)


@optuna
@needs("hydra_plugins.hydra_joblib_launcher", "joblib")
def test_a_round_by_another_engine_is_the_same():
    from joblib.externals.loky import get_reusable_executor

    words = ["sweep.trials=4", "sweep.batch=2"]
    assert tune(*words, place="basic") == 0
    try:
        assert tune(*words, "hydra/launcher=joblib", "hydra.launcher.n_jobs=2", place="joblib") == 0
    finally:
        get_reusable_executor().shutdown(wait=True)
    assert tuning("joblib") == tuning("basic")


@optuna
def test_trials_in_parts_are_the_same(undisturbed):
    assert tune("runs=6", "block_runs=2", "keep_runs=2", "sweep.trials=2", place="whole") == 0
    assert tune("runs=6", "block_runs=2", "keep_runs=2", "sweep.trials=2", "sweep.split_runs=3") == 0
    assert tuning() == tuning("whole")
    assert len(list(Path("tuned").glob("parts/*/*/part.npz"))) == 6


@optuna
def test_a_best_value_at_the_end_of_its_interval_is_noted(capsys):
    words = [*SMALL, "plots=false", f"{R}=interval(10,11)", "sweep.dir=tuned", "sweep.trials=14"]
    assert main(["sweep", *words]) == 0
    assert f"note: {R}=10" in capsys.readouterr().out


@optuna
def test_a_dry_run_shows_the_first_trial_and_leaves_nothing(capsys):
    assert tune("--dry-run") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("0_landmark_ekf  ")
    assert lines[-1] == "the first of 6 trials; the others depend on its result"
    assert not list(Path().iterdir())


@optuna
@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "nothing to tune: give a key an interval"),
        ([f"{Q}=interval(5,0.2)"], "write an interval from low to high"),
        ([f"{Q}=tag(log,interval(0,2))"], "both above zero, for log"),
        (["filter=tag(log,choice(ekf,ukf))"], "log is for intervals and ranges of numbers"),
        (["runs=tag(log,range(1,9,2))"], "log takes steps of one above zero"),
        ([f"{Q}=interval(1,2)", "sweep.repeats=2"], "tuning does not support sweep.zip and sweep.repeats"),
        ([f"{Q}=interval(1,2)", "sweep.trials=0"], "sweep.trials must be from 1 to 1e5, got 0"),
        ([f"{Q}=interval(1,2)", "objective=niss"], "objective must be nis, nees, loglik or rmse:<component>"),
        ([f"{Q}=interval(1,2)", "objective=nis,nees"], "give one value"),
        ([f"{Q}=interval(1,2)", "objective=rmse:positon"], "no component positon; did you mean position?"),
        ([f"{Q}=interval(1,2)", "objective=nis:ukf"], "there is no filter ukf here (one of ekf)"),
        ([f"{Q}=interval(-2,-1)"], "noise.filter.process_scale must be > 0"),
    ],
)
def test_a_tuning_that_cannot_start_says_why_and_leaves_nothing(words, message, capsys):
    assert main(["sweep", *SMALL, *words]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
    assert not Path("runs").exists()


def test_a_tuning_without_optuna_names_what_installs_it(monkeypatch, capsys):
    import estlab.launch.arguments

    monkeypatch.setattr(estlab.launch.arguments.importlib.util, "find_spec", lambda name: None)
    assert main(["sweep", *WORDS]) == 2
    assert "hydra/sweeper=optuna needs more: pip install 'estlab[optuna]'" in capsys.readouterr().err


def test_a_picture_is_drawn_of_trials_that_failed_or_were_infinitely_bad():
    from estlab.report import tuning_plots as picture

    text = "trial,job,a,filter,objective,best,state,error\n0,j,0.1,ekf,2.0,2.0,ok,\n1,j,0.4,ukf,inf,2.0,ok,\n"
    Path("tuning.csv").write_text(text + "2,j,3.0,ekf,,2.0,failed,no\n3,j,1.0,ukf,0.5,0.5,ok,\n")
    history, over_number, over_word = picture.draw(Path("tuning.csv"), ["a", "filter"], "RMSE x").axes
    assert [tuple(point) for point in history.lines[0].get_xydata() if math.isfinite(point[1])] == [(0, 2.0), (3, 0.5)]
    assert history.lines[2].get_xdata().tolist() == [1, 2], "a cross for each trial without an objective"
    assert over_number.get_xscale() == "log"
    assert over_number.lines[0].get_xydata().tolist() == [[1.0, 0.5]], "the best is ringed"
    assert [label.get_text() for label in over_word.get_xticklabels()] == ["ekf", "ukf"]
