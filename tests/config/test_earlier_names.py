"""Plugins written for an earlier version keep working, and are told the present names."""

import importlib
import re
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from estlab import earlier_names
from estlab.config.build import build
from estlab.filters.gaussian import GaussianFilter, extended
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.streams import Streams
from estlab.record import Readings, Record
from estlab.scenarios.scenario import Scales
from tests.conftest import composed, estimate
from tests.plugins import bearings

# Of the plugin tests/plugins/bearings.py, what an earlier version called otherwise.
EARLIER = {
    "from estlab.maths.gaussian_belief import": "from estlab.maths.gaussian import",
    "from estlab.scenarios.scenario import": "from estlab.scenarios.contract import",
    "sensor.landmark(landmark_number)": "sensor.place(target)",
    "landmark_number": "target",
    "landmarks=": "places=",
}


def _earlier_ship():
    source = Path(bearings.__file__).read_text()
    for present, earlier in EARLIER.items():
        assert present in source
        source = source.replace(present, earlier)
    module = ModuleType("earlier_bearings")
    sys.modules["earlier_bearings"] = module
    exec(compile(source, "earlier_bearings.py", "exec"), vars(module))
    return module.Ship


def _estimates(ship):
    noise = Scales(1.0, 1.0)
    record = ship(0.05, 0.01, 12).simulate(Streams(3, "ship"), range(2), noise)
    models = ship(0.05, 0.01, 12).motion(noise), ship(0.05, 0.01, 12).sensor(noise, record.landmarks)
    return estimate(extended("augmented", None), *models, record)


def test_a_plugin_of_an_earlier_version_finds_what_it_found():
    with pytest.warns(FutureWarning) as heard:
        found = _estimates(_earlier_ship())
    np.testing.assert_array_equal(found.mean, _estimates(bearings.Ship).mean)
    messages = {str(warning.message) for warning in heard}
    assert "estlab.scenarios.contract is now estlab.scenarios.scenario" in messages
    assert "Record(places=...) is now Record(landmarks=...)" in messages
    assert "Sensor.place is now Sensor.landmark" in messages
    assert {Path(warning.filename).name for warning in heard} == {"earlier_bearings.py"}


@pytest.mark.parametrize("name", earlier_names.MODULES)
def test_a_module_that_moved_hands_out_the_same_objects_under_its_earlier_name(name):
    sys.modules.pop(name, None)
    with pytest.warns(FutureWarning, match=re.escape(f"{name} is now")):
        earlier = importlib.import_module(name)
    present = importlib.import_module(earlier_names.MODULES[name])
    assert all(getattr(earlier, public) is getattr(present, public) for public in vars(present) if public[0] != "_")
    with pytest.raises(AttributeError, match="nowhere"):
        _ = earlier.nowhere


def test_a_filters_contract_has_its_earlier_names():
    with warnings.catch_warnings(action="ignore"):
        contract = importlib.import_module("estlab.filters.contract")
        streams = importlib.import_module("estlab.maths.streams")
    assert contract.Fit.__name__ == "Innovation"
    assert contract.fit_of.__name__ == "innovation_of"
    assert streams.Draws is streams.Generators


def test_a_configuration_may_name_a_module_by_its_earlier_name(monkeypatch):
    monkeypatch.setitem(earlier_names.MODULES, "estlab.filters.formerly", "estlab.filters.gaussian")
    config = composed("filter=ekf")
    config["filter"]["_target_"] = "estlab.filters.formerly.extended"
    with pytest.warns(FutureWarning, match="formerly is now"):
        assert isinstance(build(config).filter, GaussianFilter)


def test_what_replaces_a_field_by_its_earlier_name_is_taken():
    readings = Readings(np.arange(2), np.zeros((1, 2, 1)), np.zeros((2, 1), dtype=int))
    with pytest.warns(FutureWarning, match="target=.* is now"):
        assert replace(readings, target=np.ones((2, 1), dtype=int)).landmark_number.all()
    belief = Gaussian(np.zeros((1, 3)), np.ones((1, 1, 3)))
    with pytest.warns(FutureWarning, match=r"Gaussian\.of is now Gaussian\.take"):
        assert belief.of(np.array([0, 2])).mean.shape == (1, 2)
    record = Record(0.0, np.arange(2.0), np.zeros((1, 2, 1)), np.zeros((0, 2, 1)), readings, belief)
    with pytest.warns(FutureWarning, match=r"Record\.places is now"):
        assert record.places.shape == (0, 1)
