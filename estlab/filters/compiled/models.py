"""Model functions compiled from their own source, with all that they call."""

import importlib
import types
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

Function = types.FunctionType


def name_of(function: Any) -> tuple[str, str]:
    """The module and the name by which a function is found again.

    Raises ValueError, naming the function, if there is no such name: for a lambda, a closure, a method.
    """
    module, name = getattr(function, "__module__", "?"), getattr(function, "__qualname__", repr(function))
    if not isinstance(function, Function) or not name.isidentifier() or found(module, name) is not function:
        raise ValueError(f"{module}.{name} is not a function of a module, and only such are compiled")
    return module, name


def found(module: str, name: str) -> Any:
    """The function of this name; None if there is none."""
    return getattr(importlib.import_module(module), name, None)


def compiled(function: Any) -> Any:
    """The function for numbers, and all functions that it calls, to be compiled where they are first used.

    A copy of the same code among other names: each function that it knows is compiled too, and its NumPy is that of
    estlab.filters.compiled.scalars. The function itself stays as it is.
    """
    return _Copies().of(function)


def parts(functions: Iterable[Any]) -> Iterator[tuple[Function, dict[str, Any]]]:
    """The functions and all that they call, each with the global names that it uses and what they stand for now."""
    seen: set[int] = set()
    waiting = list(functions)
    while waiting:
        part = waiting.pop()
        if id(part) not in seen:
            seen.add(id(part))
            names = _globals(part)
            yield part, names
            waiting += [value for value in names.values() if isinstance(value, Function)]


class _Copies:
    def __init__(self) -> None:
        self.made: dict[int, Any] = {}

    def of(self, function: Function) -> Any:
        from estlab.filters.compiled import scalars

        if id(function) not in self.made:
            namespace: dict[str, Any] = {"__name__": function.__module__}
            copy = Function(function.__code__, namespace, function.__name__, function.__defaults__)
            copy.__module__, copy.__qualname__ = function.__module__, function.__qualname__
            self.made[id(function)] = scalars.jit(copy)
            # Afterwards, so that a function that calls itself finds its copy.
            for name, value in _globals(function).items():
                copied = self.of(value) if isinstance(value, Function) else value
                namespace[name] = scalars if value is np else copied
        return self.made[id(function)]


def _globals(function: Function) -> dict[str, Any]:
    """The global names that a function's code uses, those of functions inside it too, and their values."""
    names: dict[str, Any] = {}
    codes = [function.__code__]
    while codes:
        code = codes.pop()
        names |= {name: function.__globals__[name] for name in code.co_names if name in function.__globals__}
        codes += [constant for constant in code.co_consts if isinstance(constant, types.CodeType)]
    return names
