"""Exceptions of a plugin's code, named as the plugin's."""

from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar

from estlab.config.settings import Settings
from estlab.errors import plugins_answer

P = ParamSpec("P")
R = TypeVar("R")


def plugins_named(function: Callable[Concatenate[Settings, P], R]) -> Callable[Concatenate[Settings, P], R]:
    """The function, which raises PluginError in place of exceptions from the code of the user's plugins."""

    @wraps(function)
    def named(settings: Settings, /, *arguments: P.args, **keys: P.kwargs) -> R:
        with plugins_answer(settings.plugins):
            return function(settings, *arguments, **keys)

    return named
