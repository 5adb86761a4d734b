"""No key of a scenario is ever ignored: it changes something, or it is refused in one line that names it."""

from copy import deepcopy
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from estlab.cli.main import main
from estlab.config.build import build
from estlab.config.settings import Names
from estlab.errors import UserError
from estlab.experiment.monte_carlo import record_of
from estlab.launch import given_keys
from estlab.maths.gaussian_belief import Gaussian
from estlab.scenarios.scenario import History
from tests.conftest import ROOT, composed, options, settings

# A scenario, and further choices on which it depends what is read.
CASES = [
    ("car",), ("car", "scenario.initial=drawn"), ("car", "scenario.truth=model"),
    ("sonar",), ("field",), ("field", "scenario.prior=uniform"),
    ("landmark",), ("landmark", "scenario.update=interleaved"), ("landmark", "scenario.drive=commands"),
    ("epuck",), ("epuck", "scenario.truth=model"),
    ("radar",), ("radar", "scenario.case=ii"), ("generator",),
]  # fmt: skip

# What changes something where a tenth more would not.
VALUES = {
    "least_sd": 5.0, "smallest": 4.0, "unknown_barcodes": 0.0, "truth_gap": 10.0, "reading_every": 7, "dropped": 0.9,
    "max_range": 1.5, "samples": 20,
    "sightings": [[0.0, 0.0, 0.0, 1.0, 1.0]], "bounds": [-5.0, 20.0, -5.0, 21.0],
    "cov": [[4.0, 1.0, -0.6], [1.0, 1.0, 0.3], [-0.6, 0.3, 2.0]],
    "duration": 2.0, "case": {"i": "ii", "ii": "i"}, "initial": {"document": "drawn", "drawn": None, "truth": "drawn"},
    "truth": {"manoeuvre": "model", "drive": "model", "model": None}, "prior": {"known": "uniform", "uniform": "known"},
    "drive": {"tour": "commands", "commands": "tour"}, "initial_covariance": {"diagonal": "document"},
    "update": {"sequential": "stacked", "stacked": "sequential", "interleaved": "stacked"},
}  # fmt: skip


def another(key, value):
    """A value other than this one."""
    chosen = VALUES.get(key, value)
    if isinstance(chosen, dict) and isinstance(value, str):
        return chosen[value] or {"drawn": "truth" if "truth" in chosen else "document"}.get(value, "manoeuvre")
    if chosen is not value:
        return chosen
    if isinstance(value, list):
        return [another("", value[0]), *value[1:]]
    return 0.87 * value + 0.02


@cache
def recordings(scenario: str) -> str:
    """The folder of the small recording in the repository."""
    return str(ROOT / "data" / scenario)


@pytest.fixture
def stray(tmp_path) -> str:
    """The landmark recording, with a barcode that no subject has and a gap in the truth."""
    for file in (ROOT / "data" / "landmark").iterdir():
        text = file.read_text()
        lines = text.splitlines(keepends=True)
        head = sum(line.startswith("#") for line in lines)
        if file.name == "Measurement.dat":
            lines.insert(head, f"{lines[head].split()[0]} 98 2.0 0.1\n")
        if file.name == "Groundtruth.dat":
            del lines[head + 8 : head + 14]
        (tmp_path / file.name).write_text("".join(lines))
    return str(tmp_path)


def made_of(plain, scenario):
    """All that a run of this configuration is made of, in one comparable piece; the message if it is refused."""
    try:
        made = build(plain, Names(scenario, "pf"))
        record = record_of(made, range(2))
        problem, noise = made.scenario, made.noise.filter
        motion, sensor = problem.motion(noise), problem.sensor(noise, record.landmarks)
    except UserError as error:
        return f"refused: {error}"
    readings, prior = record.readings, record.prior
    first = History(
        record.time, record.truth[..., 0], record.truth[..., 0], np.zeros((9, 9, record.time.size)), readings.step,
        readings.values[..., 0], readings.landmark_number[..., 0], record.landmarks, record.extra | record.sums,
    )  # fmt: skip
    table = problem.table({"pf": first}) if scenario in ("landmark", "field") else {}
    belief = (prior.mean, prior.cov) if isinstance(prior, Gaussian) else (prior.low, prior.high)
    lapse = record.time[0] - record.start
    numbers = [
        record.start, record.time, record.truth, record.control, record.landmarks, readings.step, readings.values,
        readings.landmark_number, *belief, *record.extra.values(), *record.sums.values(), sensor.noise_cov,
        *(motion.noise_cov(control, lapse) for control in record.control[..., 0].T),
    ]  # fmt: skip
    shapes = [(np.shape(array), np.asarray(array).tobytes()) for array in numbers]
    scheme, pause = problem.scheme
    limits = (scheme, pause if scheme == "interleaved" else 0.0, problem.found_within, problem.lost_beyond)
    return (shapes, limits, repr(made.filter), repr(table), record.remarks)


@pytest.mark.slow
@pytest.mark.parametrize("source", ["simulated", "files"])
@pytest.mark.parametrize("case", CASES, ids=" ".join)
def test_every_key_changes_something_or_is_refused(case, source, stray):
    scenario, *choices = case
    if source == "files" and scenario in ("radar", "generator"):
        pytest.skip("reads no files")
    folder = stray if scenario == "landmark" else recordings(scenario)
    data = ["data=files", f"data.path={folder}"] if source == "files" else []
    plain = composed(f"scenario={scenario}", *choices, "filter=pf", "runs=2", "steps=25", *data)
    if "samples" in plain["scenario"]:
        plain["scenario"]["samples"] = 10
    before = made_of(plain, scenario)
    unread = build(plain).scenario.unread(source)
    for key, value in [(key, value) for key, value in plain["scenario"].items() if key != "_target_"]:
        names = [f"{key}.{name}" for name in value] if isinstance(value, dict) else [key]
        for name in names:
            changed = deepcopy(plain)
            if key == "particles":  # the filter's by interpolation
                changed = composed(f"scenario={scenario}", *choices, "filter=pf", "runs=2", "scenario.particles=999")
            elif name == key:
                changed["scenario"][key] = another(key, value)
            else:
                leaf = name.removeprefix(f"{key}.")
                changed["scenario"][key][leaf] = another(leaf, value[leaf])
            after = made_of(changed, scenario)
            if name in unread:
                assert after == before or isinstance(after, str), f"{name} is read"
                with pytest.raises(UserError, match=rf"scenario\.{name}=\S+ would not be read: it belongs to "):
                    given_keys.refuse_unread({f"scenario.{name}": unread[name]}, [f"scenario.{name}=7"], {})
            else:
                assert after != before, f"scenario.{name} changes nothing"


REFUSED = [
    (
        ["scenario=landmark", "data=files", "scenario.speed=2"],
        "scenario.speed=2 would not be read: it belongs to data=simul",
    ),
    (["scenario=landmark", "data=files", "scenario.dropped=0.2"], "dropped=0.5 drops half of the readings"),
    (["scenario=car", "data=files", "scenario.duration=20"], "steps=N takes the first N steps"),
    (
        ["+experiment=car_matched", "data=files"],
        "scenario.truth=model of the experiment would not be read: it belongs to",
    ),
    (["+experiment=landmark_commands", "data=files"], "scenario.drive=commands of the experiment would not be read"),
    (
        ["scenario=field", "scenario.box_low=[1,1]"],
        "would not be read: it belongs to scenario.prior=uniform; leave it out",
    ),
    (
        ["scenario=radar", "scenario.bearing_sd.ii=1"],
        "bearing_sd.ii=1 would not be read: it belongs to scenario.case=ii",
    ),
    (["+experiment=field_errors", "filter.gate=0.9"], "there are several filters; write filters.<ekf|pf>.gate"),
    (["filter=[pf,ekf]", "filter.particles=9"], "there are several filters; write filters.<pf|ekf>.particles"),
    (
        ["data.clock_gap=9"],
        "data.clock_gap=9 would not be read: it belongs to other files, that carry times; leave it out",
    ),
    (
        ["scenario=landmark", "data.clock_faults=0.1"],
        "data.clock_faults=0.1 would not be read: it belongs to data=files",
    ),
    (["data.prefix=x"], "data.prefix=x would not be read: add data=files"),
    (["scenario=radar", "filter=ekf", "dropped=0.5"], "dropped=0.5: radar has no readings to drop; leave it out"),
    (["dropped=1.5"], "dropped must be a share from 0 to 1, got 1.5"),
]


@pytest.mark.parametrize(("words", "message"), REFUSED, ids=lambda value: value if isinstance(value, str) else "")
def test_a_key_that_would_not_be_read_is_refused_in_one_line(words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = [f"data.path={ROOT / 'data' / 'landmark'}"] if "data=files" in words else []
    assert main(["run", *words, *path, "plots=false"]) == 2
    text = capsys.readouterr().err
    assert message in text
    assert text.count("\n") == 1


def test_a_sweep_of_a_key_that_would_not_be_read_begins_no_job(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["scenario=landmark", "data=files", f"data.path={recordings('landmark')}", "scenario.dropped=0,0.5"]
    assert main(["sweep", *words]) == 2
    assert "scenario.dropped=0 would not be read" in capsys.readouterr().err
    assert not list(Path("runs").rglob("status.json"))


def test_a_users_own_scenario_file_has_defaults_of_its_own(capsys, tmp_path, monkeypatch):
    """Its keys are nobody's wish for this run, and the same file serves simulation and recording."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "mine" / "scenario"
    folder.mkdir(parents=True)
    shipped = (ROOT / "conf" / "scenario" / "landmark.yaml").read_text()
    (folder / "hall.yaml").write_text(shipped.replace("speed: 0.4", "speed: 0.7"))
    words = ["scenario=hall", "filter=ekf", "data=files", f"data.path={recordings('landmark')}", "steps=5"]
    assert main(["run", "--config-dir", "mine", *words, "plots=false", "report=false"]) == 0
    assert main(["run", "--config-dir", "mine", *words, "scenario.speed=0.7"]) == 2


@pytest.mark.slow
@pytest.mark.parametrize("scenario", [name for name in options("scenario") if name not in ("radar", "generator")])
def test_readings_of_any_data_are_dropped_by_one_key(scenario):
    data = ["data=files", f"data.path={recordings(scenario)}"]
    for source in ([], data):
        words = [f"scenario={scenario}", "filter=ekf", "steps=40", *source]
        whole, half, none = (record_of(settings(*words, f"dropped={share}"), range(4)) for share in (0.0, 0.5, 1.0))
        had, kept, left = (np.isfinite(r.readings.values).any(axis=0) for r in (whole, half, none))
        assert not left.any()
        assert 0.3 * had.sum() < kept.sum() < 0.7 * had.sum()
        assert not (kept & ~had).any()
        assert (kept == kept[:, :1]).all() == bool(source), "repeats of a recording lose the same, other runs do not"
        alone = record_of(settings(*words, "dropped=0.5"), range(3, 4))
        mine = half.readings.values[:, :, 3]
        np.testing.assert_array_equal(
            mine[np.isfinite(mine)], alone.readings.values[np.isfinite(alone.readings.values)],
            err_msg="a run alone loses what it loses among others",
        )  # fmt: skip
