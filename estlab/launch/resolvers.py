"""The functions that ``${...}`` may call in configuration, in addition to those of OmegaConf and Hydra."""

from omegaconf import OmegaConf

from estlab.config import angles


def register() -> None:
    """Make ``${deg:40}`` an angle in this process."""
    OmegaConf.register_new_resolver("deg", angles.radians, replace=True)
