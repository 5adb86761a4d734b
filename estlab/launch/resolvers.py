"""The functions that ``${...}`` may call in configuration, in addition to those of OmegaConf and Hydra."""

from collections.abc import Iterator
from contextlib import contextmanager

from omegaconf import OmegaConf
from omegaconf.basecontainer import BaseContainer

from estlab.config import angles


def register() -> None:
    """Make ``${deg:40}`` an angle in this process."""
    OmegaConf.register_new_resolver("deg", angles.radians, replace=True)


@contextmanager
def registered() -> Iterator[None]:
    """The same for the body alone: whatever resolvers there are come back as they were."""
    before = dict(BaseContainer._resolvers)
    register()
    try:
        yield
    finally:
        BaseContainer._resolvers.clear()
        BaseContainer._resolvers.update(before)
