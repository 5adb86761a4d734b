"""Checks a ``_target_``: its package before anything is imported, and where it is defined before it is called."""

import importlib
import inspect
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from estlab.errors import PluginError, UserError, plugin_fault


def check_targets(node: Any, path: str, allowed: tuple[str, ...]) -> None:
    """Refuse every target outside the allowed packages before anything is imported."""
    if isinstance(node, Mapping):
        for key, value in node.items():
            if key == "_target_":
                _check_name(value, f"{path}.{key}" if path else key, allowed)
            check_targets(value, f"{path}.{key}" if path else str(key), allowed)
    elif isinstance(node, Sequence) and not isinstance(node, str):
        for i, value in enumerate(node):
            check_targets(value, f"{path}[{i}]", allowed)


def _check_name(name: Any, path: str, allowed: tuple[str, ...]) -> None:
    if not any(str(name).startswith(f"{package}.") for package in allowed):
        raise UserError(
            f"{path} {name} is refused: it is not in {', '.join(allowed)}; list its package under plugins to allow it"
        )


def located(name: str, path: str, allowed: tuple[str, ...]) -> Any:
    """The class or function of this name, defined in an allowed package.

    Raises UserError if it does not exist or is defined elsewhere, even if an allowed module imports it.
    """
    _check_name(name, path, allowed)
    found = _imported(name, path, allowed)
    if not (inspect.isclass(found) or inspect.isfunction(found)):
        raise UserError(f"{path}: there is no class or function {name}")
    _check_name(f"{found.__module__}.{found.__qualname__}", path, allowed)
    return found


def _imported(name: str, path: str, allowed: tuple[str, ...]) -> Any:
    module, _, attribute = name.rpartition(".")
    try:
        return getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise UserError(f"{path}: there is no {name} ({error})") from error
    except (Exception, SystemExit) as error:
        if fault := plugin_fault(error, allowed[1:]):
            raise PluginError(fault) from error
        message = " ".join(str(error).split())
        raise UserError(f"{path}: importing {module} ended with {type(error).__name__}: {message}") from error


def resolved(name: str, kind: Any, path: str, allowed: tuple[str, ...]) -> Callable[..., Any]:
    """The class of this kind, or the function that returns one, of this name, defined in an allowed package."""
    made = _product(_imported(name, path, allowed))
    if not (inspect.isclass(made) and inspect.isclass(kind) and issubclass(made, kind)):
        raise UserError(f"{path} {name} does not make a {getattr(kind, '__name__', kind)}")
    return typing.cast(Callable[..., Any], located(name, path, allowed))


def _product(found: Any) -> Any:
    """What calling this returns, by its annotation; None if it has none."""
    if inspect.isclass(found):
        return found
    try:
        made = typing.get_type_hints(found).get("return") if inspect.isfunction(found) else None
    except NameError:
        return None
    return typing.get_origin(made) or made
