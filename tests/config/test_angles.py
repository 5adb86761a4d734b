"""Angles in configuration in degrees, as people write them."""

import math
import pickle
import subprocess
import sys
from pathlib import Path

import hypothesis.strategies as st
import pytest
import yaml
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import given

from estlab.cli.main import main
from estlab.config import angles, earlier
from estlab.launch.quoting import angle_as_typed
from estlab.launch.shipped import shipped_filter
from tests.cli.sweeping import rows
from tests.conftest import composed, options

TINY = ["scenario=field", "filter=ekf", "runs=2", "steps=3", "plots=false"]
# What conf/ said in radians before it said degrees: figures hang on the last bit.
SHIPPED = {
    "car": {
        "process_sd": [0.25, 0.25, 3.0, 0.6981317007977318, 0.1, 0.1],
        "measurement_sd": [0.03490658503988659, 0.03490658503988659, 0.1],
        "initial_mean": [90.0, 4.25, 13.0, 3.141592653589793, 5.0, 2.0],
        "initial_sd": [2.0, 5.0, 1.0, 0.7853981633974483, 4.0, 2.0],
    },
    "radar": {"bearing": -0.05235987755982989, "bearing_sd": {"i": 0.017453292519943295, "ii": 0.2617993877991494}},
    "sonar": {"process_sd": [0.1, 0.08726646259971647]},
    "field": {"bearing_sd": 0.3490658503988659},
}


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_angles_are_the_same_numbers_to_the_last_bit(name):
    found = composed(f"scenario={name}")["scenario"]
    assert {key: found[key] for key in SHIPPED[name]} == SHIPPED[name]


@given(st.floats(-1e6, 1e6))
def test_degrees_are_what_math_says_in_a_file_and_on_a_line(degrees):
    written = f"${{deg:{degrees!r}}}"
    assert angles.is_angle(written)
    assert angles.resolved({"a": [written, 1, "b"]}) == {"a": [math.radians(degrees), 1, "b"]}
    assert angles.radians(degrees) == math.radians(degrees)


@pytest.mark.parametrize(
    "text", ["40", "${deg:x}", "${deg:${oc.env:HOME}}", "a${deg:1}", "${oc.env:HOME}", "${deg:1}${x}"]
)
def test_nothing_else_is_an_angle(text):
    assert not angles.is_angle(text)
    assert angles.resolved(text) == text


def test_a_value_that_hydra_took_from_several_is_written_as_it_was_typed():
    override = OverridesParser.create().parse_override("x=${deg:5},'${deg:-20}',0.2,'a:b'")
    written = [angle_as_typed(str(value)) for value in override.sweep_string_iterator()]
    assert written == ["${deg:5}", "'${deg:-20}'", "0.2", "'a:b'"]


def test_an_angle_is_typed_on_the_command_line():
    words = ["scenario=field", "scenario.bearing_sd=${deg:12.5}", "scenario.start=[1,2,${deg:90}]"]
    scenario = composed(*words)["scenario"]
    assert (scenario["bearing_sd"], scenario["start"][2]) == (math.radians(12.5), math.radians(90))


@pytest.mark.parametrize("written", ["abc", "", "1,2", "true", "[1]"])
def test_what_is_no_number_is_one_line_with_its_key(written, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["run", *TINY, f"scenario.bearing_sd=${{deg:{written}}}"]) == 2
    line = capsys.readouterr().err
    assert line.startswith("estlab: scenario.bearing_sd: ${deg:")
    assert line.endswith("} must be a number of degrees, such as ${deg:40}\n")
    assert line.count("\n") == 1
    assert not list(Path("runs").glob("*/*")), "nothing is begun"


def test_a_users_own_files_have_angles_and_so_has_what_is_run_again(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("conf/experiment").mkdir(parents=True)
    Path("conf/experiment/mine.yaml").write_text(
        "# @package _global_\ndefaults:\n  - override /scenario: field\n  - override /filter: ekf\n"
        'scenario:\n  bearing_sd: ${deg:25}\n  start: [180.0, 50.0, "${deg:3}"]\n'
    )
    words = ["runs=2", "steps=3", "plots=false", "report=false", "hydra.run.dir=first"]
    assert main(["run", "--config-dir", "conf", "+experiment=mine", *words]) == 0
    scenario = yaml.safe_load(Path("first/config.yaml").read_text())["scenario"]
    assert (scenario["bearing_sd"], scenario["start"][2]) == (math.radians(25), math.radians(3))
    assert main(["rerun", "first"]) == 0
    assert "identical to the last bit" in capsys.readouterr().out


def test_a_sweep_over_angles_has_numbers_in_its_table_and_is_resumed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", *TINY, "scenario.bearing_sd=choice(${deg:5},'${deg:20}')", "sweep.dir=swept"]) == 0
    found = [float(row["scenario.bearing_sd"]) for row in rows("swept/sweep.csv")]
    assert found == [math.radians(5), math.radians(20)]
    for number, value in enumerate(found):
        config = yaml.safe_load(Path(f"swept/{number}_field_ekf/config.yaml").read_text())
        assert config["scenario"]["bearing_sd"] == value
    assert "- scenario.bearing_sd=${deg:5}\n" in Path("swept/0_field_ekf/overrides.yaml").read_text()
    Path("swept/1_field_ekf/metrics.csv").unlink()
    assert main(["sweep", "--resume", "swept"]) == 0, "an angle names nothing, so it need not be typed again"
    assert [float(row["scenario.bearing_sd"]) for row in rows("swept/sweep.csv")] == found


def test_a_worker_that_unpickles_hydras_loader_knows_angles():
    """What any launcher does in a process of its own: nothing of estlab but the loader's module is imported there."""
    from estlab.launch.composition import CheckedLoader

    code = (
        f"import pickle; pickle.loads({pickle.dumps(CheckedLoader)!r}); from omegaconf import OmegaConf; "
        "print(OmegaConf.create({'a': '${deg:180}'}).a)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout) == math.pi


def test_a_run_of_before_takes_the_shipped_angle_of_a_key_that_it_lacks():
    config = composed("scenario=field", "filter=ekf")
    del config["scenario"]["bearing_sd"]
    found, added = earlier.completed(config, "field", "ekf")
    assert added == ["scenario.bearing_sd"]
    assert found["scenario"]["bearing_sd"] == math.radians(20)


@pytest.mark.parametrize("name", options("filter"))
def test_the_settings_of_a_filter_are_plain_data(name):
    assert "${deg" not in str(shipped_filter(name))
