"""Compiled filter loops, kept between starts.

Each has a folder, named by a hash of all that it was made of: the text of its module, the source of every module that
has a part of its models, compiler and Python. So code that was compiled before never meets a model that was changed
since, which Numba alone would not notice: it looks at the loop's own file. Numba itself minds the kind of processor.
"""

import contextlib
import hashlib
import importlib.metadata
import importlib.util
import inspect
import logging
import multiprocessing
import os
import platform
import sys
import tempfile
import time
import types
import warnings
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core.errors import NumbaWarning

from estlab.errors import UserError, printable
from estlab.filters.compiled import models, scalars
from estlab.filters.compiled.kernel import small
from estlab.filters.compiled.source import Plan, text

log = logging.getLogger("estlab")

_BUILT: dict[str, Any] = {}


def folder() -> Path:
    """Where compiled loops are kept: below ESTLAB_CACHE, or below estlab in the user's folder for caches."""
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return Path(os.environ.get("ESTLAB_CACHE") or caches / "estlab") / "compiled"


def loop(plan: Plan, arguments: Sequence[Any]) -> Callable[..., None]:
    """The compiled loop for arguments of these kinds: from this process, from the folder, or made now.

    Raises UserError, naming the function, for a model that cannot be compiled.
    """
    source, digest = made_of(plan)
    if digest not in _BUILT:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NumbaWarning)  # hints on speed, for who writes the code
            _BUILT[digest] = _made(plan, source, digest, arguments)
    return _BUILT[digest]


@lru_cache
def made_of(plan: Plan) -> tuple[str, str]:
    """The text of the module, and a hash of all that the compiled code is made of."""
    source = text(plan)
    told = [platform.python_version(), *map(importlib.metadata.version, ("numba", "llvmlite", "numpy"))]
    told += [source, *map(inspect.getsource, (small, scalars, models))]
    for function, names in models.parts(plan.functions.values()):
        told += [function.__module__, function.__qualname__, _source(function)]
        told += [f"{name}={_told(value)}" for name, value in sorted(names.items())]
    return source, hashlib.sha256("\0".join(told).encode()).hexdigest()[:32]


def _source(function: types.FunctionType) -> str:
    """Of the function's whole module; of its code alone where there is no file, as in a notebook."""
    try:
        return inspect.getsource(sys.modules[function.__module__])
    except (OSError, TypeError):
        return repr((function.__code__.co_code, function.__code__.co_consts))


def _told(value: Any) -> str:
    """The value of a constant; of anything else the source says what it is."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{value.tobytes().hex()}"
    return repr(value) if isinstance(value, int | float | complex | str | tuple | np.generic) else ""


def _made(plan: Plan, source: str, digest: str, arguments: Sequence[Any]) -> Any:
    name = f"estlab_compiled_{digest}"
    kinds = tuple(map(numba.typeof, arguments))
    try:
        try:
            return _kept(name, digest, source, kinds)
        except Exception as error:
            if not _removed(digest):
                raise
            _warn(f"{folder() / digest}: compiled code there is damaged ({_reason(error)}) and is made anew")
            return _kept(name, digest, source, kinds)
    except (OSError, RuntimeError) as error:
        why = getattr(error, "strerror", None) or error
        _warn(
            f"{folder()}: compiled code cannot be kept here ({why}) and is made anew at each start; "
            "set ESTLAB_CACHE to a folder that can be written"
        )
        return _not_kept(plan, name, source, kinds)
    except Exception as error:
        raise UserError(_complaint(plan, error)) from error


def _kept(name: str, digest: str, source: str, kinds: tuple[Any, ...]) -> Any:
    return _compiled(_imported(name, _written(digest, source)), kinds, cache=True)


def _not_kept(plan: Plan, name: str, source: str, kinds: tuple[Any, ...]) -> Any:
    module = types.ModuleType(name)
    exec(compile(source, f"<{name}>", "exec"), module.__dict__)
    try:
        return _compiled(module, kinds, cache=False)
    except Exception as error:
        raise UserError(_complaint(plan, error)) from error


def _removed(digest: str) -> bool:
    """Whether there was compiled code in the folder, which is gone now."""
    files = list((folder() / digest).rglob("*.nb[ic]"))
    for file in files:
        file.unlink(missing_ok=True)
    return bool(files)


@lru_cache
def _warn(said: str) -> None:
    """Once, and by one process."""
    if multiprocessing.parent_process() is None:
        print(f"estlab: warning: {printable(said)}", file=sys.stderr)


def _written(digest: str, source: str) -> Path:
    """The file with this source. Of several processes that write it at once, the first does."""
    place = folder() / digest
    path = place / "loop.py"
    if path.exists() and path.read_text(encoding="utf-8", errors="replace") != source:
        path.unlink(missing_ok=True)  # the folder's name says what it holds: this is damage
    if not path.exists():
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", encoding="utf-8", dir=place, suffix=".part") as aside:
            aside.write(source)
            aside.flush()
            # A link, unlike a renaming, leaves a file that is there: its age tells Numba whose code is in the cache.
            with contextlib.suppress(FileExistsError):
                os.link(aside.name, path)
    return path


def _imported(name: str, path: Path) -> types.ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where Numba looks for it when it loads the compiled code
    spec.loader.exec_module(module)
    return module


def _compiled(module: types.ModuleType, kinds: tuple[Any, ...], cache: bool) -> Any:
    forward = scalars.NJIT(error_model="numpy", no_cfunc_wrapper=True, cache=cache)(module.forward)
    began = time.perf_counter()
    forward.compile(kinds)
    found = "found compiled" if sum(forward.stats.cache_hits.values()) else "compiled"
    log.info("engine=numba: the loop was %s in %.1f s (%s)", found, time.perf_counter() - began, module.__name__)
    return forward


def _complaint(plan: Plan, error: Exception) -> str:
    """Which of the model's functions cannot be compiled, in one line."""
    number = numba.types.float64
    state, noise = (number,) * plan.state.size, (number,) * plan.noises
    command, place = (number,) * plan.controls, (number,) * plan.coordinates
    given = {
        "move": (state, command, noise, number),
        "measure": (state, place),
        "jacobians": (state, command, number),
        "slope": (state, place),
    }
    for kind, function in plan.functions.items():
        try:
            models.compiled(function).compile(tuple(_tuple(one) for one in given[kind]))
        except Exception as reason:
            module, name = models.name_of(function)
            return f"engine=numba cannot compile {module}.{name} ({_reason(reason)}); take engine=numpy"
    return f"engine=numba cannot compile these models ({_reason(error)}); take engine=numpy"


def _tuple(kind: Any) -> Any:
    types: Any = numba.types
    return types.BaseTuple.from_types(kind) if isinstance(kind, tuple) else kind


def _reason(error: Exception) -> str:
    """What the compiler says, without where in itself it was."""
    lines = [line.strip(" >") for line in str(error).splitlines() if line.strip()]
    said = [line for line in lines if not line.startswith("Failed in")] or [type(error).__name__]
    reason = " ".join(said[:2]) if said[0].endswith(":") else said[0]
    return reason if len(reason) <= 160 else f"{reason[:157]}..."
