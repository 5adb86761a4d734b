"""Files written read back the same; files that are wrong get one line that says where."""

import json
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from estlab.cli.main import main
from tests.conftest import options

pytestmark = pytest.mark.slow

LAYOUT = {
    "landmark": {"Odometry.dat", "Measurement.dat", "Groundtruth.dat", "Landmark_Groundtruth.dat", "Barcodes.dat"},
    "car": {"problem3data.mat", "problem3truth.mat"},
    "sonar": {"problem4data.mat", "problem4truth.mat"},
    "epuck": {"XYData_cm.csv", "HeadingAngle_rad.csv"},
    "field": {"evaluation-input.npy"},
}
WITHOUT_FILES = ["generator", "radar"]
WITHOUT_TRUTH = {"epuck"}
# What makes the prior the same from memory and from file, where it is not so anyway.
SAME_PRIOR = {"landmark": ["scenario.initial=truth"], "car": ["scenario.initial=document"]}


def simulate(scenario: str, *more: str) -> Path:
    assert main(["simulate", f"scenario={scenario}", "data.path=made", *more]) == 0
    return Path("made")


@cache
def _simulated(scenario: str) -> dict[str, bytes]:
    with TemporaryDirectory() as folder:
        assert main(["simulate", f"scenario={scenario}", f"data.path={folder}/made"]) == 0
        return {path.name: path.read_bytes() for path in Path(folder, "made").iterdir()}


def written(scenario: str) -> None:
    """The files of simulate, made once for all tests that spoil them or read them."""
    Path("made").mkdir()
    for name, content in _simulated(scenario).items():
        Path("made", name).write_bytes(content)


def run(scenario: str, *more: str) -> int:
    return main(
        [
            "run",
            f"scenario={scenario}",
            "data=files",
            "data.path=made",
            "plots=false",
            "report=false",
            "runs=1",
            "steps=60",
            *more,
        ]
    )


@pytest.mark.parametrize("scenario", options("scenario"))
def test_the_same_run_from_memory_and_from_file_gives_identical_estimates(scenario, capsys):
    if scenario in WITHOUT_FILES:
        pytest.skip("its problem has no files")
    made = simulate(scenario)
    assert {path.name for path in made.iterdir()} == LAYOUT[scenario]
    assert len(capsys.readouterr().out.splitlines()) == len(LAYOUT[scenario])
    assert not Path("runs").exists(), "simulate makes no run directory"
    same_prior = SAME_PRIOR.get(scenario, [])
    assert run(scenario, *same_prior, "hydra.run.dir=from_file") == 0
    same = ["plots=false", "runs=1", "steps=60", *same_prior, "hydra.run.dir=from_memory"]
    assert main(["run", f"scenario={scenario}", *same]) == 0
    one, other = (dict(np.load(f"{folder}/estimates.npz")) for folder in ("from_file", "from_memory"))
    truth = [] if scenario in WITHOUT_TRUTH else ["truth"]
    for name in ("time", *truth, "values", "mean", "cov"):
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


@pytest.mark.parametrize("scenario", WITHOUT_FILES)
def test_a_scenario_without_files_says_so_in_one_line(scenario, capsys):
    assert main(["simulate", f"scenario={scenario}", "data.path=made"]) == 2
    assert capsys.readouterr().err == f"estlab: {scenario.title()} has no file layout to write\n"
    Path("made").mkdir(exist_ok=True)
    assert run(scenario) == 2
    assert capsys.readouterr().err == f"estlab: {scenario.title()} reads no files; run it with data=simulated\n"


def test_the_files_read_are_on_record_with_their_hashes():
    made = simulate("landmark")
    assert run("landmark", "hydra.run.dir=out") == 0
    data = json.loads(Path("out/run.json").read_text())["data"]
    assert {Path(entry["file"]).name for entry in data} == LAYOUT["landmark"]
    from hashlib import sha256

    assert all(entry["sha256"] == sha256((made / Path(entry["file"]).name).read_bytes()).hexdigest() for entry in data)


def test_simulate_replaces_no_file_and_leaves_nothing_half_done(capsys):
    made = simulate("landmark")
    before = {path.name: path.read_bytes() for path in made.iterdir()}
    assert main(["simulate", "scenario=landmark", "data.path=made", "seed=2"]) == 2
    assert "made/Odometry.dat: already exists" in capsys.readouterr().err
    assert before == {path.name: path.read_bytes() for path in made.iterdir()}


def test_simulate_leaves_an_empty_folder_that_was_there(capsys):
    Path("mine").mkdir()
    for folder in ("mine", "new"):
        assert main(["simulate", "scenario=radar", f"data.path={folder}"]) == 2
        assert "Radar has no file layout to write" in capsys.readouterr().err
    assert Path("mine").is_dir()
    assert not Path("new").exists()


def test_simulate_takes_a_prefix_and_files_are_found_by_it():
    simulate("landmark", "data.prefix=robot7_")
    assert run("landmark", "data.prefix=robot7_") == 0
    assert run("landmark") == 2


def replace_line(name: str, number: int, line: str | None) -> None:
    path = Path("made") / name
    lines = path.read_text().splitlines()
    lines[number - 1 : number] = [] if line is None else [line]
    path.write_text("\n".join(lines) + "\n")


def replace_cell(name: str, number: int, column: int, text: str) -> None:
    cells = (Path("made") / name).read_text().splitlines()[number - 1].split()
    cells[column] = text
    replace_line(name, number, " ".join(cells))


def spoil_odometry(line: str | None) -> None:
    replace_line("Odometry.dat", 9, line)


def reverse(name: str) -> None:
    path = Path("made") / name
    path.write_text("\n".join(reversed(path.read_text().splitlines())))


def repeat(name: str) -> None:
    path = Path("made") / name
    path.write_text("\n".join(line for line in path.read_text().splitlines() for _ in range(2)))


def unknown_barcodes() -> None:
    path = Path("made/Barcodes.dat")
    path.write_text("\n".join(path.read_text().splitlines()[:10]))


FAULTS = {
    "missing file": (lambda: Path("made/Odometry.dat").unlink(), "made/Odometry.dat: no such file"),
    "missing shared file": (lambda: Path("made/Barcodes.dat").unlink(), "made/Barcodes.dat: no such file"),
    "too few columns": (
        lambda: spoil_odometry("1.0 2.0"),
        "made/Odometry.dat:9: 2 columns; expected the 3 columns time v w",
    ),
    "too many columns": (lambda: spoil_odometry("1 2 3 4"), "made/Odometry.dat:9: 4 columns"),
    "not a number": (lambda: spoil_odometry("1.0 fast 0.1"), "made/Odometry.dat:9: v is 'fast', not a number"),
    "nan": (lambda: replace_line("Groundtruth.dat", 12, "1.0 nan 0 0"), "made/Groundtruth.dat:12: x is nan"),
    "unsorted": (
        lambda: reverse("Odometry.dat"),
        "made/Odometry.dat:2: time 59.900 goes back; 600 of 601 rows have such times and would be left out; sort",
    ),
    "readings unsorted": (lambda: reverse("Measurement.dat"), "made/Measurement.dat"),
    "repeated": (lambda: repeat("Groundtruth.dat"), "made/Groundtruth.dat:6: time 0.000 repeats the one before"),
    "empty": (lambda: Path("made/Measurement.dat").write_text(""), "made/Measurement.dat: no data rows"),
    "comments only": (
        lambda: Path("made/Groundtruth.dat").write_text("# nothing\n"),
        "made/Groundtruth.dat: no data rows",
    ),
    "binary": (lambda: Path("made/Odometry.dat").write_bytes(bytes(range(256))), "made/Odometry.dat"),
    "unknown barcodes": (unknown_barcodes, "is not in Barcodes.dat"),
    "negative range": (
        lambda: replace_cell("Measurement.dat", 9, 2, "-2.0"),
        "made/Measurement.dat:9: range is -2, negative; the columns are time barcode range bearing",
    ),
    "bearings in degrees": (
        lambda: replace_cell("Measurement.dat", 9, 3, "-31.5"),
        "made/Measurement.dat:9: bearing is -31.5, more than a full turn; angles are in radians: convert degrees",
    ),
    "infinite range": (
        lambda: replace_cell("Measurement.dat", 9, 2, "inf"),
        "made/Measurement.dat:9: range is inf, not finite; remove the row",
    ),
    "barcode not whole": (
        lambda: replace_cell("Measurement.dat", 9, 1, "63.5"),
        "made/Measurement.dat:9: a subject or barcode is not an integer",
    ),
    "barcode twice": (
        lambda: replace_line("Barcodes.dat", 5, "8 63"),
        "made/Barcodes.dat:5: this barcode already belongs to another subject",
    ),
    "landmark twice": (
        lambda: replace_line("Landmark_Groundtruth.dat", 5, "6 1.0 1.0 0 0"),
        "made/Landmark_Groundtruth.dat:5: this subject already has a row",
    ),
    "one row": (lambda: Path("made/Odometry.dat").write_text("0 1 0\n"), "made/Odometry.dat: only one row"),
    "no reading in time": (
        lambda: Path("made/Measurement.dat").write_text("-9 63 1 0\n"),
        "made/Measurement.dat: no reading while the truth is known",
    ),
    "no truth in time": (
        lambda: Path("made/Groundtruth.dat").write_text("900 0 0 0\n901 0 0 0\n"),
        "made/Groundtruth.dat: no trusted truth at any time of Odometry.dat",
    ),
    "landmark unplaced": (
        lambda: replace_line("Landmark_Groundtruth.dat", 5, None),
        "made/Landmark_Groundtruth.dat: no row for subject 8",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_bad_text_file_is_named_with_its_line(fault, capsys):
    written("landmark")
    spoil, message = FAULTS[fault]
    spoil()
    capsys.readouterr()
    assert run("landmark", "hydra.run.dir=out") == 2
    text = capsys.readouterr().err
    assert message in text
    assert text.count("\n") == 1
    stamp = json.loads(Path("out/status.json").read_text())
    assert stamp["status"] == "failed"
    assert message in stamp["error"]


def replace_text(name: str, text: str) -> None:
    Path("made", name).write_text(text)


CSV_FAULTS = {
    "missing file": (lambda: Path("made/XYData_cm.csv").unlink(), "made/XYData_cm.csv: no such file"),
    "too few columns": (
        lambda: replace_line("XYData_cm.csv", 9, "1.5"),
        "made/XYData_cm.csv:9: 1 column; expected the 2 columns x y",
    ),
    "too many columns": (lambda: replace_line("HeadingAngle_rad.csv", 4, "1,2"), "made/HeadingAngle_rad.csv:4: 2 col"),
    "white space for commas": (
        lambda: replace_line("XYData_cm.csv", 2, "1.0 2.0"),
        "made/XYData_cm.csv:2: 1 column; expected the 2 columns x y; cells are separated by white "
        "space; separate them with commas",
    ),
    "not a number": (
        lambda: replace_line("XYData_cm.csv", 7, "1.0,far"),
        "made/XYData_cm.csv:7: y is 'far', not a number",
    ),
    "header": (lambda: replace_line("XYData_cm.csv", 1, "x,y"), "made/XYData_cm.csv:1: x is 'x', not a number"),
    "infinite": (
        lambda: replace_line("HeadingAngle_rad.csv", 3, "inf"),
        "made/HeadingAngle_rad.csv:3: alpha is inf, not finite; write nan where nothing was measured",
    ),
    "no two fixes in a row": (
        lambda: replace_text("XYData_cm.csv", "1,2\nnan,nan\n" * 90 + "1,2\n"),
        "made/XYData_cm.csv: 181 rows; no two consecutive frames of the first 180 have a fix; at least 3 are needed",
    ),
    "empty": (lambda: replace_text("XYData_cm.csv", ""), "made/XYData_cm.csv: no data rows; expected the columns x y"),
    "lengths differ": (
        lambda: replace_line("HeadingAngle_rad.csv", 181, None),
        "made/HeadingAngle_rad.csv: 180 rows for the 181 of XYData_cm.csv",
    ),
    "too short": (
        lambda: (replace_text("XYData_cm.csv", "1,2\n3,4\n"), replace_text("HeadingAngle_rad.csv", "0\n0\n")),
        "made/XYData_cm.csv: 2 rows; at least 3 are needed",
    ),
    "binary": (lambda: Path("made/XYData_cm.csv").write_bytes(bytes(range(256))), "made/XYData_cm.csv"),
}


@pytest.mark.parametrize("fault", CSV_FAULTS)
def test_a_bad_comma_separated_file_is_named_with_its_line(fault, capsys):
    written("epuck")
    spoil, message = CSV_FAULTS[fault]
    spoil()
    capsys.readouterr()
    assert run("epuck", "hydra.run.dir=out") == 2
    text = capsys.readouterr().err
    assert message in text
    assert text.count("\n") == 1
    assert json.loads(Path("out/status.json").read_text())["status"] == "failed"


@pytest.mark.parametrize("filters", ["ekf", "[ekf,ukf]"])
def test_files_without_truth_give_every_table_and_picture_and_score_nothing(filters, capsys):
    written("epuck")
    capsys.readouterr()
    assert run("epuck", f"filter={filters}", "plots=true", "smooth=true", "hydra.run.dir=out") == 0
    out = capsys.readouterr().out
    assert "the files hold no truth: nothing is scored" in out
    assert "nan" not in out
    assert "NEES / n = " not in out
    with np.load("out/estimates.npz") as arrays:
        assert np.isnan(arrays["truth"]).all()
        assert all(np.isfinite(arrays[name]).all() for name in arrays if name.endswith("mean"))
    plots = {path.name for path in Path("out/plots").iterdir()}
    assert plots == {"errors.png", "nis.png", "trajectory.png", "epuck_motion.png"}


def test_a_few_unknown_barcodes_are_left_out_and_said(capsys):
    written("landmark")
    replace_line(
        "Measurement.dat", 20, Path("made/Measurement.dat").read_text().splitlines()[19].split()[0] + " 99 1.0 0.0"
    )
    assert run("landmark") == 0
    assert (
        "Measurement.dat:20: barcode 99 is not in Barcodes.dat; left out, together with 0 more"
        in capsys.readouterr().out
    )
    assert run("landmark", "scenario.unknown_barcodes=0") == 2


def save(name: str, **variables) -> None:
    from scipy.io import savemat

    Path("made").mkdir(exist_ok=True)
    savemat(f"made/{name}", variables)


def structs(**fields) -> np.ndarray:
    count = len(next(iter(fields.values())))
    array = np.empty((1, count), dtype=[(name, object) for name in fields])
    for i in range(count):
        array[0, i] = tuple(values[i] for values in fields.values())
    return array


FRAME, STATE = np.array([[10.0, 0.1], [11.0, 0.2]]), np.array([10.0, 1, 5, 3, 4, 2])
MAT_FAULTS = {
    "no struct": (
        dict(other=np.eye(3)),
        None,
        "expected a struct array lidar with a field 'z'; the file holds other (3, 3)",
    ),
    "no field": (dict(lidar=structs(q=[FRAME])), None, "expected a struct array lidar with a field 'z'"),
    "columns": (
        dict(lidar=structs(z=[np.ones((4, 1))])),
        None,
        "lidar(1).z must be N x 2, range [m] and bearing [rad]",
    ),
    "degrees": (
        dict(lidar=structs(z=[FRAME, FRAME + [0, 30]])),
        None,
        "lidar(2).z: bearing is 30.1, more than a full turn; angles are in radians: convert degrees",
    ),
    "negative range": (
        dict(lidar=structs(z=[FRAME, -FRAME])),
        None,
        "lidar(2).z: range is -10, negative; the columns are range bearing, in this order",
    ),
    "infinite range": (dict(lidar=structs(z=[FRAME * np.inf])), None, "lidar(1).z: range is inf, not finite"),
    "nothing seen": (
        dict(lidar=structs(z=[np.empty((0, 2)), FRAME * np.nan])),
        None,
        "lidar(1).z: no point in any of 2 frames",
    ),
    "text": (dict(lidar=structs(z=["points"])), None, "lidar(1).z is not an array of numbers"),
    "times": (
        dict(lidar=structs(z=[FRAME, FRAME], t=[0.1, 0.0])),
        None,
        "problem3data.mat: element 2: time 0.000 goes back; 1 of 2 rows have such times and would be left out; sort",
    ),
    "time of two": (
        dict(lidar=structs(z=[FRAME, FRAME], t=[0.1, [0.2, 0.3]])),
        None,
        "element 2 field t must be one finite number, its time [s]",
    ),
    "other times": (
        dict(lidar=structs(z=[FRAME, FRAME], t=[0.1, 0.2])),
        dict(car=structs(x=[STATE, STATE], t=[3600.1, 3600.2])),
        "problem3truth.mat: its times t are not those of problem3data.mat",
    ),
    "infinite truth": (
        dict(lidar=structs(z=[FRAME])),
        dict(car=structs(x=[STATE * np.inf])),
        "problem3truth.mat: car(1).x: x is inf, not finite",
    ),
    "truth in degrees": (
        dict(lidar=structs(z=[FRAME, FRAME])),
        dict(car=structs(x=[STATE, STATE * [1, 1, 1, 60, 1, 1]])),
        "problem3truth.mat: element 2: heading is 180, more than a full turn",
    ),
}


@pytest.mark.parametrize("fault", MAT_FAULTS)
def test_a_bad_matlab_file_is_named_with_its_element(fault, capsys):
    data, truth, message = MAT_FAULTS[fault]
    save("problem3data.mat", **data)
    save("problem3truth.mat", **(truth or dict(car=structs(x=[STATE]))))
    assert run("car", "hydra.run.dir=out") == 2
    text = capsys.readouterr().err
    assert message in text
    assert text.count("\n") == 1
    assert json.loads(Path("out/status.json").read_text())["status"] == "failed"


def test_a_file_that_is_not_matlabs_is_refused(capsys):
    Path("made").mkdir()
    Path("made/problem3data.mat").write_text("not a mat file")
    assert run("car") == 2
    assert "made/problem3data.mat: not a readable MATLAB file" in capsys.readouterr().err


def test_a_frame_in_which_nothing_was_seen_is_not_measured():
    written("car")
    from scipy.io import loadmat

    lidar = loadmat("made/problem3data.mat")["lidar"]
    lidar[0, 10]["z"] = np.empty((0, 2))
    save("problem3data.mat", lidar=lidar)
    assert run("car", "hydra.run.dir=out") == 0
    with np.load("out/estimates.npz") as arrays:
        assert 10 not in arrays["step"]
        assert np.isfinite(arrays["mean"]).all()


def archived(path: Path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as archive:
        return dict(archive)


def save_archive(**arrays) -> None:
    with open("made/evaluation-input.npy", "wb") as stream:
        np.savez(stream, **arrays)


def spoil_archive(name: str, change) -> None:
    arrays = archived(Path("made/evaluation-input.npy"))
    arrays[name] = change(arrays[name])
    save_archive(**{key: array for key, array in arrays.items() if array is not None})


def put(at, value):
    def change(array):
        array[at] = value
        return array

    return change


def cut_archive() -> None:
    path = Path("made/evaluation-input.npy")
    path.write_bytes(path.read_bytes()[:9000])


def damage_archive() -> None:
    path = Path("made/evaluation-input.npy")
    content = bytearray(path.read_bytes())
    content[3000:3400] = bytes(400)
    path.write_bytes(content)


ARCHIVE_FAULTS = {
    "missing file": (lambda: Path("made/evaluation-input.npy").unlink(), "no such file; data.path must be"),
    "a folder": (
        lambda: (Path("made/evaluation-input.npy").unlink(), Path("made/evaluation-input.npy").mkdir()),
        "cannot be read (Is a directory)",
    ),
    "empty": (lambda: Path("made/evaluation-input.npy").write_bytes(b""), "not an archive of plain arrays"),
    "text": (lambda: Path("made/evaluation-input.npy").write_text("0 10 0"), "not an archive of plain arrays"),
    "one array": (
        lambda: np.save("made/evaluation-input.npy", np.eye(3)),
        "one array, not an archive of arrays; expected num_steps, noise_free_motion",
    ),
    "cut short": (cut_archive, "not an archive of plain arrays"),
    "damaged": (damage_archive, "not an archive of plain arrays"),
    "objects": (
        lambda: spoil_archive("real_robot_path", lambda a: a.astype(object)),
        "not an archive of plain arrays",
    ),
    "missing array": (
        lambda: spoil_archive("real_observations", lambda a: None),
        "no array real_observations; the archive holds noise_free_motion",
    ),
    "missing steps": (lambda: spoil_archive("num_steps", lambda a: None), "no array num_steps"),
    "steps": (lambda: spoil_archive("num_steps", lambda a: a + 0.5), "num_steps must be one integer >= 1"),
    "too few rows": (
        lambda: spoil_archive("noise_free_motion", lambda a: a[:150]),
        "noise_free_motion must be 200 x 3 numbers; it is float64 150 x 3",
    ),
    "columns": (
        lambda: spoil_archive("real_observations", lambda a: a[:, :1]),
        "real_observations must be 200 x 2 numbers; it is float64 200 x 1",
    ),
    "words": (
        lambda: spoil_archive("noise_free_robot_path", lambda a: a.astype(str)),
        "noise_free_robot_path must be 200 x 3 numbers",
    ),
    "nan": (
        lambda: spoil_archive("noise_free_motion", put((17, 1), np.nan)),
        "noise_free_motion[17]: trans is nan, not finite; every row needs this value",
    ),
    "infinite truth": (
        lambda: spoil_archive("real_robot_path", put((3, 0), np.inf)),
        "real_robot_path[3]: x is inf, not finite; write nan where nothing was measured",
    ),
    "degrees": (
        lambda: spoil_archive("noise_free_motion", lambda a: a * [180 / np.pi, 1, 180 / np.pi]),
        "noise_free_motion[19]: rot1 is 45, more than a full turn; angles are in radians: convert degrees",
    ),
    "truth in degrees": (
        lambda: spoil_archive("real_robot_path", lambda a: a * [1, 1, 180 / np.pi]),
        "more than a full turn; angles are in radians: convert degrees",
    ),
    "no bearing": (
        lambda: spoil_archive("real_observations", lambda a: a * [np.nan, 1]),
        "no bearing in any of the 200 rows of real_observations",
    ),
    "landmark beyond": (
        lambda: spoil_archive("real_observations", put((9, 1), 6)),
        "real_observations[9] is of landmark 6; landmarks are 0 to 5",
    ),
    "landmark before": (lambda: spoil_archive("real_observations", put((9, 1), -1)), "[9] is of landmark -1"),
    "landmark between": (lambda: spoil_archive("real_observations", put((9, 1), 1.5)), "[9] is of landmark 1.5"),
}


@pytest.mark.parametrize("fault", ARCHIVE_FAULTS)
def test_a_bad_archive_is_named_with_its_array(fault, capsys):
    written("field")
    spoil, message = ARCHIVE_FAULTS[fault]
    spoil()
    capsys.readouterr()
    assert run("field", "hydra.run.dir=out") == 2
    text = capsys.readouterr().err
    assert text.startswith("estlab: made/evaluation-input.npy: ")
    assert message in text
    assert text.count("\n") == 1
    assert json.loads(Path("out/status.json").read_text())["status"] == "failed"


def test_a_simulated_archive_has_the_arrays_of_the_real_one(shared):
    real = archived(shared / "field" / "evaluation-input.npy")
    made = archived(simulate("field") / "evaluation-input.npy")
    assert list(made) == list(real)
    for name, array in real.items():
        assert (made[name].dtype, made[name].shape) == (array.dtype, array.shape), name
    for name in ("num_steps", "noise_free_motion"):
        np.testing.assert_array_equal(made[name], real[name], err_msg=name)
    off = made["noise_free_robot_path"] - real["noise_free_robot_path"]
    off[:, 2] = np.sin(0.5 * off[:, 2])  # half a turn either way is one heading
    np.testing.assert_allclose(off, 0.0, atol=1e-9)
    np.testing.assert_array_equal(made["real_observations"][:, 1], real["real_observations"][:, 1])
