"""Names of earlier versions of estlab: plugins that use them keep working, and a warning gives the present name."""

import importlib
import sys
import warnings
from collections.abc import Callable, Sequence
from functools import wraps
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any, TypeVar

T = TypeVar("T")

MODULES = {
    "estlab.filters.contract": "estlab.filters.filter",
    "estlab.maths.derivatives": "estlab.maths.finite_differences",
    "estlab.maths.gaussian": "estlab.maths.gaussian_belief",
    "estlab.maths.rows": "estlab.maths.stacking",
    "estlab.models.sonar": "estlab.models.sonar_beams",
    "estlab.scenarios.contract": "estlab.scenarios.scenario",
}
_OF_MODULES = {"Fit": "Innovation", "fit_of": "innovation_of", "placed": "replaced"}


def renamed(**names: str) -> Callable[[type[T]], type[T]]:
    """A class whose arguments and attributes also have earlier names: earlier="present"."""

    def decorated(cls: type[T]) -> type[T]:
        plain = cls.__init__

        @wraps(plain)
        def init(self: T, *arguments: Any, **given: Any) -> None:
            # replace(record, places=...) also passes every field by its present name: the typed value is used.
            for earlier in names.keys() & given.keys():
                _warn(f"{cls.__name__}({earlier}=...)", f"{cls.__name__}({names[earlier]}=...)")
                given[names[earlier]] = given.pop(earlier)
            plain(self, *arguments, **given)

        if plain is not object.__init__:
            cls.__init__ = init  # type: ignore[assignment, method-assign]
        for earlier, present in names.items():
            setattr(cls, earlier, property(_attribute(cls.__name__, earlier, present)))
        return cls

    return decorated


def _attribute(owner: str, earlier: str, present: str) -> Callable[[Any], Any]:
    def get(self: Any) -> Any:
        _warn(f"{owner}.{earlier}", f"{owner}.{present}")
        return getattr(self, present)

    return get


def _warn(earlier: str, present: str) -> None:
    warnings.warn(f"{earlier} is now {present}", FutureWarning, stacklevel=3)


class _Modules:
    """Finds and loads modules under their earlier names, with what the present ones define.

    Not a subclass of importlib.abc, whose import takes as long as a start of Python.
    """

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        loader: Any = self
        return ModuleSpec(fullname, loader) if fullname in MODULES else None

    def create_module(self, spec: ModuleSpec) -> None:
        """A plain module."""

    def exec_module(self, module: ModuleType) -> None:
        present = importlib.import_module(MODULES[module.__name__])
        _warn(module.__name__, present.__name__)

        def get(name: str) -> Any:
            return getattr(present, _OF_MODULES.get(name, name))

        module.__getattr__ = get  # type: ignore[method-assign]


def find_modules() -> None:
    """Make modules available under their earlier names."""
    sys.meta_path.append(_Modules())
