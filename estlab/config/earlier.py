"""Configurations written by an earlier estlab: keys that did not exist yet take their default values."""

from collections.abc import Mapping
from typing import Any

import yaml

from estlab.config import angles
from estlab.config.locations import conf_folder

_OF_HYDRA = ("defaults", "hydra")


def completed(config: Mapping[str, Any], scenario: str, filter: str) -> tuple[dict[str, Any], list[str]]:
    """A configuration completed with the keys that it lacks, and their names.

    scenario, filter: their names in conf/. A part of a problem or filter that differs from the shipped one of that
    name is left as it is.
    """
    added: list[str] = []
    shipped = _shipped("config")
    found = _filled(config, shipped, "", added)
    found["sweep"] = _filled(found.get("sweep"), shipped["sweep"], "sweep.", added)
    for group, option in (("scenario", scenario), ("filter", filter), ("data", "simulated")):
        # Simulated data have every key of data, with values that change nothing.
        found[group] = _filled(found.get(group), _shipped(f"{group}/{option}"), f"{group}.", added)
    if isinstance(several := found.get("filters"), Mapping):
        found["filters"] = {
            name: _filled(node, _shipped(f"filter/{name}"), f"filters.{name}.", added) for name, node in several.items()
        }
    return found, added


def _filled(node: Any, shipped: Mapping[str, Any], path: str, added: list[str]) -> Any:
    if not isinstance(node, Mapping) or node.get("_target_") != shipped.get("_target_"):
        return node
    filled = dict(node)
    for key, value in shipped.items():
        if key not in node and not _is_composed(value):
            filled[key] = value
            added.append(f"{path}{key}")
    return filled


def _is_composed(value: Any) -> bool:
    """Whether a value has no meaning without the rest of the configuration."""
    return isinstance(value, str) and "${" in value


def _shipped(name: str) -> dict[str, Any]:
    """A file of conf/ as plain data, without Hydra's keys; empty if there is none."""
    file = conf_folder() / f"{name}.yaml"
    if not file.is_file():
        return {}
    content = angles.resolved(yaml.safe_load(file.read_text(encoding="utf-8")))
    return {k: v for k, v in content.items() if k not in _OF_HYDRA}
