"""Sweeps as a user types them: the jobs, the tables, the exit codes."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from estlab.cli.main import main
from estlab.experiment import experiment
from tests.cli.sweeping import TINY, job_folders, rows, sweep, table

pytestmark = pytest.mark.slow


@pytest.fixture
def failing(monkeypatch):
    """Make the jobs of some seeds do something else."""

    def install(**by_seed):
        real = experiment.run

        def run(settings, *others):
            if act := by_seed.get(f"seed{settings.seed}"):
                act()
            return real(settings, *others)

        monkeypatch.setattr(experiment, "run", run)
        return lambda: monkeypatch.setattr(experiment, "run", real)

    return install


def broken():
    raise ZeroDivisionError("one over nothing")


def test_a_sweep_leaves_a_directory_a_job_and_one_table_of_them_all(capsys):
    words = ["filter=ekf,ukf", "noise.filter.measurement_scale=0.5,1,2"]
    assert main(["sweep", *TINY, *words]) == 0
    place = Path("runs/latest").resolve()
    assert place.parent.parent == Path("runs").resolve()
    assert len(job_folders(str(place))) == 6
    found = rows(str(place / "sweep.csv"))
    assert [(row["noise.filter.measurement_scale"], row["filter"]) for row in found] == [
        (scale, filter) for filter in ("ekf", "ukf") for scale in ("0.5", "1", "2")
    ]
    assert {row["status"] for row in found} == {"ok"}
    for row in found:
        own = pd.read_csv(place / row["job"] / "metrics.csv").set_index(["metric", "component"])
        for column, name in (("value", "rmse.y"), ("ci_low", "rmse.y.low"), ("ci_high", "rmse.y.high")):
            assert float(row[name]) == own.loc[("rmse", "y"), column]
    assert len(rows(str(place / "failures.csv"))) == 0
    assert {"rmse.png", "anees.png", "anis.png"} <= {path.name for path in (place / "plots").iterdir()}
    assert not list(place.glob("*/plots")), "a job draws nothing of its own"
    captured = capsys.readouterr()
    assert captured.out.endswith(f"6 ok\n{place}\n")
    assert captured.err == ""
    assert "RMSE" in (place / "0_landmark_ekf/output.txt").read_text()


def test_a_job_alone_is_a_run_that_can_be_typed():
    assert sweep("filter=ekf,ukf", "plots=true") == 0
    command = json.loads(Path("swept/1_landmark_ukf/run.json").read_text())["command"]
    assert (Path("swept/1_landmark_ukf/plots/errors.png")).exists()
    assert main([*command[1:], "plots=false", "hydra.run.dir=alone"]) == 0
    alone, swept = (Path(folder, "metrics.csv").read_text() for folder in ("alone", "swept/1_landmark_ukf"))
    assert alone == swept


def test_run_dash_m_is_a_sweep():
    assert main(["run", "-m", *TINY, "plots=false", "filter=ekf,ukf", "sweep.dir=one"]) == 0
    assert sweep("filter=ekf,ukf", place="other") == 0
    assert table("one") == table("other")


def test_several_filters_on_one_record_are_a_row_each():
    assert sweep("filter=[ekf,ukf]", "noise.filter.measurement_scale=1,2") == 0
    found = table()
    assert [(row["job"], row["filter"]) for row in found] == [
        (f"{i}_landmark_ekf-ukf", filter) for i in (0, 1) for filter in ("ekf", "ukf")
    ]


def test_an_experiment_names_what_it_sweeps():
    words = ["+experiment=field_few_particles", "runs=2", "steps=5", "plots=false", "sweep.dir=swept"]
    assert main(["sweep", *words, "--dry-run"]) == 0
    assert main(["sweep", *words, "filters.pf.particles=10,20"]) == 0
    assert [row["filters.pf.particles"] for row in table()] == ["10", "10", "20", "20"]


def test_a_dry_run_lists_the_jobs_and_leaves_nothing(capsys):
    assert sweep("filter=ekf,ukf", "seed=1,2", "--dry-run") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split() == ["1_landmark_ekf", *TINY, "plots=false", "filter=ekf", "seed=2"]
    assert lines[-1] == "4 jobs, 4 to run"
    assert not list(Path().iterdir())


def test_zipped_keys_go_in_pairs(capsys):
    zipped = "sweep.zip=[filter,noise.filter.measurement_scale]"
    assert sweep("filter=ekf,ukf", "noise.filter.measurement_scale=1,2", "seed=1,2", zipped) == 0
    keys = ("filter", "noise.filter.measurement_scale", "seed")
    pairs = [tuple(row[key] for key in keys) for row in table()]
    assert pairs == [("ekf", "1", "1"), ("ekf", "1", "2"), ("ukf", "2", "1"), ("ukf", "2", "2")]


def test_repeats_are_seeds_and_their_groups_have_means_over_them(capsys):
    assert sweep("filter=ekf,ukf", "seed=7", "sweep.repeats=3") == 0
    found = table()
    assert [(row["filter"], row["seed"]) for row in found] == [(f, s) for f in ("ekf", "ukf") for s in "789"]
    groups = rows("swept/groups.csv")
    assert [(row["filter"], row["repeats"]) for row in groups] == [("ekf", "3"), ("ukf", "3")]
    for group in groups:
        values = np.array([float(row["rmse.x"]) for row in found if row["filter"] == group["filter"]])
        assert len(set(values)) == 3
        # Student's quantile with two degrees of freedom has a closed form.
        p = 0.975
        quantile = (2 * p - 1) / np.sqrt(2 * p * (1 - p))
        half = quantile * np.sqrt(((values - values.mean()) ** 2).sum() / 2) / np.sqrt(3)
        expected = [values.mean(), values.mean() - half, values.mean() + half]
        np.testing.assert_allclose([float(group[f"rmse.x{end}"]) for end in ("", ".low", ".high")], expected)
    assert "repeats" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["filter=ekf,ukf", "seed=1,2,3", "sweep.zip=[filter,seed]"], "filter has 2, seed has 3"),
        (["filter=ekf,ukf", "sweep.zip=[filter,sed]"], "sweep.zip: sed has no list of values in this sweep"),
        (["filter=ekf,ukf", "sweep.zip=[filter]"], "sweep.zip must name two keys or more"),
        (["seed=1,2", "sweep.repeats=2"], "leave seed=... with several values out"),
        (["sweep.repeats=1,2"], "keys under sweep apply to the whole sweep"),
        (["sweep.repeats=0", "seed=1,2"], "sweep.repeats must be from 1 to 1e6, got 0"),
        (["sweep.timeout=0"], "sweep.timeout must be > 0"),
        (["sweep.retires=1"], "unknown key sweep.retires; did you mean sweep.retries?"),
        (["seed=interval(0,1)"], "an interval is not a list of values"),
        (["seed=shuffle(1,2)"], "leave shuffle out"),
        (["filter=ekf,ukff"], "there is no filter ukff; did you mean ukf?"),
        (["hydra.sweep.subdir=one", "seed=1,2"], "gives several jobs one directory"),
        (["hydra/launcher=dusk"], "there is no hydra/launcher dusk"),
        (["--resume"], "--resume takes the directory of a sweep"),
        (["--resume", "nowhere"], "nowhere: no readable sweep.json"),
        (["+experiment=field_errors", "filter=ekf,ukf"], "the experiment has its own filters, ekf,pf; leave it out"),
    ],
)
def test_a_sweep_that_cannot_start_says_why_and_leaves_nothing(words, message, capsys):
    assert main(["sweep", "runs=2", "steps=5", *words]) == 2
    text = capsys.readouterr().err
    assert message in text
    assert text.count("\n") == 1
    assert not Path("runs").exists()


@pytest.mark.parametrize(
    "act",
    [
        broken,
        lambda: exit(5),
        lambda: (_ for _ in ()).throw(OSError(28, "No space left on device")),
        lambda: (_ for _ in ()).throw(MemoryError()),
    ],
    ids=["raises", "exits", "fills the disk", "needs too much memory"],
)
def test_a_failed_job_stops_no_other_and_is_told(act, failing, capsys):
    failing(seed2=act)
    assert sweep("filter=ekf", "seed=1,2,3") == 3
    assert [row["status"] for row in table()] == ["ok", "failed", "ok"]
    (failure,) = rows("swept/failures.csv")
    assert (failure["job"], failure["directory"]) == ("1_landmark_ekf", "1_landmark_ekf")
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    for text in (captured.out, captured.err):
        assert failure["error"] in text
        assert str(Path("swept/1_landmark_ekf").resolve()) in text
    assert "2 ok, 1 failed" in captured.out


def test_no_job_ok_is_1_and_no_job_that_could_start_is_2(failing):
    failing(seed1=broken, seed2=broken)
    assert sweep("filter=ekf", "seed=1,2") == 1
    assert sweep("filter.noise=one,other", place="wrong") == 2
    assert "filter.noise must be one of" in rows("wrong/failures.csv")[0]["error"]


def test_a_job_that_does_not_find_what_is_expected_is_unmet_and_whole(capsys):
    words = ["filter=ekf", "sweep.repeats=2", "sweep.retries=2", "expect.rmse.x.max=1e-9"]
    assert sweep(*words) == 1
    out, err = capsys.readouterr()
    assert "2 unmet" in out and "failed" not in out + err
    assert out.count("unmet: ") == err.count("expected at most 1e-09") == 2
    found = table()
    assert [row["status"] for row in found] == ["unmet", "unmet"]
    assert all(float(row["rmse.x"]) > 1e-9 for row in found)
    assert rows("swept/failures.csv") == []
    (group,) = rows("swept/groups.csv")
    assert group["repeats"] == "2"
    # It would find the same again, whatever its status was called when it was made.
    for job in Path("swept").glob("*_ekf"):
        stamp = (job / "status.json").read_text()
        (job / "status.json").write_text(stamp.replace('"unmet"', '"failed"'))
    assert sweep(*words) == 1
    assert "2 of 2 jobs are done, nothing is left to run" in capsys.readouterr().err
    assert table() == found


def test_a_verdict_is_a_word_in_a_column_of_its_own():
    assert sweep("filter=ekf", "seed=1,2", "runs=20", "steps=40", "noise.filter.process_scale=1,0.1") == 0
    words = [row["verdict"] for row in table()]
    assert words[1] == words[3] == "overconfident"
    assert "overconfident" not in (words[0], words[2])
    assert not any(column.startswith("verdict.") for column in table()[0])


def test_metrics_that_are_not_numbers_are_empty_cells_of_a_job_that_is_ok():
    # No truth in the files: nothing is scored.
    assert main(["simulate", "scenario=epuck", "data.path=made"]) == 0
    words = ["scenario=epuck", "data=files", "data.path=made", "runs=1", "steps=60", "sweep.dir=swept"]
    assert main(["sweep", *words, "filter=ekf,ukf"]) == 0
    found = table()
    assert {row["status"] for row in found} == {"ok"}
    assert all(value != "nan" for row in found for value in row.values())
    assert not Path("swept/plots/rmse.png").exists()
    assert main(["sweep", *words, "filter=ekf,ukf", "sweep.dir=twice", "sweep.repeats=2", "plots=false"]) == 0


def test_fail_fast_begins_no_job_after_the_first_failure(failing, capsys):
    mend = failing(seed2=broken)
    words = ["filter=ekf", "seed=1,2,3,4"]
    assert sweep(*words, "sweep.fail_fast=true") == 3
    assert [row["status"] for row in table()] == ["ok", "failed", "left", "left"]
    assert "1 ok, 1 failed, 2 left" in capsys.readouterr().out
    assert job_folders() == ["0_landmark_ekf", "1_landmark_ekf"]
    mend()
    assert sweep(*words) == 0
    assert sweep(*words, place="undisturbed") == 0
    assert table() == table("undisturbed")


def test_a_job_is_retried_as_often_as_asked_and_each_failure_is_kept(failing, capsys):
    tries = []

    def twice():
        tries.append(1)
        if len(tries) < 3:
            broken()

    failing(seed2=twice)
    assert sweep("filter=ekf", "seed=1,2", "sweep.retries=2") == 0
    assert [row["status"] for row in table()] == ["ok", "ok"]
    failures = rows("swept/failures.csv")
    assert [(row["attempt"], row["directory"]) for row in failures] == [
        (str(k), f"attempts/1_landmark_ekf.{k}") for k in (1, 2)
    ]
    assert all("one over nothing" in row["error"] for row in failures)
    assert "Traceback" in Path("swept/attempts/1_landmark_ekf.1/log.txt").read_text()


def test_a_table_that_does_not_fit_on_the_disk_is_told_and_comes_with_the_next_try(monkeypatch, capsys):
    from estlab.sweeps import table as tables

    def full(*_):
        raise OSError(28, "No space left on device", "swept/sweep.csv")

    with monkeypatch.context() as patch:
        patch.setattr(tables, "_write", full)
        assert sweep("filter=ekf", "seed=1,2") == 1
    assert "swept/sweep.csv: No space left on device; free some space and resume" in capsys.readouterr().out
    assert main(["sweep", "--resume", "swept"]) == 0
    assert len(table()) == 2


def test_one_number_swept_is_a_curve_two_are_a_map_and_a_choice_is_points():
    from matplotlib.colors import Normalize

    from estlab.report import sweep_plots

    assert sweep("filter=ekf,ukf", "noise.filter.measurement_scale=1,2", "noise.filter.process_scale=1,2,4") == 0
    frame = pd.read_csv("swept/sweep.csv").copy().assign(_series=lambda found: found["filter"])
    keys, columns, units = ["noise.filter.measurement_scale", "noise.filter.process_scale"], ["rmse.x"], {"rmse.x": "m"}
    figure = sweep_plots.draw_maps(frame, columns, keys, ["ekf", "ukf"], units)
    maps = [axes for axes in figure.axes if axes.collections and axes.get_title()]
    assert [axes.get_title() for axes in maps] == ["ekf", "ukf"]
    for axes in maps:
        own = frame[frame["filter"] == axes.get_title()].set_index(keys)["rmse.x"]
        shown = np.asarray(axes.collections[0].get_array()).reshape(2, 3)
        np.testing.assert_array_equal(shown, [[own[y, x] for x in (1, 2, 4)] for y in (1, 2)])
        assert isinstance(axes.collections[0].norm, Normalize)
    assert maps[0].collections[0].norm is maps[1].collections[0].norm, "one scale for both filters"
    some = frame[frame[keys[0]] == 1]
    (axes,) = sweep_plots.draw_curves(some, columns, keys[1], ["ekf", "ukf"], units).axes
    np.testing.assert_array_equal(axes.lines[0].get_xydata()[:, 1], some[some["filter"] == "ekf"]["rmse.x"])
    assert len(axes.collections) == 2, "a band for each"
    (axes,) = sweep_plots.draw_points(some[some[keys[1]] == 1], columns, ["ekf", "ukf"], units).axes
    assert [label.get_text() for label in axes.get_xticklabels()] == ["ekf", "ukf"]
