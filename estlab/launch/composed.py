"""The configuration that Hydra composed for a run or a job, as plain data and as objects."""

from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, cast

from estlab.errors import UserError
from estlab.launch import given_keys

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from estlab.config.settings import Names
    from estlab.launch.execute import Request


def request_of(config: "DictConfig", command: list[str]) -> "Request":
    """The composed configuration as objects, and the user's names for its parts."""
    from omegaconf import OmegaConf

    from estlab.launch.execute import Request

    plain, names = described(config)
    return Request(plain, names, OmegaConf.to_yaml(config, resolve=True), OmegaConf.to_yaml(typed()), command)


def folder() -> Path:
    """The directory of the run that is composed now."""
    from hydra.core.hydra_config import HydraConfig

    return Path(raw(HydraConfig.get().runtime)["output_dir"])


def described(config: "DictConfig") -> "tuple[dict[str, Any], Names]":
    """The composed configuration as plain data, and the user's names for its parts."""
    from hydra.core.hydra_config import HydraConfig
    from omegaconf import OmegaConf

    from estlab.config.settings import Names, changes

    hydra = HydraConfig.get()
    plain = cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
    data = plain.get("data")
    if hydra.job.chdir and isinstance(data, dict) and data.get("path"):
        data["path"] = str(Path(raw(hydra.runtime)["cwd"]) / str(data["path"]))
    words = typed()
    chosen = [word for word in words if word.startswith("filter=")]
    filters = plain.get("filters")
    if not isinstance(filters, Mapping):
        filters = {}  # an unknown choice is reported where it is built
    if filters and chosen and not any("filter@filters" in word for word in words):
        theirs = ",".join(filters)
        raise UserError(
            f"{chosen[0]} would not be used, because the experiment has its own filters, {theirs}; leave it out"
        )
    given_keys.refuse_single_filter(words, filters)
    folders = [Path(source.path) for source in hydra.runtime.config_sources if source.schema == "file"]
    stated = given_keys.experiment_file(str(hydra.runtime.choices.get("experiment")), folders)
    choices = (PurePath(hydra.runtime.choices[group]) for group in ("scenario", "filter"))
    # However you write it, car, ./car and car.yaml are one problem with one set of random numbers.
    scenario, filter = (str(choice.with_suffix("")) if choice.suffix == ".yaml" else str(choice) for choice in choices)
    names = Names(scenario, filter, changes(words), given_keys.other_data(words) and bool(stated.get("expect")))
    if stated or any(word.lstrip("+").startswith(("scenario.", "data.clock")) for word in words):
        given_keys.refuse_unread(_unread(plain, names), words, stated)
    return plain, names


def _unread(plain: "dict[str, Any]", names: "Names") -> dict[str, str]:
    """The keys that this configuration does not read, with what would; none if it does not build (said elsewhere)."""
    from estlab.config.build import build

    try:
        settings = build(plain, names)
    except UserError:
        return {}
    scenario, source = settings.scenario, settings.data.source
    unread = {f"scenario.{key}": reader for key, reader in scenario.unread(source).items()}
    for key in ("clock_faults", "clock_gap"):
        if source == "simulated" or key not in scenario.clocks:
            unread[f"data.{key}"] = "data=files" if key in scenario.clocks else "other files, that carry times"
    return unread


def typed() -> list[str]:
    """The typed words for the run or job being composed, as Hydra received them."""
    from hydra.core.hydra_config import HydraConfig

    return [str(word) for word in raw(HydraConfig.get().overrides)["task"]]


def raw(node: Any) -> dict[str, Any]:
    """A node of the composed configuration with ${...} unresolved: in the name of a folder it is no interpolation."""
    from omegaconf import OmegaConf

    return cast(dict[str, Any], OmegaConf.to_container(node, resolve=False))
