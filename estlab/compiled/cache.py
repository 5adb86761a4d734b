"""Object code, kept between starts.

A file's name is a hash of everything that it was made from: the program's text in LLVM's language, and the processor.
It starts with a hash of its content, so a damaged file is detected and made again. It is written beside its place and
moved there, so processes that start at once find it whole or not at all. You may delete the files at any time.
"""

import ctypes
import hashlib
import logging
import multiprocessing
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from estlab.errors import printable

log = logging.getLogger("estlab")

_ADDRESSES = 500 * 2**20

_BUILT: dict[tuple[str, str], "MachineCode"] = {}


class MachineCode:
    """Machine code in memory, with the objects that keep it alive."""

    def __init__(self, code: bytes) -> None:
        binding, machine = _machine()  # its own: the engine frees it
        engine = binding.create_mcjit_compiler(binding.parse_assembly(""), machine)
        engine.add_object_file(binding.ObjectFileRef.from_data(code))
        engine.finalize_object()
        self._engine = engine

    def function(self, name: str) -> Callable[[int], None]:
        """A function of the program that takes one address and returns nothing."""
        kind = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
        return kind(self._engine.get_function_address(name))


def folder() -> Path:
    """The folder for compiled code: ESTLAB_CACHE, or estlab in the user's cache folder."""
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return Path(os.environ.get("ESTLAB_CACHE") or caches / "estlab") / "compiled"


def loadable() -> bool:
    """Whether there is a compiler, and room for one: its import crashes in less memory."""
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    if most != resource.RLIM_INFINITY and most < _ADDRESSES:
        return False
    try:
        _machine()
    except (ImportError, OSError):
        return False
    return True


def lanes() -> int:
    """The number of doubles in a register of this processor."""
    features = _machine_features()
    return 8 if "+avx512f" in features else 4 if "+avx" in features.split(",") else 2


def program(text: str) -> MachineCode:
    """The program for this text: from this process, from the folder, or newly compiled."""
    digest = hashlib.sha256(f"{_processor()}\0{text}".encode()).hexdigest()
    key = str(folder()), digest
    if key not in _BUILT:
        began = time.perf_counter()
        code = _kept(digest)
        found = "found compiled" if code else "compiled"
        if code is None:
            code = compiled(text)
            _keep(digest, code)
        _BUILT[key] = MachineCode(code)
        log.info("machine code was %s in %.2f s (%s)", found, time.perf_counter() - began, digest[:16])
    return _BUILT[key]


def compiled(text: str) -> bytes:
    """Object code for this processor."""
    binding, machine = _machine()
    module = binding.parse_assembly(f'target triple = "{machine.triple}"\n{text}')
    module.verify()
    return machine.emit_object(module)


def _machine() -> tuple[Any, Any]:
    import llvmlite.binding as binding

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    target = binding.Target.from_default_triple()
    machine = target.create_target_machine(cpu=binding.get_host_cpu_name(), features=_machine_features(), opt=2)
    return binding, machine


@cache
def _machine_features() -> str:
    import llvmlite.binding as binding

    return binding.get_host_cpu_features().flatten()


@cache
def _processor() -> str:
    import llvmlite
    import llvmlite.binding as binding

    parts = llvmlite.__version__, binding.get_default_triple(), binding.get_host_cpu_name(), _machine_features()
    return "\0".join(parts)


def _kept(digest: str) -> bytes | None:
    """The code stored under this name; None if there is none or it is damaged."""
    path = folder() / f"{digest}.o"
    try:
        whole = path.read_bytes()
    except OSError:
        return None
    if hashlib.sha256(whole[32:]).digest() == whole[:32]:
        return whole[32:]
    _warn(f"{path}: compiled code there is damaged and is made anew")
    return None


def _keep(digest: str, code: bytes) -> None:
    place = folder()
    try:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=place, suffix=".part", delete=False) as aside:
            aside.write(hashlib.sha256(code).digest() + code)
        Path(aside.name).replace(place / f"{digest}.o")
    except OSError as error:
        _warn(
            f"{place}: compiled code cannot be kept here ({error.strerror}) and is made anew at each start; "
            "set ESTLAB_CACHE to a folder that can be written"
        )


@lru_cache
def _warn(message: str) -> None:
    """Warn once, from one process."""
    if multiprocessing.parent_process() is None:
        print(f"estlab: warning: {printable(message)}", file=sys.stderr)
