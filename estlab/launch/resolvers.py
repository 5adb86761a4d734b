"""What ``${...}`` may call in configuration, besides what OmegaConf and Hydra bring."""

from omegaconf import OmegaConf

from estlab.config import angles


def register() -> None:
    """From now on ``${deg:40}`` is an angle, in this process."""
    OmegaConf.register_new_resolver("deg", angles.radians, replace=True)
