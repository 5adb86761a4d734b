"""What all tests share: the shipped configuration as objects, the real data where it is, quiet randomness."""

from pathlib import Path

import hypothesis
import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from estlab.config import Settings, build
from estlab.filters.loop import Loop
from estlab.maths.streams import Streams
from estlab.paths import conf_folder
from estlab.record import Estimates

ROOT = Path(__file__).parent.parent
SHARED = ROOT.parent / "shared" / "data"

hypothesis.settings.register_profile("estlab", derandomize=True, deadline=None, max_examples=60)
hypothesis.settings.load_profile("estlab")


def composed(*overrides: str) -> dict:
    """The configuration that these overrides compose, as plain data."""
    with initialize_config_dir(str(conf_folder()), version_base="1.3"):
        return OmegaConf.to_container(compose("config", overrides=list(overrides)), resolve=True)


def settings(*overrides: str) -> Settings:
    """The same as objects."""
    return build(composed(*overrides))


def options(group: str) -> list[str]:
    """The names in a configuration group."""
    return sorted(path.stem for path in (conf_folder() / group).glob("*.yaml"))


@pytest.fixture
def shared() -> Path:
    """The folder of real recordings."""
    if not SHARED.is_dir():
        pytest.skip("the real recordings are not beside this checkout (../shared/data)")
    return SHARED


def estimate(filter, motion, sensor, record, scheme="sequential", pause=0.0, numbers=None) -> Estimates:
    """A filter over a record, its streams keyed by the runs' numbers, from 0 unless given; one for a shared belief."""
    numbers = (numbers or range(record.runs)) if record.each_its_own else range(1)
    draws = Streams(1, "test").draws("filter", numbers)
    return Loop(filter, motion, sensor, scheme, pause).estimate(record, draws)
