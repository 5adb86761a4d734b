"""Compute, then write, then tell: computing touches neither disk nor terminal, and a directory is its result."""

import io

import numpy as np
import pytest

from estlab import rundir
from estlab.experiment import experiment
from estlab.experiment.compute import compute
from estlab.experiment.result import Result
from estlab.experiment.write import write
from estlab.metrics import filter_tables
from estlab.report import csv_tables, plots
from tests.conftest import settings

WORDS = ("scenario=car", "+filter@filters.ekf=ekf", "+filter@filters.ukf=ukf", "runs=4", "steps=8", "cores=1")
EXPECTED = ("++expect.rmse.x.min=0",)


@pytest.fixture(scope="module")
def result() -> Result:
    return compute(settings(*WORDS, *EXPECTED, "plots=false"))


def test_computing_writes_and_prints_nothing(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    opened = open

    def reading_alone(file, mode="r", *more, **keys):
        assert not set(mode) & set("wax+"), f"{file} was opened to write"
        return opened(file, mode, *more, **keys)

    monkeypatch.setattr("builtins.open", reading_alone)
    found = compute(settings(*WORDS, "plots=false", "engine=numpy"))
    assert found.title.startswith("car · ekf, ukf · 4 runs × 8 steps")
    assert found.attempts.missing == {}
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_the_facts_are_said_as_soon_as_they_are_known():
    said: dict[str, object] = {}
    found = compute(settings(*WORDS, "plots=false"), lambda **facts: said.update(facts))
    assert said == found.facts
    assert list(said) == ["title", "data", "steps", "cores", "seconds_per_run_and_step"]


def test_a_directory_holds_the_tables_and_arrays_of_its_result(result, tmp_path, capsys):
    write(result, rundir.RunDirectory(tmp_path))
    assert capsys.readouterr().out == ""
    assert {path.name for path in tmp_path.glob("*.csv")} == set(result.tables)
    for file in result.tables:
        stream = io.BytesIO()
        csv_tables.write(result.table(file), stream)
        assert (tmp_path / file).read_bytes() == stream.getvalue()
    with np.load(tmp_path / rundir.ESTIMATES) as arrays:
        assert list(arrays) == list(result.arrays)
        assert all(np.array_equal(arrays[name], array) for name, array in result.arrays.items())


def test_every_column_of_a_table_is_as_long_as_the_others_and_no_other_table_is_given(result):
    for file in result.tables:
        assert len({len(column) for column in result.table(file).values()}) == 1, file
    with pytest.raises(KeyError):
        result.table("unknown.csv")


def test_a_run_is_computed_written_and_told_in_this_order(tmp_path, monkeypatch, capsys):
    order = []
    for name in ("compute", "write", "_print"):
        real = getattr(experiment, name)

        def noted(*given, name=name, real=real):
            order.append((name, (tmp_path / "run/metrics.csv").exists(), bool(capsys.readouterr().out)))
            return real(*given)

        monkeypatch.setattr(experiment, name, noted)
    words = settings(*WORDS, *EXPECTED, "plots=false")
    held = experiment.run(words, rundir.RunDirectory(tmp_path / "run"), ["estlab", "run"])
    assert order == [("compute", False, False), ("write", False, False), ("_print", True, False)]
    assert held
    assert "expectation" in capsys.readouterr().out


def test_a_table_and_a_picture_are_a_function_each(monkeypatch, tmp_path):
    monkeypatch.setattr(filter_tables, "TABLES", filter_tables.TABLES.copy())
    monkeypatch.setattr("estlab.experiment.statistics.TABLES", filter_tables.TABLES)
    monkeypatch.setattr(plots, "_PICTURES", {})
    monkeypatch.setattr(plots, "_OF_EACH_FILTER", {})

    @filter_tables.table
    def steps(of):
        return {"step": np.arange(of.tally.time.size)}

    @plots.picture
    def steps_drawn(data):
        from matplotlib.figure import Figure

        assert sorted(data.tables["steps.csv"]) == ["ekf", "ukf"]
        return Figure()

    @plots.picture_of_filter
    def none_drawn(data, filter):
        assert filter in ("ekf", "ukf")

    found = compute(settings(*WORDS))
    write(found, rundir.RunDirectory(tmp_path))
    assert found.attempts.missing == {}
    assert (tmp_path / "steps.csv").read_text().splitlines()[:2] == ["filter,step,seed", "ekf,0,1"]
    assert {path.name for path in (tmp_path / "plots").iterdir()} == {"steps_drawn.png"}
