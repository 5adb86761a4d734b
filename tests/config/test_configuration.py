"""The configuration is checked strictly, and conf/ holds nothing that does not build."""

import importlib
import inspect
from dataclasses import fields

import pytest

import estlab
from estlab.cli.main import _comment
from estlab.config.build import build, key_paths, nearest
from estlab.config.expectations import parse
from estlab.config.groups import Data, Noise
from estlab.config.locations import conf_folder
from estlab.config.settings import Configuration
from estlab.errors import UserError
from estlab.filters.gaussian import GaussianFilter, extended
from tests.conftest import composed, options, settings


@pytest.mark.parametrize("group", ["scenario", "filter"])
def test_yaml_keys_are_the_parameters_of_their_target_and_these_have_no_defaults(group):
    for option in options(group):
        node = composed(f"{group}={option}")[group]
        module, _, name = node.pop("_target_").rpartition(".")
        parameters = inspect.signature(getattr(importlib.import_module(module), name)).parameters
        assert list(parameters) == list(node), f"{group}/{option}.yaml"
        assert all(p.default is p.empty for p in parameters.values()), f"{group}/{option}.yaml"


def test_top_level_keys_are_the_settings():
    config = composed()
    assert set(config) == {f.name for f in fields(Configuration)}
    assert set(config["data"]) == {f.name for f in fields(Data)}
    assert set(config["noise"]) == {f.name for f in fields(Noise)}


@pytest.mark.parametrize("path", sorted(conf_folder().glob("*/*.yaml")), ids=lambda p: f"{p.parent.name}/{p.stem}")
def test_every_option_says_what_it_is_and_every_experiment_its_question_and_answer(path):
    if path.parent.name == "help":
        pytest.skip("a template")
    lines = _comment(path)
    assert len(lines) == (2 if path.parent.name == "experiment" else 1), path
    assert all(len(line) > 10 for line in lines)
    if path.parent.name == "experiment":
        assert lines[0].count("?") == 1


@pytest.mark.slow
@pytest.mark.parametrize("scenario", options("scenario"))
def test_every_pair_runs(scenario, capsys):
    names = options("filter")
    run = estlab.run("+experiment=smoke", scenario=scenario, filter=names, save=False)
    assert {*run.metrics.query("metric == 'rmse'")["filter"]} == {*names}
    assert (run.missing, capsys.readouterr()) == ({}, ("", ""))


@pytest.mark.slow
@pytest.mark.parametrize("experiment", [e for e in options("experiment") if e != "smoke"])
def test_every_experiment_runs_tiny(experiment):
    run = estlab.run(experiment=experiment, runs=2, steps=8, expect=None, save=False)
    assert (run.status, run.missing) == ("ok", {})


@pytest.mark.parametrize("experiment", [e for e in options("experiment") if e != "smoke"])
def test_every_experiment_says_what_it_finds(experiment):
    stated = settings(f"+experiment={experiment}")
    assert parse(stated.expect, list(stated.filters) or options("filter"))


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("+filter.alhpa=1", "unknown key filter.alhpa; did you mean filter.alpha?"),
        ("+process_scale=2", "unknown key process_scale; did you mean noise.filter.process_scale?"),
        ("+noise.filter.scale=2", "unknown key noise.filter.scale"),
        ("filter.alpha=-1", "filter.alpha must be > 0, got -1"),
        ("filter.alpha=nan", "filter.alpha must be finite, got nan"),
        ("filter.alpha=inf", "filter.alpha must be finite, got inf"),
        ("filter.alpha=wide", "filter.alpha must be a number, got 'wide'"),
        (
            "filter.noise=adaptive",
            "filter.noise must be one of additive, augmented, got adaptive; did you mean additive?",
        ),
        ("runs=0", "runs must be from 1 to 1e9, got 0"),
        ("runs=2.5", "runs must be an integer, got 2.5"),
        ("seed=-3", "seed must be >= 0, got -3"),
        ("plots=7", "plots must be true or false, got 7"),
        ("scenario.dt=0", "scenario.dt must be > 0 and finite, got 0"),
        ("scenario.process_sd=[1,2]", "scenario.process_sd must have 6 numbers, got 2"),
        ("scenario.initial_sd=[2,5,-1,1,4,2]", "scenario.initial_sd[2] must be > 0"),
        ("scenario.process_sd=3", "scenario.process_sd must be a list, got 3"),
        (
            "noise.truth.measurement_scale=-1",
            "noise.truth.measurement_scale must be > 0 and between 1e-50 and 1e50, got -1",
        ),
        ("scenario.truth=modle", "did you mean model?"),
        ("data=files", "data.path is required"),
    ],
)
def test_a_wrong_value_is_named_with_its_key(override, message):
    with pytest.raises(UserError) as caught:
        settings(override)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "target",
    ["os.system", "estlabs.filters.x", "subprocess.Popen", "estlab", "builtins.eval", "tests.nowhere.Thing"],
)
def test_a_target_outside_the_allowed_packages_is_refused_before_import(target, monkeypatch):
    config = composed()
    config["filter"]["_target_"] = target
    monkeypatch.setattr(importlib, "import_module", lambda name: pytest.fail(f"imported {name}"))
    with pytest.raises(UserError, match="is refused: it is not in estlab"):
        build(config)


@pytest.mark.parametrize(
    "target",
    [
        "estlab.rundir.RunDirectory",
        "estlab.cli.main.main",
        "estlab.rundir.provenance.subprocess",
        "estlab.cli.main.nothing",
    ],
)
def test_a_target_of_another_kind_is_not_called(target):
    config = composed()
    config["filter"]["_target_"] = target
    with pytest.raises(UserError, match=r"does not make a Filter|there is no"):
        build(config)


def test_a_listed_plugin_is_allowed():
    config = composed("plugins=[tests]")
    config["filter"] = {"_target_": "tests.config.test_configuration.plugin_filter", "noise": "additive"}
    assert build(config).filter.noise == "additive"


def plugin_filter(noise: str) -> GaussianFilter:
    return extended(noise, None)


def test_whole_floats_pass_for_whole_numbers():
    assert settings("runs=1e3").runs == 1000


def test_the_nearest_name_is_offered_and_nothing_far_off():
    known = key_paths(composed())
    assert nearest("scenario.lidar_rnge_sd", known) == "; did you mean scenario.lidar_range_sd?"
    assert nearest("zzz", known) == ""
