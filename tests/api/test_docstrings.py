"""The examples of the docstrings print what they show."""

import doctest
import importlib
import pkgutil

import pytest

import estlab
import estlab.api
from tests.cli.finished import made

pytestmark = pytest.mark.slow

MODULES = [module.name for module in pkgutil.iter_modules(estlab.api.__path__, "estlab.api.")]


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    """The run of the examples, in ``folder``."""
    return str(made(tmp_path_factory.mktemp("example") / "run", "filter=ekf", "runs=3"))


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_print_what_they_show(name, small, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    module = importlib.import_module(name)
    found = doctest.testmod(module, extraglobs={"folder": small}, optionflags=doctest.ELLIPSIS)
    assert found.failed == 0


OF_MODELS = {"Filter", "Gaussian", "Motion", "Sensor", "Space", "Streams", "Uniform", "UserError", "EstlabError"}


@pytest.mark.parametrize("name", sorted({*estlab.__all__} - {*OF_MODELS, "errors", "__version__"}))
def test_every_function_and_class_of_the_door_has_an_example(name):
    assert ">>>" in getattr(estlab, name).__doc__
