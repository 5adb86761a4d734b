"""The source of the plugins that took part in a run: text that is stored and never run again."""

import hashlib
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

_MODULE_BYTES, _ALL_BYTES, _MODULES = 2**20, 2**24, 1000
_NAME = re.compile(r"\w+(\.\w+)*")


class PluginSource(NamedTuple):
    """A module by its dotted name, the file that it was read from, the file's SHA-256 and, if stored, its text."""

    module: str
    file: str
    sha256: str
    text: bytes | None


def sources(packages: Iterable[str]) -> list[PluginSource]:
    """For each imported module of these packages, its current file, and the text of Python files up to a size."""
    found: list[PluginSource] = []
    room = _ALL_BYTES
    for name in sorted(_imported(packages))[:_MODULES]:
        file = getattr(sys.modules[name], "__file__", None)
        if not isinstance(file, str):
            continue  # a folder without its own module, or one made while the program ran
        try:
            if Path(file).stat().st_size > _ALL_BYTES:
                continue
            content = Path(file).read_bytes()
        except OSError:
            continue  # deleted since it was imported, or in an archive
        kept = file.endswith(".py") and len(content) <= min(room, _MODULE_BYTES)
        room -= len(content) * kept
        found.append(PluginSource(name, file, hashlib.sha256(content).hexdigest(), content if kept else None))
    return found


def _imported(packages: Iterable[str]) -> set[str]:
    wanted = set(packages)
    return {name for name in list(sys.modules) if name.partition(".")[0] in wanted and _NAME.fullmatch(name)}
