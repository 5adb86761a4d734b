"""What all tests share: the shipped configuration as objects, the real data where it is, quiet randomness."""

import gc
import os
import pickle
from functools import cache
from pathlib import Path

import hypothesis
import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from estlab.config.build import build
from estlab.config.locations import conf_folder
from estlab.config.settings import Names, Settings
from estlab.filters.loop import Loop
from estlab.launch import resolvers
from estlab.maths.streams import Streams
from estlab.metrics.consistency import consistency_tests
from estlab.metrics.scores import Limits
from estlab.metrics.tabulated import MetricRow, metric_rows
from estlab.metrics.tally import Tally
from estlab.metrics.verdict import Tolerance, judge
from estlab.record import Estimates

ROOT = Path(__file__).parent.parent
SHARED = ROOT.parent / "shared" / "data"

# As the command line does: looking for cycles of dead objects takes a tenth of the tests' time.
gc.freeze()
gc.set_threshold(100_000)
resolvers.register()
hypothesis.settings.register_profile("estlab", derandomize=True, deadline=None, max_examples=60)
hypothesis.settings.load_profile("estlab")


def composed(*overrides: str) -> dict:
    """The configuration that these overrides compose, as plain data of the caller's own."""
    return pickle.loads(_composed(*overrides))


@cache
def _composed(*overrides: str) -> bytes:
    with initialize_config_dir(str(conf_folder()), version_base="1.3"):
        return pickle.dumps(OmegaConf.to_container(compose("config", overrides=list(overrides)), resolve=True))


def settings(*overrides: str, names: Names | None = None) -> Settings:
    """The same as objects. names: by default those of the scenario and the filter that are chosen."""
    chosen = {"scenario": "car", "filter": "ukf"} | dict(word.split("=", 1) for word in overrides if "=" in word)
    return build(composed(*overrides), names or Names(chosen["scenario"], chosen["filter"]))


def options(group: str) -> list[str]:
    """The names in a configuration group."""
    return sorted(path.stem for path in (conf_folder() / group).glob("*.yaml"))


@pytest.fixture
def shared() -> Path:
    """The folder of real recordings."""
    if not SHARED.is_dir():
        pytest.skip("the real recordings are not beside this checkout (../shared/data)")
    return SHARED


@pytest.fixture(autouse=True, scope="session")
def compiled_here(tmp_path_factory) -> None:
    """Compiled filter loops are kept for the session, for all of its processes."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    os.environ["ESTLAB_CACHE"] = str(folder / "cache")


def tallied(problem, record, estimates, numbers=None) -> Tally:
    """The tally of one block of a scenario's runs, from number 0 unless told."""
    limits = Limits(getattr(problem, "found_within", None), getattr(problem, "lost_beyond", None))
    tally = Tally(problem.space, record.time, limits, record.repeated)
    tally.add(record, estimates, numbers or range(record.truth.shape[2]))
    return tally


def metrics(tally, bound=None) -> dict[tuple[str, str], MetricRow]:
    """Rows of figures by metric and component."""
    tests = consistency_tests(tally)
    verdict = judge(tally, tests, Tolerance(0.05, 0.01))
    return {(row.metric, row.component): row for row in metric_rows(tally, tests, verdict, bound)}


def estimate(filter, motion, sensor, record, scheme="sequential", pause=0.0, numbers=None) -> Estimates:
    """A filter over a record, its streams keyed by the runs' numbers, from 0 unless given; one for a shared belief."""
    numbers = (numbers or range(record.runs)) if record.each_its_own else range(1)
    generators = Streams(1, "test").generators("filter", numbers)
    return Loop(filter, motion, sensor, scheme, pause).estimate(record, generators)
