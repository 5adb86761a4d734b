"""The car's and the sonar's files as people have them, and archives that declare more than they hold."""

import json
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from estlab.cli.main import main
from tests.cli.test_files import archived, run, save, simulate, structs
from tests.cli.test_recordings import assert_same, estimates

pytestmark = pytest.mark.slow

TRUTH = {"car": ("problem3truth.mat", "car", 6), "sonar": ("problem4truth.mat", "robot", 3)}
DATA = {"car": "problem3data.mat", "sonar": "problem4data.mat"}


def loaded(name: str) -> dict:
    from scipy.io import loadmat

    return {key: value for key, value in loadmat(f"made/{name}").items() if not key.startswith("__")}


def go(scenario: str, folder: str, *more: str) -> int:
    pf = ["filter=pf", "filter.particles=50"] if scenario == "sonar" else []
    return run(scenario, *pf, f"hydra.run.dir={folder}", *more)


def states(scenario: str) -> tuple[np.ndarray, np.ndarray]:
    """The true states (n, N) and their times, as simulated."""
    name, variable, _ = TRUTH[scenario]
    robot = loaded(name)[variable].ravel()
    return np.stack([e["x"].ravel() for e in robot], axis=1), np.array([e["t"].item() for e in robot])


@pytest.mark.parametrize("scenario", TRUTH)
def test_without_truth_a_run_is_unscored_and_the_same(scenario, capsys):
    made = simulate(scenario)
    assert go(scenario, "out") == 0
    (made / TRUTH[scenario][0]).unlink()
    capsys.readouterr()
    assert go(scenario, "bare", "plots=true") == 0
    assert f"nothing is scored: no {TRUTH[scenario][0]} in made" in " ".join(capsys.readouterr().out.split())
    assert_same("out", "bare")
    assert np.isnan(estimates("bare")["truth"]).all()
    assert go(scenario, "file", f"data.path=made/{DATA[scenario]}") == 0, "one file is all there is"
    assert_same("out", "file")


@pytest.mark.parametrize("scenario", TRUTH)
@pytest.mark.parametrize("kind", ["columns", "rows", "one struct", "no times", "empty times"])
def test_truth_has_many_shapes(scenario, kind):
    simulate(scenario)
    assert go(scenario, "out") == 0
    name, variable, _ = TRUTH[scenario]
    x, t = states(scenario)
    frames = list(x.T[:, :, None])
    made = {
        "columns": dict(truth=x, t=t),
        "rows": dict(truth=x.T, t=t),
        "one struct": {variable: structs(x=[x])},
        "no times": {variable: structs(x=frames)},
        "empty times": {variable: structs(x=frames, t=[np.empty((0, 0))] * len(frames))},
    }
    save(name, **made[kind])
    assert go(scenario, "other") == 0
    assert_same("out", "other")
    np.testing.assert_array_equal(estimates("out")["truth"], estimates("other")["truth"])


@pytest.mark.parametrize("scenario", TRUTH)
@pytest.mark.parametrize("timed", [True, False])
def test_truth_may_have_more_states_than_there_are_frames_or_fewer(scenario, timed, capsys):
    simulate(scenario)
    assert go(scenario, "out") == 0
    name, variable, _ = TRUTH[scenario]
    x, t = states(scenario)
    more, later = np.concatenate([x, x[:, -1:] + np.zeros(9)], axis=1), t[-1] + 0.1 * np.arange(1, 10)
    times = np.append(t, later)
    for count, known in ((t.size + 9, 60), (40, 40)):
        fields = dict(x=list(more.T[:count, :, None])) | (dict(t=list(times[:count])) if timed else {})
        save(name, **{variable: structs(**fields)})
        capsys.readouterr()
        assert go(scenario, f"other{count}") == 0
        by = "time" if timed else "number"
        said = f"{count} states for the {t.size} frames of {DATA[scenario]}, matched by {by}; truth is unknown in "
        assert said + str(max(0, t.size - count)) in " ".join(capsys.readouterr().out.split())
        one, other = estimates("out"), estimates(f"other{count}")
        np.testing.assert_array_equal(one["mean"], other["mean"])
        np.testing.assert_array_equal(one["truth"][:, :known], other["truth"][:, :known])
        assert np.isnan(other["truth"][:, known:]).all()


def test_truth_between_its_times_is_interpolated_and_never_over_a_gap():
    simulate("sonar")
    x, t = states("sonar")
    x[2] = np.unwrap(x[2])
    between = 0.5 * (x[:, 1:] + x[:, :-1])
    keep = np.arange(between.shape[1]) != 20
    save("problem4truth.mat", robot=structs(x=list(between.T[keep]), t=list((0.5 * (t[1:] + t[:-1]))[keep])))
    assert go("sonar", "out") == 0
    truth = estimates("out")["truth"][:, :, 0]
    assert np.flatnonzero(np.isnan(truth[0])).tolist() == [0, 20, 21]
    np.testing.assert_allclose(truth[:2, 5], 0.5 * (between[:2, 4] + between[:2, 5]))


def test_frames_with_intensities_and_nan_points(capsys):
    simulate("car")
    assert go("car", "out") == 0
    lidar = loaded("problem3data.mat")["lidar"]
    for i in range(lidar.size):
        z = lidar[0, i]["z"]
        wide = np.column_stack([z, np.full(len(z), 90.0)])
        lidar[0, i]["z"] = np.insert(wide, 1, [np.nan, 0.1, 5.0], axis=0) if i == 3 else wide
    save("problem3data.mat", lidar=lidar)
    capsys.readouterr()
    assert go("car", "other") == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "columns of lidar(i).z after range and bearing are not read" in out
    assert "made/problem3data.mat: lidar(4).z: nan in 1 of" in out
    assert_same("out", "other")


def test_a_frame_in_which_nothing_was_seen_and_a_sonar_that_heard_nothing_are_counted(capsys):
    simulate("car")
    lidar = loaded("problem3data.mat")["lidar"]
    lidar[0, 10]["z"], lidar[0, 12]["z"] = np.empty((0, 0)), np.full((3, 2), np.nan)
    save("problem3data.mat", lidar=lidar)
    assert go("car", "car") == 0
    assert "lidar(11).z: no point in 2 of 200 frames, this is the first" in " ".join(capsys.readouterr().out.split())
    assert not {10, 12} & set(estimates("car")["step"])
    simulate("sonar", "data.prefix=s_")
    data = loaded("s_problem4data.mat")
    data["sonar"][0, 5]["z"], data["sonar"][0, 7]["z"] = np.empty((0, 0)), np.full((3, 1), np.nan)
    save("s_problem4data.mat", **data)
    assert go("sonar", "sonar", "data.prefix=s_", "plots=true") == 0
    said = "sonar(6).z: no complete sonar reading in 2 of 300 frames, this is the first"
    assert said in " ".join(capsys.readouterr().out.split())
    assert not {5, 7} & set(estimates("sonar")["step"])
    assert np.isfinite(estimates("sonar")["mean"]).all()


@pytest.mark.parametrize("scenario", TRUTH)
def test_frames_whose_times_repeat_or_step_back_are_left_out(scenario, capsys):
    simulate(scenario)
    assert go(scenario, "out", "steps=50") == 0
    data = loaded(DATA[scenario])
    for name in ("lidar", "encoder", "sonar"):
        if name in data:
            frames = data[name].ravel()
            late = frames[55].copy()
            late["t"] = np.array([[0.05]])
            data[name] = np.concatenate([frames[:60], [frames[59]], frames[60:70], [late], frames[70:]])[None]
    save(DATA[scenario], **data)
    assert go(scenario, "other", "steps=50") == 0
    assert_same("out", "other")
    said = "1 left out because a later one has the same time and 1 left out because they step back"
    assert said in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(("seconds", "code"), [(0.5, 0), (-0.5, 0), (3600.0, 2), (-1.3e9, 2)])
def test_a_sonar_with_another_clock_than_the_encoder_is_said_or_refused(seconds, code, capsys):
    simulate("sonar")
    data = loaded("problem4data.mat")
    for heard in data["sonar"].ravel():
        heard["t"] = heard["t"] + seconds
    save("problem4data.mat", **data)
    capsys.readouterr()
    assert go("sonar", "out") == code
    said = capsys.readouterr()
    assert f"sonar(i).t is up to {abs(seconds):.4g} s from encoder(i).t" in " ".join((said.out + said.err).split())
    assert "do their clocks agree?" in " ".join((said.out + said.err).split())


def test_a_second_name_and_any_name_are_taken(capsys):
    made = simulate("car")
    (made / "problem3data.mat").rename(made / "Problem3DataMod.MAT")
    assert go("car", "out") == 0
    (made / "Problem3DataMod.MAT").rename(made / "scan.mat")
    (made / "problem3truth.mat").rename(made / "poses.mat")
    assert go("car", "named", "data.files.data=scan.mat", "data.files.truth=poses.mat") == 0
    assert_same("out", "named")
    files = json.loads(Path("named/run.json").read_text())["data"]
    assert [Path(entry["file"]).name for entry in files] == ["scan.mat", "poses.mat"]


@pytest.mark.parametrize(
    ("field", "at"), [("dth", ("problem4data.mat", "encoder", "u", 1)), ("x", ("problem4truth.mat", "robot", "x", 2))]
)
def test_small_angles_in_degrees_are_found_by_what_the_robot_turned(field, at, capsys):
    simulate("sonar", "scenario.turn_rate=0.3", "noise.truth.process_scale=0.1")
    name, variable, part, row = at
    held = loaded(name)
    for element in held[variable].ravel():
        element[part] = np.asarray(element[part], dtype=float)
        element[part][row] *= 180.0 / np.pi
    save(name, **held)
    if field == "dth":
        assert max(abs(e["u"][1, 0]) for e in held["encoder"].ravel()) < 2.0 * np.pi, "no single turn gives it away"
    assert run("sonar") == 2
    err = capsys.readouterr().err
    assert err.startswith(f"estlab: made/{name}")
    assert "angles are in radians" in err


def test_an_archive_without_its_path_is_unscored_and_lacks_bearings(capsys):
    made = simulate("field") / "evaluation-input.npy"
    assert run("field", "hydra.run.dir=out") == 0
    arrays = {k: v for k, v in archived(made).items() if k in ("num_steps", "noise_free_motion", "real_observations")}
    with open(made, "wb") as stream:
        np.savez_compressed(stream, **arrays)
    made.rename(made.with_suffix(".npz"))
    capsys.readouterr()
    assert run("field", "hydra.run.dir=bare", "plots=true") == 0
    assert "nothing is scored: no real_robot_path" in " ".join(capsys.readouterr().out.split())
    assert_same("out", "bare")
    arrays["real_observations"][7] = np.nan
    np.savez("made/other.npz", **arrays)
    assert run("field", "data.path=made/other.npz", "hydra.run.dir=lost") == 0
    assert "no bearing in 1 of 200 steps" in " ".join(capsys.readouterr().out.split())
    assert 7 not in estimates("lost")["step"]


# Declared sizes.


def element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix(group: int, shape: tuple[int, int], name: bytes, *rest: bytes) -> bytes:
    parts = (element(6, struct.pack("<II", group, 0)), element(5, struct.pack("<2i", *shape)), element(1, name))
    return element(14, b"".join((*parts, *rest)))


def zeros(size: int) -> bytes:
    """A compressed matrix of so many bytes of zeros."""
    head = matrix(6, (1, size // 8), b"lidar", struct.pack("<II", 9, size))
    packer = zlib.compressobj(1)
    packed = packer.compress(head[:4] + struct.pack("<I", len(head) - 8 + size) + head[8:])
    block = bytes(2**20)
    packed += b"".join(packer.compress(block) for _ in range(size // 2**20)) + packer.flush()
    return struct.pack("<II", 15, len(packed)) + packed


BOMBS = {
    "compressed zeros": lambda: zeros(300 * 2**20),
    "cells of nothing": lambda: matrix(1, (30000, 30000), b"lidar"),
    "structs of nothing": lambda: matrix(
        2, (30000, 30000), b"lidar", element(5, struct.pack("<i", 2)), element(1, b"z\0")
    ),
    "letters of nothing": lambda: matrix(4, (30000, 30000), b"lidar", element(16, b"")),
    "compressed cells": lambda: element(15, zlib.compress(matrix(1, (2**30, 1), b"lidar"))),
    "cells nested": lambda: nested(50),
}


def nested(depth: int) -> bytes:
    inner = matrix(6, (0, 0), b"", element(9, b""))
    for _ in range(depth):
        inner = matrix(1, (1, 1), b"", inner)
    return inner


@pytest.mark.parametrize("bomb", BOMBS)
def test_a_matlab_file_that_declares_more_than_it_holds_is_refused(bomb, capsys):
    Path("made").mkdir()
    Path("made/problem3data.mat").write_bytes(
        b"MATLAB 5.0".ljust(124) + struct.pack("<H", 0x0100) + b"IM" + BOMBS[bomb]()
    )
    assert run("car") == 2
    err = capsys.readouterr().err
    assert err.startswith("estlab: made/problem3data.mat: ")
    assert "unpacked, " in err or "declares an array of" in err or "cells nested" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("steps", [200, 10**9])
def test_an_archive_that_declares_gigabytes_is_refused_before_it_is_unpacked(steps, capsys):
    made = simulate("field") / "evaluation-input.npy"
    capsys.readouterr()
    header = np.lib.format.header_data_from_array_1_0(np.empty((1, 3))) | {"shape": (10**9, 3)}
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in (("num_steps", np.array(steps)), ("real_observations", np.zeros((200, 2)))):
            with archive.open(f"{name}.npy", "w") as stream:
                np.lib.format.write_array(stream, array)
        with archive.open("noise_free_motion.npy", "w") as stream:
            np.lib.format.write_array_header_1_0(stream, header)
            stream.write(bytes(2**20))
    assert run("field") == 2
    err = capsys.readouterr().err
    assert ("24 GB" in err) if steps == 10**9 else ("must be 200 x 3 numbers; it is float64 1000000000 x 3" in err)


def test_a_line_without_end_is_no_table(capsys):
    made = simulate("epuck")
    (made / "XYData_cm.csv").write_text("1,2\n" + "1," * 100_000 + "\n")
    capsys.readouterr()
    assert run("epuck") == 2
    assert "made/XYData_cm.csv:2: a line of 200001 bytes" in capsys.readouterr().err


def test_the_same_recording_runs_again_from_one_file(capsys):
    simulate("field")
    assert run("field", "data.path=made/evaluation-input.npy", "hydra.run.dir=out") == 0
    assert main(["rerun", "out"]) == 0
    assert "identical to the last bit" in capsys.readouterr().out
