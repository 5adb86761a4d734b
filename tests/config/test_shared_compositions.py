"""Jobs that share a composition have the configuration that Hydra composes for each of them."""

import pickle

import pytest
from hydra._internal.utils import create_config_search_path
from hydra.core.utils import setup_globals
from hydra.types import RunMode
from omegaconf import OmegaConf

from estlab.config.locations import conf_folder
from estlab.launch.composition import CheckedLoader

SWEPT = {
    "seeds": (["scenario=field", "filter=ekf"], "seed", [1, 2, 3]),
    "a number among groups": (["scenario=car", "filter=ukf", "noise.filter.process_scale=2"], "filter.alpha", [0.5, 1]),
    "what another key refers to": (["+scenario.twice=${seed}"], "seed", [4, 5]),
    "a number that replaces a reference": (["scenario=field"], "noise.filter.measurement_scale", ["${seed}", 2.5]),
    "angles": (["scenario=field"], "scenario.bearing_sd", ["${deg:2}", 0.5, "${deg:3}"]),
    "truths": (["plots=false"], "smooth", ["true", "false"]),
    "a node and what lies in it": (
        ["noise.filter={process_scale:3,measurement_scale:2}"],
        "noise.filter.process_scale",
        [1, 2],
    ),
    "hydra's own": (["seed=4"], "hydra.job.num", [1, 2]),
    "filters with names": (["+filter@filters.one=ekf", "+filter@filters.two=ukf"], "filters.two.alpha", [0.1, 1e-3]),
    "an experiment": (["+experiment=field_errors"], "runs", [5, 6]),
    "groups": (["seed=3"], "filter", ["ekf", "ukf"]),
}


@pytest.fixture(scope="module")
def loader():
    setup_globals()
    return CheckedLoader(create_config_search_path(str(conf_folder())))


@pytest.fixture(scope="module")
def master(loader):
    return loader.load_configuration("config", [], RunMode.MULTIRUN)


def as_text(config):
    with_hydra = OmegaConf.to_container(config, resolve=False)
    return pickle.loads(pickle.dumps(with_hydra))


@pytest.mark.parametrize("name", SWEPT)
@pytest.mark.parametrize("backwards", [False, True])
def test_a_job_has_the_configuration_that_is_composed_for_it_alone(name, backwards, loader, master):
    words, key, values = SWEPT[name]
    for value in reversed(values) if backwards else values:
        typed = [f"{key}={value}", *words] if backwards else [*words, f"{key}={value}"]
        alone = CheckedLoader(loader.get_search_path())
        expected = super(CheckedLoader, alone).load_sweep_config(master, typed)
        assert as_text(loader.load_sweep_config(master, typed)) == as_text(expected)


def test_seeds_are_composed_once(loader, master, monkeypatch):
    calls = []
    whole = CheckedLoader.load_configuration
    monkeypatch.setattr(CheckedLoader, "load_configuration", lambda *a, **k: (calls.append(a), whole(*a, **k))[1])
    found = [loader.load_sweep_config(master, ["filter=ckf", f"seed={seed}"]) for seed in range(5)]
    assert [config.seed for config in found] == list(range(5))
    assert len(calls) == 1
