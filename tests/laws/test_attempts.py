"""Nothing that is computed after the filters loses a run: each statistic, table and picture thrown out in turn."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from estlab import rundir
from estlab.errors import IncompleteError
from estlab.experiment import compute, drawing, statistics, write
from estlab.experiment.attempts import Attempts
from estlab.experiment.result import Result
from estlab.metrics import filter_tables, series, tabulated
from estlab.metrics.tally import Tally
from estlab.report import plots
from estlab.scenarios.sonar import Sonar
from tests.conftest import settings

SONAR = ("scenario=sonar", "filter=pf", "filter.particles=300", "runs=20", "steps=8", "plots=false", "cores=1")
CAR = ("scenario=car", "+filter@filters.ekf=ekf", "+filter@filters.ukf=ukf", "runs=20", "steps=8", "cores=1")


class Made:
    """An ensemble, of which everything is made again with something broken."""

    def __init__(self, *overrides: str) -> None:
        self.settings = settings(*overrides)
        self.ensemble = compute.compute_part(self.settings)

    def result(self, plots: bool) -> Result:
        facts = {"title": "title", "data": [], "seconds_per_run_and_step": self.ensemble.cost(20)}
        return compute.result_of(replace(self.settings, plots=plots), self.ensemble, facts)

    def written(self, folder: Path, plots: bool) -> Attempts:
        result = self.result(plots)
        write.write(result, rundir.RunDirectory(folder))
        return result.attempts


@pytest.fixture(scope="module")
def sonar() -> Made:
    return Made(*SONAR)


@pytest.fixture(scope="module")
def car() -> Made:
    return Made(*CAR)


def files(folder: Path) -> dict[str, bytes]:
    return {
        str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.suffix in (".csv", ".npz", ".png")
    }


def broken(*_args, **_keys):
    raise ZeroDivisionError("one over\nnothing")


FIGURES = [
    (tabulated, "_all_components", {"shares inside of pf"}, False),
    (tabulated, "_judged", {"judged figures of pf"}, False),
    (tabulated, "_credibility", {"credibility of pf"}, False),
    (tabulated, "_innovations", {"likelihood of pf"}, False),
    (tabulated, "_efficiency", {"efficiency of pf"}, False),
    (tabulated, "_found", {"found of pf"}, False),
    (tabulated, "_noted", {"the filter's notes of pf"}, False),
    (tabulated, "_diverged", {"diverged runs of pf"}, False),
    (tabulated, "_errors", {"errors of pf"}, True),
    (statistics, "consistency_tests", {"tests of pf"}, False),
    (statistics, "judge", {"verdict on pf"}, False),
    (series, "errors", {"pf in errors.csv"}, False),
    (series, "nees", {"pf in nees.csv"}, False),
    (series, "nis", {"pf in nis.csv"}, False),
    (series, "notes", {"pf in notes.csv"}, False),
    (filter_tables, "coverage_rows", {"pf in coverage.csv"}, False),
    (filter_tables, "histogram_rows", {"pf in histograms.csv"}, False),
    (filter_tables, "test_rows", {"pf in tests.csv"}, False),
    (statistics, "_bound", {"Cramér-Rao bound"}, False),
    (Sonar, "table", {"sonar.csv"}, False),
]


@pytest.fixture(scope="module")
def whole(sonar, tmp_path_factory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("whole")
    assert sonar.written(folder, plots=False).missing == {}
    return files(folder)


@pytest.mark.parametrize(("where", "name", "missing", "needed"), FIGURES, ids=[name for _, name, *_ in FIGURES])
def test_a_statistic_or_table_that_throws_is_missing_alone(
    where, name, missing, needed, sonar, whole, monkeypatch, tmp_path
):
    monkeypatch.setattr(where, name, broken)
    attempts = sonar.written(tmp_path, plots=False)
    assert set(attempts.missing) == missing
    (remark,) = attempts.remarks()
    assert remark == f"missing: {missing.pop()} (ZeroDivisionError: one over nothing); the traceback is in log.txt"
    if needed:
        with pytest.raises(IncompleteError, match=r"the run is incomplete, errors of pf is missing .ZeroDivisionError"):
            attempts.complete(tmp_path)
    else:
        attempts.complete(tmp_path)
    kept = files(tmp_path)
    # A test that is missing takes the verdict with it, and both are lines of metrics.csv.
    assert len(whole) - len(kept) <= 2
    lines = {file: kept[file].splitlines() for file in kept}
    assert all(set(lines[file]) <= set(whole[file].splitlines()) for file in kept if file.endswith(".csv"))
    assert {file for file in kept if kept[file] != whole[file]} <= {"metrics.csv"}


@pytest.mark.parametrize("file", ["metrics.csv", "estimates.npz", "errors.csv", "runs.csv", "comparison.csv"])
def test_a_file_that_cannot_be_written_is_missing_alone(file, car, monkeypatch, tmp_path):
    write = rundir.RunDirectory.write

    def picky(directory, name, put):
        return write(directory, name, broken if name == file else put)

    monkeypatch.setattr(rundir.RunDirectory, "write", picky)
    attempts = car.written(tmp_path, plots=False)
    assert set(attempts.missing) == {file}
    assert len(files(tmp_path)) == 11
    if file in ("metrics.csv", "estimates.npz"):
        with pytest.raises(IncompleteError, match=file):
            attempts.complete(tmp_path)
    else:
        attempts.complete(tmp_path)


def test_one_filters_table_may_be_missing_and_the_others_is_there(car, monkeypatch, tmp_path):
    nees = series.nees
    monkeypatch.setattr(
        series, "nees", lambda tally: broken() if tally is car.ensemble.total.tallies["ekf"] else nees(tally)
    )
    assert set(car.written(tmp_path, plots=False).missing) == {"ekf in nees.csv"}
    text = (tmp_path / "nees.csv").read_text()
    assert "ukf" in text
    assert "ekf" not in text


@pytest.mark.slow
def test_pictures_that_throw_are_missing_alone(sonar, monkeypatch, tmp_path):
    monkeypatch.setattr(drawing, "png", lambda figure: b"png")
    assert sonar.written(tmp_path / "whole", plots=True).missing == {}
    every = {file for file in files(tmp_path / "whole") if file.endswith(".png")}
    assert every >= {f"plots/{name}.png" for name in ("errors", "nees", "nis", "ess", "distribution", "trajectory")}
    thrown: set[str] = set()
    for number, name in enumerate(sorted(name for name in vars(plots) if name.startswith("draw_"))):
        with monkeypatch.context() as patch:
            patch.setattr(plots, name, broken)
            attempts = sonar.written(tmp_path / str(number), plots=True)
        kept = {file for file in files(tmp_path / str(number)) if file.endswith(".png")}
        assert kept | set(attempts.missing) == every
        attempts.complete(tmp_path)
        thrown |= set(attempts.missing)
    assert thrown == every - {"plots/likelihood.png"}


def test_a_problems_own_pictures_and_what_it_adds_to_others_may_throw(sonar, monkeypatch, tmp_path):
    monkeypatch.setattr(drawing, "png", lambda figure: b"png")
    monkeypatch.setattr(Sonar, "pictures", broken)
    monkeypatch.setattr(Sonar, "draw", broken)
    attempts = sonar.written(tmp_path, plots=True)
    assert set(attempts.missing) == {"the problem's own pictures", "the problem's additions to pictures"}
    assert (tmp_path / "plots/trajectory.png").exists()


def test_a_picture_that_cannot_be_rendered_is_missing_alone(sonar, monkeypatch, tmp_path):
    monkeypatch.setattr(drawing, "png", lambda figure: broken() if len(figure.axes) == 2 else b"png")
    assert set(sonar.written(tmp_path, plots=True).missing) == {"plots/distribution.png"}


def test_sums_that_throw_leave_the_estimates(monkeypatch, tmp_path):
    monkeypatch.setattr(Tally, "add", broken)
    attempts = Made(*SONAR).written(tmp_path, plots=False)
    assert set(attempts.missing) >= {"statistics of pf"}
    with pytest.raises(
        IncompleteError, match=r"statistics of pf.* is missing .RuntimeError: ZeroDivisionError in the stat"
    ):
        attempts.complete(tmp_path)
    with np.load(tmp_path / "estimates.npz") as arrays:
        assert arrays["mean"].shape == (3, 8, 20)


def test_warnings_made_errors_are_seen():
    attempts = Attempts()

    def warn():
        raise RuntimeWarning("overflow")

    with pytest.raises(RuntimeWarning):
        attempts.made("a mean", warn)


def test_a_disk_that_fails_is_no_fault_of_one_table():
    attempts = Attempts()

    def full(stream):
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"):
        attempts.put("errors.csv", lambda: full(None))
    assert attempts.made("a plugin's picture", lambda: full(None)) is None
