"""Jobs that differ in numbers alone share a composition: Hydra makes the first, the others are copies with theirs set.

A sweep over seeds or noises is composed in a quarter of the time.
"""

import copy
from collections.abc import Callable, Sequence

from hydra._internal.config_loader_impl import get_overrides_dirname
from hydra._internal.config_repository import IConfigRepository
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, OverrideType
from omegaconf import DictConfig, OmegaConf, open_dict

_KEPT = 64  # compositions; jobs that share one need not follow each other

Compose = Callable[[], DictConfig]


class SharedCompositions:
    """Compositions of one sweep, by the words that are no number's."""

    def __init__(self, repository: IConfigRepository) -> None:
        self._repository = repository
        self._parser = OverridesParser.create()
        self._kept: dict[tuple[str, ...], DictConfig] = {}

    def of(self, words: Sequence[str], compose: Compose) -> DictConfig:
        """The configuration of a job that is typed like this. compose: makes it from nothing.

        Raises what ``compose`` raises.
        """
        overrides = self._parser.parse_overrides(list(words))
        numbers = [one for one in overrides if self._is_number(one)]
        if not numbers or any(self._order_counts(one, number) for one in overrides for number in numbers):
            return compose()
        shape = tuple(f"{one.key_or_group}=" if one in numbers else str(one.input_line) for one in overrides)
        if shape not in self._kept:
            if len(self._kept) == _KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[shape] = compose()
        config = copy.deepcopy(self._kept[shape])
        for number in numbers:
            OmegaConf.update(config, number.key_or_group, number.value(), merge=True)
        _set_words(config, overrides)
        return config

    def _is_number(self, override: Override) -> bool:
        """Whether it gives one number to a key that chooses no file and that Hydra does not use itself."""
        plain = override.type == OverrideType.CHANGE and override.package is None
        if not plain or override.is_hydra_override() or not isinstance(override.value(), (int, float)):
            return False
        return not self._repository.group_exists(override.key_or_group)

    def _order_counts(self, one: Override, number: Override) -> bool:
        """Whether a word sets a whole node with the number in it, or adds folders in which groups may be."""
        inside = number.key_or_group.startswith(f"{one.key_or_group}.")
        return one.key_or_group == "hydra.searchpath" or (
            inside and not self._repository.group_exists(one.key_or_group)
        )


def _set_words(config: DictConfig, overrides: Sequence[Override]) -> None:
    """What the configuration says of the words that it was composed from."""
    own = [one for one in overrides if not one.is_hydra_override()]
    form = config.hydra.job.config.override_dirname
    with open_dict(config):
        config.hydra.overrides.task = [str(one.input_line) for one in own]
        config.hydra.job.override_dirname = get_overrides_dirname(
            overrides=own, kv_sep=form.kv_sep, item_sep=form.item_sep, exclude_keys=form.exclude_keys
        )
