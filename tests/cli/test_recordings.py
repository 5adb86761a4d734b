"""Recordings as people have them: other names, clocks that stumble, units, what was not measured."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from estlab.cli.main import main
from tests.cli.test_files import LAYOUT, replace_line, run, simulate

pytestmark = pytest.mark.slow


def lines(name: str) -> list[str]:
    return Path("made", name).read_text().splitlines()


def rewrite(name: str, changed: list[str]) -> None:
    Path("made", name).write_text("\n".join(changed) + "\n")


def estimates(folder: str) -> dict[str, np.ndarray]:
    with np.load(f"{folder}/estimates.npz") as arrays:
        return dict(arrays)


def assert_same(one: str, other: str) -> None:
    first, second = estimates(one), estimates(other)
    for name in ("time", "values", "mean", "cov"):
        np.testing.assert_array_equal(first[name], second[name], err_msg=name)


# What was not measured.


def test_a_frame_without_a_fix_is_a_step_without_a_reading(capsys):
    simulate("epuck")
    for line in (9, 30, 31):
        replace_line("XYData_cm.csv", line, "NaN,nan")
    replace_line("HeadingAngle_rad.csv", 4, "nan")
    assert run("epuck", "plots=true", "hydra.run.dir=out") == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "made/XYData_cm.csv:9: no fix in 3 of 181 frames, this is the first; treated as missing" in out
    assert "made/HeadingAngle_rad.csv:4: no alpha in 1 of 181 frames" in out
    arrays = estimates("out")
    assert arrays["time"].size == 60, "no frame is left out"
    assert not set(arrays["step"]) & {7, 28, 29}, "frame k is step k - 1, and lines count from 1"
    assert arrays["step"].size == 57
    assert np.isfinite(arrays["mean"]).all()


def test_the_start_is_made_of_the_first_two_fixes_in_a_row(capsys):
    simulate("epuck")
    for line in (1, 3, 4):
        replace_line("XYData_cm.csv", line, "nan,nan")
    assert run("epuck", "hydra.run.dir=out") == 0
    assert "the first 4 of 181 frames are left out" in " ".join(capsys.readouterr().out.split())
    for name in LAYOUT["epuck"]:
        rewrite(name, lines(name)[4:])
    assert run("epuck", "hydra.run.dir=cut") == 0
    one, other = estimates("out"), estimates("cut")
    np.testing.assert_allclose(one["time"], other["time"] + 4.0 / 3.0, rtol=1e-12)
    np.testing.assert_allclose(one["mean"], other["mean"], rtol=1e-9)


def test_headings_are_shown_beside_the_estimates_and_may_be_missing(capsys):
    made = simulate("epuck")
    (made / "HeadingAngle_rad.csv").unlink()
    assert run("epuck", "data.path=made/XYData_cm.csv", "plots=true") == 0, "one file is all there is"
    out = " ".join(capsys.readouterr().out.split())
    assert "no HeadingAngle_rad.csv in made" in out
    assert "RMS to alpha" not in out


# Names.


def test_names_are_found_in_any_case_and_control_is_a_name_for_odometry(capsys):
    made = simulate("landmark")
    assert run("landmark", "hydra.run.dir=out") == 0
    (made / "Odometry.dat").rename(made / "CONTROL.DAT")
    (made / "Barcodes.dat").rename(made / "barcodes.dat")
    assert run("landmark", "hydra.run.dir=renamed") == 0
    assert_same("out", "renamed")
    shutil.copy(made / "barcodes.dat", made / "BARCODES.DAT")
    assert run("landmark") == 2
    assert "made/Barcodes.dat: BARCODES.DAT and barcodes.dat differ only in case" in capsys.readouterr().err


def test_any_name_is_taken_by_its_key_and_what_looks_like_it_is_named(capsys):
    made = simulate("landmark")
    (made / "Odometry.dat").rename(made / "odometrie.txt")
    assert run("landmark") == 2
    remedy = "there is odometrie.txt: select it with data.files.odometry=odometrie.txt"
    assert capsys.readouterr().err == f"estlab: made/Odometry.dat: no such file; {remedy}\n"
    assert run("landmark", "data.files.odometry=odometrie.txt") == 0
    Path("elsewhere").mkdir()
    (made / "odometrie.txt").rename("elsewhere/o.dat")
    here = Path.cwd()
    assert run("landmark", f"data.files.odometry={here}/elsewhere/o.dat", "hydra.run.dir=out") == 0
    assert main(["rerun", "out"]) == 0
    capsys.readouterr()
    assert run("landmark", "data.files.odometry=none.dat") == 2
    assert capsys.readouterr().err == "estlab: data.files.odometry: made/none.dat: no such file\n"
    assert run("landmark", "data.files.odo=none.dat") == 2
    assert (
        "data.files.odo: the scenario has no such file; its files are odometry, measurement" in capsys.readouterr().err
    )
    assert main(["run", "scenario=landmark", "data.files.odometry=o.dat"]) == 2
    assert "data.files.odometry=o.dat would not be read: add data=files" in capsys.readouterr().err


def test_a_forgotten_prefix_is_named(capsys):
    simulate("landmark", "data.prefix=robot7_")
    assert run("landmark") == 2
    assert "made/Odometry.dat: no such file; set data.prefix to one of: 'robot7_'" in capsys.readouterr().err


def test_one_file_of_several_asks_for_the_folder(capsys):
    simulate("landmark")
    assert run("landmark", "data.path=made/Odometry.dat") == 2
    assert "data.path: made/Odometry.dat is one file of several; give the folder" in capsys.readouterr().err


# Clocks.


def test_of_rows_with_one_time_the_last_counts_and_rows_that_step_back_are_dropped(capsys):
    simulate("landmark")
    assert run("landmark", "hydra.run.dir=out") == 0
    commands, truth = lines("Odometry.dat"), lines("Groundtruth.dat")
    time = commands[20].split()[0]
    commands[20:20] = [f"{time} 9 1"]
    late = "900.0 0 0"
    rewrite("Odometry.dat", [*commands[:2], late, *commands[2:40], "0.5 9 1", *commands[40:]])
    rewrite("Groundtruth.dat", [*truth[:50], truth[49].replace(truth[49].split()[1], "70.5"), *truth[50:]])
    rewrite("Groundtruth.dat", [*truth[:50], truth[30], *truth[50:]])
    capsys.readouterr()
    assert run("landmark", "hydra.run.dir=stumbling") == 0
    assert_same("out", "stumbling")
    out = " ".join(capsys.readouterr().out.split())
    assert (
        "made/Odometry.dat:4: time goes back; of 604 rows 1 left out because a later one has the same time and 2" in out
    )
    assert "; made/Groundtruth.dat:51: time goes back; of 602 rows 1 left out because they step back" in out
    assert run("landmark", "data.clock_faults=0.001") == 2
    assert "made/Odometry.dat:4: time 0.000 goes back; 3 of 604 rows have" in capsys.readouterr().err


def shift(name: str, seconds: float) -> None:
    rows = [line.split() for line in lines(name)]
    rewrite(name, [" ".join(row if row[0] == "#" else [repr(float(row[0]) + seconds), *row[1:]]) for row in rows])


@pytest.mark.parametrize("seconds", [30.0, -30.0])
@pytest.mark.parametrize("name", ["Odometry.dat", "Measurement.dat", "Groundtruth.dat"])
def test_clocks_that_are_apart_are_said(name, seconds, capsys):
    simulate("landmark")
    shift(name, seconds)
    assert run("landmark", "steps=null") == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "clocks" in out
    if name != "Groundtruth.dat":
        side = "more than 2 s after the last" if (seconds > 0.0) == (name == "Measurement.dat") else "before the first"
        assert side in out
    assert ("half of the ranges differ from the truth" in out) == (name != "Odometry.dat")
    assert ("commanded turns are nearly unrelated to" in out) == (name != "Measurement.dat")


@pytest.mark.parametrize("seconds", [3600.0, -3600.0, 1.3e9, -1.3e9])
@pytest.mark.parametrize("name", ["Odometry.dat", "Measurement.dat", "Groundtruth.dat"])
def test_clocks_with_no_time_in_common_are_refused(name, seconds, capsys):
    simulate("landmark")
    shift(name, seconds)
    assert run("landmark") == 2
    err = capsys.readouterr().err
    assert "do their times agree?" in err or "another clock?" in err
    assert err.count("\n") == 1


def test_a_prediction_over_a_hole_is_said(capsys):
    simulate("landmark")
    held = [line for line in lines("Odometry.dat") if line[0] == "#" or not 2.0 < float(line.split()[0]) < 9.0]
    read = [line for line in lines("Measurement.dat") if line[0] == "#" or not 2.0 < float(line.split()[0]) < 9.0]
    rewrite("Odometry.dat", held)
    rewrite("Measurement.dat", read)
    assert run("landmark") == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "1 of " in out
    assert "predictions are far longer than the rest, up to 7 s from 2 s on" in out


# Units.


def degrees(name: str, column: int, delimiter: str | None = None) -> None:
    rows = [line if line[0] == "#" else line.split(delimiter) for line in lines(name)]
    for row in rows:
        if not isinstance(row, str):
            row[column] = repr(float(row[column]) * 180.0 / np.pi)
    rewrite(name, [row if isinstance(row, str) else (delimiter or " ").join(row) for row in rows])


@pytest.mark.parametrize(
    ("scenario", "name", "column"),
    [
        ("landmark", "Measurement.dat", 3),
        ("landmark", "Groundtruth.dat", 3),
        ("landmark", "Odometry.dat", 2),
        ("epuck", "HeadingAngle_rad.csv", 0),
    ],
)
def test_angles_in_degrees_are_found_out(scenario, name, column, capsys):
    simulate(scenario)
    degrees(name, column)
    assert run(scenario) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"estlab: made/{name}")
    assert "angles are in radians" in err
    assert err.count("\n") == 1


def test_headings_that_add_up_over_many_turns_are_radians():
    simulate("epuck")
    alpha = np.unwrap(np.array([float(line) for line in lines("HeadingAngle_rad.csv")])) + 8.0 * np.pi
    rewrite("HeadingAngle_rad.csv", [repr(float(a)) for a in alpha])
    assert run("epuck") == 0


# What is no file.


@pytest.mark.parametrize(("scenario", "name"), [(s, n) for s in LAYOUT for n in sorted(LAYOUT[s])])
@pytest.mark.parametrize("what", ["pipe", "folder", "huge"])
def test_what_is_no_file_of_a_sane_size_is_refused_without_waiting(scenario, name, what, capsys):
    path = simulate(scenario) / name
    capsys.readouterr()
    path.unlink()
    if what == "pipe":
        os.mkfifo(path)
    elif what == "folder":
        path.mkdir()
    else:
        path.touch()
        os.truncate(path, 100 * 2**30)
    assert run(scenario) == 2
    said = {
        "pipe": "cannot be read (a pipe, not a file)",
        "folder": "cannot be read (Is a directory)",
        "huge": "107 GB; at most 0.27 GB are read",
    }
    assert capsys.readouterr().err == f"estlab: made/{name}: {said[what]}\n"


# Without truth.


def test_without_truth_a_robot_starts_where_two_landmarks_tell_it(capsys):
    made = simulate("landmark")
    assert run("landmark", "hydra.run.dir=out", "steps=null") == 0
    (made / "Groundtruth.dat").unlink()
    capsys.readouterr()
    assert run("landmark", "hydra.run.dir=bare", "steps=null") == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "nothing is scored: no Groundtruth.dat in made" in out
    assert "data.prefix" not in out, "Landmark_Groundtruth.dat is another kind of file"
    one, bare = estimates("out"), estimates("bare")
    assert np.isnan(bare["truth"]).all()
    last = np.isin(one["time"], bare["time"])
    off = np.hypot(*(one["mean"][:2, last, 0] - bare["mean"][:2, :, 0]))
    assert off[0] < 1.0
    assert off[-1] < 0.01, "what the start was is forgotten"


def test_without_truth_and_two_landmarks_the_start_is_not_known(capsys):
    made = simulate("landmark")
    (made / "Groundtruth.dat").unlink()
    read = [line for line in lines("Measurement.dat") if line[0] != "#"]
    rewrite("Measurement.dat", [line for line in read if line.split()[1] == read[0].split()[1]])
    capsys.readouterr()
    assert run("landmark") == 2
    assert "are never seen within 1 s, so the start is unknown without truth" in capsys.readouterr().err
