"""The plugin problems as settings, by the names of their YAML files."""

from pathlib import Path

import yaml

from estlab.config.build import build
from estlab.config.settings import Names, Settings
from tests.conftest import composed

FOLDER = Path(__file__).parent
NAMES = sorted(path.stem for path in (FOLDER / "conf/scenario").glob("*.yaml"))


def settings(name: str, *overrides: str) -> Settings:
    """The configuration that these overrides compose, with a problem of the plugins'."""
    config = composed(*overrides)
    config["scenario"] = yaml.safe_load((FOLDER / f"conf/scenario/{name}.yaml").read_text())
    config["plugins"] = ["tests"]
    if name == "log":
        config["data"] = {**config["data"], "source": "files", "path": str(FOLDER / "data")}
    filter = next((word.partition("=")[2] for word in overrides if word.startswith("filter=")), "ukf")
    return build(config, Names(name, filter))
