"""The content of conf/, without composing a whole configuration."""

from typing import Any, cast

from estlab.config.build import nearest
from estlab.config.locations import conf_folder, options
from estlab.errors import UserError


def shipped_filter(name: str) -> dict[str, Any]:
    """The settings of a filter as plain data, with their defaults for no particular scenario.

    Raises UserError for a name that is not shipped.
    """
    from omegaconf import OmegaConf

    from estlab.launch import resolvers

    known = options("filter")
    if name not in known:
        raise UserError(f"there is no filter {name}{nearest(name, list(known))} (one of {', '.join(known)})")
    config = OmegaConf.create({"filter": OmegaConf.load(conf_folder() / "filter" / f"{name}.yaml")})
    with resolvers.registered():
        return cast(dict[str, dict[str, Any]], OmegaConf.to_container(config, resolve=True))["filter"]
