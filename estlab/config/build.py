"""Builds objects from a composed configuration, strictly: nothing unknown, nothing out of range, no unlisted import.

The schema is the code: a node's keys are the parameters of the class or function that its ``_target_`` names, and a
value's type is the parameter's. Defaults live only in conf/.
"""

import difflib
import importlib
import importlib.util
import inspect
import math
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import is_dataclass
from typing import Any, Literal, Union

from estlab.config.groups import SweepSettings
from estlab.config.settings import Configuration, Names, Settings, settings_of
from estlab.config.targets import check_targets, resolved
from estlab.errors import PluginError, UserError, plugin_fault
from estlab.filters.filter import AnyFilter, Filter

Node = Mapping[str, Any]

_UNNAMED = Names("unnamed", "unnamed")


def build(config: Node, names: Names = _UNNAMED) -> Settings:
    """The settings that a resolved configuration describes.

    names: what its scenario and its filter are called, on which random numbers hang.

    Raises UserError, naming the key, the value and the remedy, for the first thing that is wrong.
    """
    allowed = ("estlab", *_plugins(config.get("plugins")))
    check_targets(config, "", allowed)
    made = typing.cast(Configuration, _Builder(config, allowed).construct(Configuration, config, ""))
    return settings_of(made, names)


def sweep_settings(config: Node) -> SweepSettings:
    """The settings of a sweep alone.

    Raises UserError like :func:`build`.
    """
    return typing.cast(SweepSettings, _Builder({"sweep": config}, ()).construct(SweepSettings, config, "sweep"))


def filter_of(node: Node) -> AnyFilter:
    """The filter that its settings alone describe, of estlab's own.

    Raises UserError like :func:`build`.
    """
    allowed = ("estlab",)
    check_targets(node, "filter", allowed)
    return typing.cast(AnyFilter, _Builder({"filter": node}, allowed).convert(node, Filter, "filter"))


def _plugins(names: Any) -> list[str]:
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise UserError(f"plugins must be a list of packages, for example plugins=[mine], got {names!r}")
    for name in names:
        if not name.isidentifier() or importlib.util.find_spec(name) is None:
            raise UserError(f"plugins: Python finds no package {name!r}; add its folder to PYTHONPATH")
    return names


def nearest(path: str, known: Sequence[str]) -> str:
    """'; did you mean ...?' for the known name most like a wrong one, or nothing.

    The last part counts most: a right name in a wrong group, then a like name in the same group, then anywhere.
    """
    known = [name for name in known if not path.startswith(f"{name}.")]
    group, _, leaf = path.rpartition(".")
    leaves = {name.rpartition(".")[2]: name for name in reversed(known)}
    beside = {name.rpartition(".")[2]: name for name in known if name.rpartition(".")[0] == group}
    for names, cutoff in ((leaves, 1.0), (beside, 0.6), (leaves, 0.75)):
        if close := difflib.get_close_matches(leaf, list(names), n=1, cutoff=cutoff):
            return f"; did you mean {names[close[0]]}?"
    return ""


def unknown_key(path: str, known: Sequence[str]) -> str:
    """One line for a key that nothing takes: the nearest that something takes, or what its group does."""
    group = path.rpartition(".")[0]
    siblings = dict.fromkeys(name.rpartition(".")[2] for name in known if name.rpartition(".")[0] == group)
    takes = f"; {group or 'the top level'} takes {', '.join(siblings)}"
    near = nearest(path, known)
    if group in known and not siblings:
        return f"unknown key {path}; {group} takes no keys here"
    return unknown_key(group, known) if group and not (near or siblings) else f"unknown key {path}{near or takes}"


def key_paths(config: Any, prefix: str = "") -> list[str]:
    """Every key of a configuration by its dotted path."""
    paths = []
    for key, value in config.items():
        path = f"{prefix}{key}"
        paths.append(path)
        if isinstance(value, Mapping):
            paths += key_paths(value, f"{path}.")
    return [path for path in paths if not path.endswith("_target_")]


class _Builder:
    def __init__(self, config: Node, allowed: tuple[str, ...]) -> None:
        self.known = key_paths(config)
        self.allowed = allowed

    def construct(self, make: Callable[..., Any], node: Node, path: str) -> Any:
        """Call ``make`` with the node's values, each checked against the parameter of its name."""
        parameters = inspect.signature(make).parameters
        hints = typing.get_type_hints(make.__init__ if inspect.isclass(make) else make)
        given = [key for key in node if key != "_target_"]
        for key in given:
            if key not in parameters:
                here = [_join(path, name) for name in parameters] + ([] if path else ["+experiment"])
                elsewhere = [name for name in self.known if name != _join(path, key)]
                raise UserError(unknown_key(_join(path, key), here + elsewhere))
        for key, parameter in parameters.items():
            if key not in node and parameter.default is parameter.empty:
                raise UserError(f"{_join(path, key)} is missing")
        arguments = {key: self.convert(node[key], hints.get(key, Any), _join(path, key)) for key in given}
        if lacking := sorted(getattr(make, "__abstractmethods__", ())):
            name = f"{make.__module__}.{make.__qualname__}"
            raise UserError(f"{path}: {name} has no {', '.join(lacking)}; define it")
        try:
            return make(**arguments)
        except (Exception, SystemExit) as error:
            named = isinstance(error, (ValueError, ArithmeticError))  # as is agreed for what a key may not be
            if not named and (fault := plugin_fault(error, self.allowed[1:])):
                raise PluginError(fault) from error
            if named or isinstance(error, TypeError):
                raise UserError(_join(path, " ".join(str(error).split()))) from error
            raise

    def convert(self, value: Any, hint: Any, path: str) -> Any:
        """The value as the type, or a UserError that names the key."""
        if value == "???":
            raise UserError(f"{path} is required, for example {path}=...")
        if hint is Any:
            return value
        if inspect.isclass(generic := typing.get_origin(hint)) and generic.__module__ not in ("builtins", "types"):
            hint = generic  # of Filter[Any]
        if isinstance(value, Mapping):
            if "_target_" in value:
                make = resolved(value["_target_"], hint, f"{path}._target_", self.allowed)
                made = self.construct(make, value, path)
                if not isinstance(made, hint):
                    raise UserError(
                        f"{path}._target_ {value['_target_']} made a {type(made).__name__}, not a {hint.__name__}"
                    )
                return made
            if is_dataclass(hint):
                return self.construct(typing.cast(Callable[..., Any], hint), value, path)
            if inspect.isclass(hint) and hint.__module__ != "builtins":
                raise UserError(f"{path}._target_ is missing; name the class or function that makes it")
        origin, arguments = typing.get_origin(hint), typing.get_args(hint)
        if origin in (Union, types.UnionType):
            if value is None and type(None) in arguments:
                return None
            return self.convert(value, next(a for a in arguments if a is not type(None)), path)
        if origin is Literal:
            if value not in arguments:
                near = nearest(str(value), [str(a) for a in arguments])
                raise UserError(f"{path} must be one of {', '.join(map(str, arguments))}, got {value}{near}")
            return value
        if origin is list:
            if not isinstance(value, Sequence) or isinstance(value, str):
                raise UserError(f"{path} must be a list, got {value!r}")
            return [self.convert(item, arguments[0], f"{path}[{i}]") for i, item in enumerate(value)]
        if origin is dict:
            if not isinstance(value, Mapping):
                raise UserError(f"{path} must be a group, as filter=[ekf,ukf] makes, got {value!r}")
            return {key: self.convert(item, arguments[1], _join(path, key)) for key, item in value.items()}
        return _scalar(value, hint, path)


def _scalar(value: Any, hint: Any, path: str) -> Any:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if number and isinstance(value, float) and not math.isfinite(value):
        raise UserError(f"{path} must be finite, got {value}")
    if number and abs(value) >= 2**63 and (hint is int or isinstance(value, int)):
        raise UserError(f"{path} is too large; integers end at 9e18")
    if hint is float and number:
        return float(value)
    if hint is int and number and float(value).is_integer():
        return int(value)
    if hint in (bool, str) and isinstance(value, hint):
        return value
    if hint is str and number:
        return str(value)
    words = {float: "a number", int: "an integer", bool: "true or false", str: "text"}
    raise UserError(f"{path} must be {words.get(hint, 'a group with a _target_')}, got {value!r}")


def _join(path: str, key: str) -> str:
    return f"{path}.{key}" if path else key
