"""The sonar's MATLAB files: read back exactly, and one line that names the element where they are wrong."""

import json
from pathlib import Path

import numpy as np
import pytest

from estlab.cli.main import main
from tests.cli.test_files import run, save, simulate, structs

U, Z, X = np.array([0.1, 0.2]), np.array([2.0, 3.0, 5.0]), np.array([1.0, 2.0, 0.5])
MARKS = np.array([[0.0, 0.0], [9.0, 1.0], [4.0, 8.0], [15.0, 12.0], [-3.0, 15.0]])
GOOD = dict(
    encoder=structs(u=[U, U]), sonar=structs(z=[Z, Z]), beacons=MARKS, minx=-5.0, maxx=20.0, miny=-5.0, maxy=20.0
)
TRUTH = dict(robot=structs(x=[X, X]))


def test_a_particle_filter_from_memory_and_from_file_gives_identical_estimates():
    simulate("sonar")
    pf = ["filter=pf", "filter.particles=200"]
    assert run("sonar", *pf, "hydra.run.dir=from_file") == 0
    assert main(["run", "scenario=sonar", *pf, "plots=false", "runs=1", "steps=60", "hydra.run.dir=from_memory"]) == 0
    one, other = (dict(np.load(f"{folder}/estimates.npz")) for folder in ("from_file", "from_memory"))
    assert set(one) == set(other)
    for name, array in one.items():
        np.testing.assert_array_equal(array, other[name], err_msg=name)


def test_the_layout_is_the_documents():
    from scipy.io import loadmat

    data = loadmat(simulate("sonar") / "problem4data.mat")
    assert data["encoder"]["u"][0, 7].shape == (2, 1)
    assert data["sonar"]["z"][0, 7].shape == (3, 1)
    assert data["beacons"].shape == (5, 2), "one beacon per row"
    assert [data[name].item() for name in ("minx", "maxx", "miny", "maxy")] == [-5.0, 20.0, -5.0, 20.0]
    assert loadmat("made/problem4truth.mat")["robot"]["x"][0, 7].shape == (3, 1)


def test_files_without_times_or_with_row_vectors_are_taken():
    save("problem4data.mat", **GOOD)
    save("problem4truth.mat", **TRUTH)
    assert run("sonar", "hydra.run.dir=out") == 0
    with np.load("out/estimates.npz") as arrays:
        np.testing.assert_allclose(arrays["time"], [0.1, 0.2])
        np.testing.assert_array_equal(arrays["places"], MARKS.T)
        np.testing.assert_array_equal(arrays["truth"][:, :, 0].T, [X, X])


def without(name: str) -> dict:
    return {key: value for key, value in GOOD.items() if key != name}


DATA, STATES = "made/problem4data.mat: ", "made/problem4truth.mat: "
FAULTS = {
    "no encoder": (without("encoder"), TRUTH, DATA + "expected a struct array encoder with a field 'u'; the file"),
    "no sonar": (without("sonar"), TRUTH, DATA + "expected a struct array sonar with a field 'z'"),
    "no beacons": (without("beacons"), TRUTH, DATA + "expected a variable beacons; the file holds encoder ('u',), son"),
    "no bound": (without("maxy"), TRUTH, DATA + "expected a variable maxy"),
    "no field": (GOOD | dict(sonar=structs(y=[Z, Z])), TRUTH, DATA + "expected a struct array sonar with a field 'z'"),
    "two ranges": (
        GOOD | dict(sonar=structs(z=[Z, Z[:2]])),
        TRUTH,
        DATA + "sonar(2).z must be 3 finite numbers [nearest second third]; it is of shape (1, 2)",
    ),
    "infinite range": (GOOD | dict(sonar=structs(z=[Z * np.inf, Z])), TRUTH, DATA + "sonar(1).z: nearest is inf, not"),
    "nothing heard": (
        GOOD | dict(sonar=structs(z=[Z * np.nan, []])),
        TRUTH,
        DATA + "sonar(1).z: no complete sonar reading in any of 2 frames",
    ),
    "not ascending": (
        GOOD | dict(sonar=structs(z=[Z[::-1], Z[[1, 0, 2]]])),
        TRUTH,
        DATA + "sonar(1).z [5 3 2] does not ascend, as 2 of 2 do not; they must be the ranges to the nearest,",
    ),
    "negative range": (
        GOOD | dict(sonar=structs(z=[Z, Z - 9.0])),
        TRUTH,
        DATA + "sonar(2).z [-7 -6 -4] has a negative range that noise cannot explain",
    ),
    "nan encoder": (
        GOOD | dict(encoder=structs(u=[U, U * np.nan])),
        TRUTH,
        DATA + "encoder(2).u: ds is nan, not finite; every row needs this value",
    ),
    "encoder in degrees": (
        GOOD | dict(encoder=structs(u=[U, U * [1, 60]])),
        TRUTH,
        DATA + "encoder(2).u: dth is 12, more than a full turn; angles are in radians: convert degrees",
    ),
    "encoder size": (GOOD | dict(encoder=structs(u=[U, Z])), TRUTH, DATA + "encoder(2).u must be 2 finite numbers [ds"),
    "encoder text": (GOOD | dict(encoder=structs(u=["go", U])), TRUTH, DATA + "encoder(1).u is not an array"),
    "empty": (GOOD | dict(encoder=structs(u=[U, U])[:, :0]), TRUTH, DATA + "the struct array encoder is empty"),
    "lengths": (
        GOOD | dict(sonar=structs(z=[Z])),
        TRUTH,
        DATA + "sonar has 1 elements, encoder has 2; both need the same number",
    ),
    "two beacons": (GOOD | dict(beacons=MARKS[:2]), TRUTH, DATA + "beacons must be 3 or more rows x y; it is (2, 2)"),
    "beacons by column": (GOOD | dict(beacons=MARKS.T), TRUTH, DATA + "beacons must be 3 or more rows x y; it is (2,"),
    "nan beacon": (GOOD | dict(beacons=MARKS * np.nan), TRUTH, DATA + "beacons holds nan; all its numbers must"),
    "bound of two": (GOOD | dict(minx=[1.0, 2.0]), TRUTH, DATA + "minx must be one number"),
    "bounds crossed": (GOOD | dict(minx=30.0), TRUTH, DATA + "minx 30 must be below maxx 20"),
    "infinite truth": (GOOD, dict(robot=structs(x=[X, X * np.inf])), STATES + "robot(2).x: x is inf, not finite"),
    "truth of two": (GOOD, dict(robot=structs(x=[X, X[:2]])), STATES + "robot(2).x must be 3 finite numbers [x y head"),
    "times": (
        GOOD,
        dict(robot=structs(x=[X, X], t=[0.2, 0.1])),
        STATES + "element 2: time 0.100 goes back; 1 of 2 rows have such times and would be left out; sort by time",
    ),
    "time of two": (GOOD, dict(robot=structs(x=[X, X], t=[[1.0, 2.0], 0.1])), STATES + "element 1 field t must be one"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_a_bad_file_is_named_with_its_element(fault, capsys):
    data, truth, message = FAULTS[fault]
    save("problem4data.mat", **data)
    save("problem4truth.mat", **truth)
    assert run("sonar", "hydra.run.dir=out") == 2
    text = capsys.readouterr().err
    assert message in text
    assert text.count("\n") == 1
    assert json.loads(Path("out/status.json").read_text())["status"] == "failed"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("scenario.bounds=[5,-5,0,1]", "scenario.bounds must be minx < maxx, miny < maxy, got [5.0, -5.0, 0.0, 1.0]"),
        ("scenario.margin=13", "scenario.margin must be >= 0 and below half of the map's width 25, got 13"),
        ("scenario.beacons=[[0,0],[1,1]]", "scenario.beacons must be 3 or more, one [x, y] each, got 2"),
        ("scenario.beacons=[[0,0],[1,1],[2]]", "scenario.beacons[2] must be two numbers [x, y], got 1"),
        ("scenario.measurement_sd=[1,1]", "scenario.measurement_sd must have 3 numbers, got 2"),
        ("scenario.process_sd=[0,1]", "scenario.process_sd[0] must be > 0"),
        ("scenario.found_radius=0", "scenario.found_radius must be > 0"),
        ("scenario.duration=0.01", "scenario.duration must be from one to ten million steps of dt = 0.1 s, got 0.01"),
    ],
)
def test_a_number_out_of_range_is_one_line(override, message, capsys):
    assert main(["run", "scenario=sonar", override]) == 2
    text = capsys.readouterr().err
    assert message in text
    assert text.count("\n") == 1
