"""Recordings whose files disagree in units, signs, clocks or barcodes: said, or refused where no time is a second."""

import numpy as np
import pytest

from estlab.datasets import agreement, mrclam
from estlab.datasets.clocks import in_order
from estlab.datasets.data_files import Options
from estlab.datasets.truth import first_of_each
from estlab.errors import UserError
from estlab.scenarios.landmark_files import timeline
from tests.conftest import ROOT

SAMPLE = ROOT / "data" / "landmark"
TIMED = ("Odometry.dat", "Measurement.dat", "Groundtruth.dat")


def remarks(folder, changed):
    """What is said of the shipped recording where columns of its files are changed: (file, column) -> function."""
    for path in SAMPLE.iterdir():
        table = np.loadtxt(path)
        for column in range(table.shape[1]):
            table[:, column] = changed.get((path.name, column), lambda values: values)(table[:, column])
        np.savetxt(folder / path.name, table, fmt="%.12g")
    recording = mrclam.read(folder, "", 0.01, Options())
    return timeline(recording, 0.1, 2.0, [0.3, 0.15]).remarks


def exchanged(codes):
    pairs = {codes[4]: codes[10], codes[10]: codes[4]}
    return [pairs.get(code, code) for code in codes]


SAID = {
    "as it is": ({}, None),
    "milliseconds": ({(name, 0): lambda t: 1000.0 * t for name in TIMED}, "commanded distances are 8.3e+02 times"),
    "km/h": ({("Odometry.dat", 1): lambda v: 3.6 * v}, "commanded distances are 3 times those of the truth"),
    "backward": ({("Odometry.dat", 1): np.negative}, "commanded distances are -0.83 times those of the truth"),
    "bearings to the right": ({("Measurement.dat", 3): np.negative}, "half of the bearings differ from the truth by"),
    "ranges in cm": ({("Measurement.dat", 2): lambda r: 100.0 * r}, "half of the ranges differ from the truth by"),
    "two barcodes exchanged": ({("Barcodes.dat", 1): exchanged}, "half of the ranges to barcodes 61, 81 differ"),
    "truth of another clock": ({("Groundtruth.dat", 0): lambda t: 1000.0 * t}, "do its clock and that of the commands"),
}


@pytest.mark.parametrize("fault", SAID)
def test_files_that_disagree_are_said_and_files_that_agree_are_not(fault, tmp_path):
    changed, said = SAID[fault]
    found = remarks(tmp_path, changed)
    assert (found == ()) if said is None else (said in " ".join(found)), found


@pytest.mark.parametrize("unit", [1e6, 1e9])
def test_times_that_cannot_be_seconds_are_refused(unit):
    with pytest.raises(UserError, match=r"half of the steps take .* s or more; times must be in seconds"):
        in_order(unit * 0.1 * np.arange(50.0), lambda i: f"f:{i + 1}", 0.05)


@pytest.mark.parametrize("length", [0.05, 0.1, 1.0])
def test_marks_on_a_way_are_the_first_of_each_unit_and_no_way_is_too_long(length):
    way = np.cumsum(np.random.default_rng(1).exponential(0.1, 400))
    way -= way[0]
    known = np.unique(np.searchsorted(way, np.arange(0.0, way[-1], length)))
    np.testing.assert_array_equal(first_of_each(way, length), known)
    assert first_of_each(np.array([0.0, 1.0, 1e300]), length).tolist() == [0, 1, 2]


def test_numbers_without_end_are_no_distance():
    truth = np.zeros(40)
    assert agreement.of_lengths(np.full(39, 1.0), truth, truth, truth, "f") == ()


def test_a_landmark_with_a_robots_number_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"Landmark_Groundtruth.dat:1: subjects 1 to 5 are robots"):
        remarks(tmp_path, {(name, 0): lambda s: s - 5 for name in ("Landmark_Groundtruth.dat", "Barcodes.dat")})


@pytest.mark.parametrize("robot", range(1, 6))
def test_all_robots_of_the_real_recording_agree_and_run(robot, shared, tmp_path, monkeypatch):
    from estlab.cli.main import main

    folder = shared / "MRCLAM_Dataset6"
    if not folder.is_dir():
        pytest.skip("MRCLAM_Dataset6 is not among the real recordings")
    monkeypatch.chdir(tmp_path)
    words = [f"data.path={folder}", f"data.prefix=Robot{robot}_", "filter=ekf", "steps=300", "plots=false"]
    assert main(["run", "scenario=landmark", "data=files", *words, "report=false", "hydra.run.dir=out"]) == 0
    with np.load("out/estimates.npz") as arrays:
        assert arrays["time"].size == 300
        assert np.isfinite(arrays["mean"]).all()
        assert np.nanmax(np.abs(arrays["mean"][:2] - arrays["truth"][:2])) < 1.0
