"""Runs from their directories: tables of stable types, estimates by component, the pictures that were drawn."""

import json
import shutil
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest

import estlab
from estlab.api.tables import COLUMNS
from estlab.report.figures import png

TABLES = {"metrics.csv", "errors.csv", "nees.csv", "nis.csv", "tests.csv", "runs.csv", "comparison.csv", "coverage.csv"}


@pytest.fixture(scope="module")
def run(folder):
    return estlab.load(folder)


@pytest.mark.parametrize("file", sorted(TABLES))
def test_a_table_has_its_file_s_lines_and_the_documented_types(run, folder, file):
    found = getattr(run, file.removesuffix(".csv"))
    there = pd.read_csv(folder / file, keep_default_na=False, na_values=[""])
    assert set(found) == set(there)
    for name in found:
        kind = COLUMNS[file].get(name, float)
        assert found[name].dtype == {int: "int64", str: pd.Series([""], dtype=str).dtype}.get(kind, kind)
        column = there[name] if kind is not str else there[name].fillna("")
        np.testing.assert_array_equal(found[name], column)


def test_a_table_that_the_run_has_not_is_one_without_rows_and_with_the_same_types(run, tmp_path, folder):
    assert list(run.expectations) == list(COLUMNS["expectations.csv"])
    assert len(run.expectations) == 0
    lacking = tmp_path / "run"
    shutil.copytree(folder, lacking)
    (lacking / "comparison.csv").unlink()
    assert estlab.load(lacking).comparison.dtypes.equals(run.comparison.dtypes)


def test_a_table_of_an_earlier_version_that_lacks_columns_has_them_all(run, tmp_path, folder):
    earlier = tmp_path / "run"
    shutil.copytree(folder, earlier)
    tests = pd.read_csv(folder / "tests.csv").drop(columns=["outcome", "level", "seed"])
    tests.to_csv(earlier / "tests.csv", index=False)
    found = estlab.load(earlier).tests
    assert found.dtypes.equals(run.tests.dtypes)
    assert set(found["outcome"]) == {""}
    assert found["level"].isna().all()
    np.testing.assert_array_equal(found["value"], run.tests["value"])


def test_the_estimates_are_those_that_the_run_kept(run, folder):
    with np.load(folder / "estimates.npz") as arrays:
        for name, found in run.estimates.items():
            np.testing.assert_array_equal(found.mean, arrays[f"{name}.mean"])
            np.testing.assert_array_equal(found.cov, arrays[f"{name}.cov"])
            np.testing.assert_array_equal(found.truth, arrays["truth"])
            assert found.mean.shape == (3, 25, 3)


def test_a_component_s_error_and_sigma_are_those_of_errors_csv(run):
    for name, found in run.estimates.items():
        for component in found.names:
            lines = run.errors[(run.errors["filter"] == name) & (run.errors["component"] == component)]
            mine = found[component]
            np.testing.assert_array_equal(mine.error[:, 0], lines["error"])
            np.testing.assert_array_equal(mine.sd[:, 0], lines["sigma"])
            assert mine.unit == lines["unit"].iloc[0]
    with pytest.raises(estlab.UserError, match="there is no component headin; did you mean heading"):
        _ = run.estimates["ekf"]["headin"]


def test_the_verdict_of_a_filter_is_that_of_verdicts_csv(run, folder):
    there = pd.read_csv(folder / "verdicts.csv").set_index("filter")
    assert list(run.verdict) == ["ekf", "pf"]
    for name, verdict in run.verdict.items():
        assert (verdict.word, verdict.sentence) == tuple(there.loc[name, ["word", "sentence"]])


@pytest.mark.slow
def test_the_pictures_of_the_directory_are_drawn_again_to_the_last_pixel(run, folder):
    plots = {path.stem: path.read_bytes() for path in (folder / "plots").glob("*.png")}
    assert set(run.figures) == set(plots)
    for name in ("errors", "trajectory", "distribution", "cloud_pf"):  # one of each source: tables, arrays, both
        content, figure = plots[name], run.figure(name)
        assert png(figure) == content
        assert figure._repr_png_() == content  # what a notebook asks for
    with pytest.raises(estlab.UserError, match="there is no figure error; did you mean errors"):
        run.figure("error")


class _Tags(HTMLParser):
    def __init__(self):
        super().__init__()
        self.open, self.texts = [], []

    def handle_starttag(self, tag, attrs):
        self.open += [tag] if tag != "br" else []

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


def test_a_notebook_shows_a_run_with_nothing_in_it_taken_for_markup(folder, tmp_path):
    evil = tmp_path / "<img src=x onerror=alert(1)>"
    shutil.copytree(folder, evil)
    facts = json.loads((evil / "run.json").read_text())
    facts["title"] = "<script>alert(2)</script>\x1b[31m"
    (evil / "run.json").write_text(json.dumps(facts))
    shown = estlab.load(evil)._repr_html_()
    parser = _Tags()
    parser.feed(shown)
    assert parser.open == []
    assert "<script" not in shown and "<img" not in shown and "\x1b" not in shown
    assert {"ekf", "pf", "RMSE position [m]", "NEES / n", "0 of 20"} <= set(parser.texts)


def test_a_run_says_what_it_is(run, folder):
    assert repr(run).startswith("Run(landmark · ekf, pf · 20 runs × 25 steps · seed 1")
    assert f"; ok; {folder})\n  ekf is " in repr(run)
    assert (run.scenario, run.filters, run.status, run.unmet) == ("landmark", ("ekf", "pf"), "ok", "")
    assert run.config["runs"] == 20
    assert run.path == folder


def test_latest_a_link_a_folder_and_a_pattern_name_a_run(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    shutil.copytree(folder, tmp_path / "runs/day/one")
    (tmp_path / "runs/latest").symlink_to("day/one")
    for word in ("latest", "runs/latest", "runs/day", "runs/*/o*", tmp_path / "runs/day/one"):
        assert estlab.load(word).scenario == "landmark"
    assert estlab.load().scenario == "landmark"
    shutil.copytree(folder, tmp_path / "runs/day/two")
    with pytest.raises(estlab.UserError, match=r"runs/day: contains 2 runs \(runs/day/one, runs/day/two\); name one"):
        estlab.load("runs/day")
    with pytest.raises(estlab.UserError, match="there is no runs/none"):
        estlab.load("runs/none")


def test_a_run_without_a_whole_result_says_so_where_its_metrics_are_asked_for(folder, tmp_path):
    stopped = tmp_path / "run"
    shutil.copytree(folder, stopped)
    status = json.loads((stopped / "status.json").read_text())
    (stopped / "status.json").write_text(json.dumps(status | {"status": "failed", "error": "the disk was full"}))
    run = estlab.load(stopped)
    assert run.status == "failed"
    with pytest.raises(estlab.UserError, match=r"has no complete result \(failed: the disk was full"):
        _ = run.metrics
    assert "the disk" not in run._repr_html_()
    table = estlab.runs(stopped)
    assert list(table["problem"]) == ["failed: the disk was full"]


def test_the_table_of_runs_has_a_row_for_each_filter_of_each_run(run, folder, tmp_path):
    shutil.copytree(folder, tmp_path / "a/one")
    shutil.copytree(folder, tmp_path / "a/broken")
    (tmp_path / "a/broken/metrics.csv").write_text("nothing")
    table = estlab.runs(tmp_path / "a")
    assert list(table["filter"]) == ["ekf", "ekf", "pf"]
    assert list(table["problem"] == "") == [False, True, True]
    assert "metrics.csv" in table["problem"][0]
    ours = table[table["problem"] == ""].set_index("filter")
    metrics = run.metrics.set_index(["filter", "metric", "component"])["value"]
    for name in ("ekf", "pf"):
        assert ours.loc[name, "rmse.position"] == metrics[name, "rmse", "position"]
        assert ours.loc[name, "anees"] == metrics[name, "anees", "all"]
        assert ours.loc[name, "verdict"] == run.verdict[name].word
    assert str(table["began"].dtype.tz) == "UTC"
    assert list(table[["runs", "steps", "seed"]].iloc[1]) == [20, 25, 1]
    assert len(estlab.runs(folder, tmp_path / "a/one")) == 4
