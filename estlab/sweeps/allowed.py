"""Decides which words of a sweep.json may be used without being typed: its directory may come from a stranger.

They may choose among what estlab has and set its keys to plain values. Anything that could name code, a file of
configuration, or a place that is read during composition, must be typed by someone who trusts it.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estlab.config.angles import is_angle
from estlab.config.locations import options
from estlab.config.settings import Configuration

if TYPE_CHECKING:
    from hydra.core.override_parser.types import Override

_NAME = re.compile(r"[A-Za-z0-9][\w+-]*", re.ASCII)
_CHOICE = re.compile(r"[A-Za-z0-9][\w+-]*(/[A-Za-z0-9][\w+-]*)*", re.ASCII)
# Hydra's own launchers and those of its plugins, which have no file in conf/.
_LAUNCHERS = ("basic", "joblib", "submitit_local", "submitit_slurm")
# The keys of a launcher that may be names. An address may not: whoever answers there sends code.
_QUEUES = ("partition", "qos", "account", "constraint")
_KEYS = {field.name for field in fields(Configuration)} - {"plugins", "part", "parts"}


def refused(words: Sequence[str], folders: Sequence[Path]) -> str:
    """The first of the words that must be typed, as Hydra would receive it; empty if none must.

    folders: of configuration, as typed now.
    """
    return next((word for word in words if not _is_allowed(word, folders)), "")


def _is_allowed(word: str, folders: Sequence[Path]) -> bool:
    from hydra.core.override_parser.overrides_parser import OverridesParser

    try:
        override = OverridesParser.create().parse_override(word)
        values = list(_values(override))
    except Exception:  # words that the parser cannot read are reported once they are typed
        return False
    key = override.key_or_group
    if override.package is not None:
        # The form of filter=[ekf,ukf] after preparation.
        placed = re.fullmatch(r"filters\.([\w+-]+)", override.package, re.ASCII)
        return key == "filter" and placed is not None and values == [placed[1]] and placed[1] in options(key, folders)
    if key.startswith("hydra"):
        return not override.is_delete() and _is_allowed_of_hydra(key, values, folders)
    if _CHOICE.fullmatch(key) and (known := options(key, folders)):
        return not override.is_delete() and all(_is_choice(value, known) for value in values)
    steps = key.split(".")
    return steps[0] in _KEYS and all(map(_NAME.fullmatch, steps)) and all(map(_is_plain, values))


def _values(override: "Override") -> list[Any]:
    """The value, or each of several."""
    from hydra.core.override_parser.types import ChoiceSweep, Glob, IntervalSweep, RangeSweep

    value = override.value()
    if isinstance(value, ChoiceSweep):
        return [override._convert_value(one) for one in value.list]
    # Numbers, and the names of a group that a pattern matches.
    return [] if isinstance(value, RangeSweep | IntervalSweep | Glob) else [value]


def _is_choice(value: Any, known: Mapping[str, Path]) -> bool:
    """Whether this is the plain name of an existing option, or a list of several."""
    if isinstance(value, list):
        return all(isinstance(one, str) and _is_choice(one, known) for one in value)
    return isinstance(value, str) and _CHOICE.fullmatch(value) is not None and value in known


def _is_allowed_of_hydra(key: str, values: Sequence[Any], folders: Sequence[Path]) -> bool:
    if key == "hydra.job.name":
        return all(isinstance(value, str) and re.fullmatch(r"[\w+-]+", value, re.ASCII) for value in values)
    if key == "hydra.mode":
        return values == ["MULTIRUN"]
    if key == "hydra/launcher":
        return all(value in _LAUNCHERS or value in options(key, folders) for value in values)
    if key == "hydra/sweeper":
        return all(value in options(key, folders) for value in values)
    setting = re.fullmatch(r"hydra\.launcher\.([A-Za-z]\w*)", key, re.ASCII)
    return setting is not None and all(_is_setting(setting[1], value) for value in values)


def _is_setting(name: str, value: Any) -> bool:
    """Whether a launcher's key has a value that can name nothing: a number, or the name of a queue."""
    if isinstance(value, str):
        return name in _QUEUES and re.fullmatch(r"[\w.-]+", value, re.ASCII) is not None
    return value is None or isinstance(value, bool | int | float)


def _is_plain(value: Any) -> bool:
    """Whether a value is a number, an angle ${deg:40}, a text without ${...}, or lists and groups of such."""
    if isinstance(value, str):
        return "${" not in value or is_angle(value)
    if isinstance(value, list):
        return all(map(_is_plain, value))
    if isinstance(value, Mapping):
        return all(isinstance(key, str) and _NAME.fullmatch(key) and _is_plain(one) for key, one in value.items())
    return value is None or isinstance(value, bool | int | float)
