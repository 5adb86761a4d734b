"""What a key changes is said beside it, and fingerprint, title, labels and the command of a tuning follow."""

from dataclasses import fields, replace
from pathlib import Path

import pytest

from estlab.comparison import rows
from estlab.comparison.rows import ComparisonRow, labelled
from estlab.config.build import build
from estlab.config.settings import NEITHER, RECORD, Configuration, Names, changes, words_without
from estlab.errors import UserError
from estlab.experiment.compatibility import check
from estlab.rundir.finished import Finished
from estlab.sweeps import trials
from estlab.sweeps.state import Planned, fingerprint
from tests.conftest import composed, settings

# Every key, as a sweep of an earlier version has it, and the hash that it wrote.
EVERY = {
    "scenario": {"_target_": "a.B", "dt": 0.1}, "filter": {"alpha": 1.0}, "filters": {}, "noise": {"filter": 1.0},
    "data": {"source": "simulated"}, "runs": 3, "run_index": None, "part": None, "parts": [], "steps": None,
    "dropped": 0.0, "seed": 1, "keep_runs": 20, "block_runs": None, "cores": None, "engine": "auto", "smooth": False,
    "verdict": {"lost": 0.01}, "plots": False, "report": False, "output": "runs", "plugins": [], "expect": None,
    "expect_files": None, "objective": "loglik", "sweep": {"dir": "x"},
}  # fmt: skip
HASH = "65cd0ea935fbf71441702c8c1896a65ac27f115ed752cb35be5f5ece189f5c3f"

MADE_OTHERWISE = {"output", "plots", "report", "sweep", "part", "parts", "objective", "cores"}


def of(metadata) -> set[str]:
    return {one.name for one in fields(Configuration) if one.metadata == metadata}


def test_sweeps_of_earlier_versions_resume():
    assert set(EVERY) == {one.name for one in fields(Configuration)}
    assert fingerprint(EVERY, "car", "ukf") == HASH
    assert of(NEITHER) == MADE_OTHERWISE


@pytest.mark.parametrize("key", EVERY)
def test_the_fingerprint_changes_with_every_key_but_those_that_change_nothing_of_a_run(key):
    # A part has the fingerprint of its whole with its number.
    other = fingerprint(EVERY | {key: [0, 2] if key == "part" else "other"}, "car", "ukf")
    assert (other == HASH) == (key in MADE_OTHERWISE - {"part"})
    assert other.startswith(HASH) == (key in MADE_OTHERWISE)


def row(**config) -> ComparisonRow:
    run = Finished(Path("runs/a"), {}, {}, EVERY | config, "car", "ukf", ("ukf",), ())
    return ComparisonRow(run, "ukf", {}, "", rows._settings(run, "ukf"))


@pytest.mark.parametrize("key", sorted(of(NEITHER) | of(RECORD)))
def test_rows_whose_figures_are_the_same_have_the_same_label(key):
    first, second = labelled([row(), replace(row(**{key: "other"}), run=replace(row().run, path=Path("runs/b")))])
    assert [first.label, second.label] == ["ukf a", "ukf b"]


def test_rows_whose_figures_are_not_the_same_are_told_apart_by_the_key():
    assert [one.label for one in labelled([row(), row(dropped=0.5)])] == ["ukf dropped=0", "ukf dropped=0.5"]


def test_a_title_says_what_changes_figures_and_nothing_twice():
    words = [
        "scenario=car", "+filter@filters.ekf=ekf", "runs=5", "steps=3", "seed=2", "data=files", "data.path=x",
        "scenario.dt=0.2", "filter.alpha=0.5", "filters.ekf.gate=0.9", "noise=mismatched", "noise.truth.scale=2",
        "dropped=0.5", "engine=numpy", "smooth=true", "+experiment=smoke", "verdict.lost=0.1",
        *(f"{key}=x" for key in of(NEITHER) | of(RECORD)), "++expect.rmse.x=1", "~expect", "sweep.repeats=3",
    ]  # fmt: skip
    assert changes(words) == (
        "scenario.dt=0.2", "filter.alpha=0.5", "filters.ekf.gate=0.9", "noise=mismatched", "noise.truth.scale=2",
        "dropped=0.5", "engine=numpy", "smooth=true", "experiment=smoke", "verdict.lost=0.1",
    )  # fmt: skip


def test_the_command_of_the_best_trial_has_all_that_its_figures_need():
    words = ("expect=null", "report=false", "plugins=[mine]", "scenario=car", "filter.alpha=0.5", "cores=1",
             "objective=nees", "output=o", "plots=false", "sweep.trials=3", "keep_runs=2")  # fmt: skip
    command = trials.command(trials.Trial(Planned(0, "0", words, {}, "")))
    assert command == "estlab run 'plugins=[mine]' scenario=car filter.alpha=0.5 keep_runs=2"
    assert words_without(["sweep.trials=3", "sweeper=x"], NEITHER) == ["sweeper=x"]


@pytest.mark.parametrize(
    ("words", "keys"),
    [
        (("filter=pf", "filter.particles=0"), ["filter.particles"]),
        (("+filter@filters.mine=pf", "filters.mine.particles=0"), ["filters.mine.particles"]),
    ],
)
def test_an_error_names_the_key_that_was_typed(words, keys):
    with pytest.raises(UserError, match=keys[0].replace(".", r"\.")):
        check(build(composed("scenario=sonar", *words), Names("sonar", "pf")))


def test_one_filter_and_several_are_a_mapping_inside():
    one, several = settings("filter=ekf"), settings("+filter@filters.mine=ekf", "+filter@filters.b=ukf")
    assert list(one.filters) == ["ekf"]
    assert one.filter is one.filters["ekf"]
    assert one.filter_key("ekf") == "filter"
    assert list(several.filters) == ["mine", "b"]
    assert [several.filter_key(name) for name in several.filters] == ["filters.mine", "filters.b"]
    with pytest.raises(ValueError, match="too many"):
        _ = several.filter
