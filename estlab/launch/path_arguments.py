"""Keys that are paths: the typed value is the path itself, whatever characters it contains."""

import os
import re

from estlab.launch.quoting import QUOTED, elements, quoted, unquoted

PATHS = ("data.path", "data.prefix", "output", "sweep.dir", "hydra.run.dir", "hydra.sweep.dir")
_FILES = re.compile(r"data\.files\.\w+")  # file names, by kind
_SWEPT = ("data.path", "data.prefix")
_FUNCTION = re.compile(r"(choice|glob|range|sort|shuffle|str|tag)\s*\(.*\)", re.DOTALL)


def quoted_path(argument: str, sweep: bool) -> str:
    """An argument that sets a path, quoted for Hydra; any other unchanged.

    Blanks, commas, brackets and quotes are part of the path. ${...} is an interpolation. A value that is already in
    quotes, as Hydra reads them, stays unchanged. In a sweep a comma separates values of data.path, unless there is
    such a path.
    """
    key, _, value = argument.partition("=")
    if not is_path(key) or value in ("", "null", "???"):
        return argument
    if not sweep or key.lstrip("+") not in _SWEPT or (key.endswith("path") and os.path.lexists(home(value))):
        return f"{key}={_quoted(value)}"
    if _FUNCTION.fullmatch(value):
        return argument
    return f"{key}={','.join(map(_quoted, elements(value)))}"


def is_path(key: str) -> bool:
    """Whether a key, as typed, is a path."""
    bare = key.lstrip("+")
    return bare in PATHS or _FILES.fullmatch(bare) is not None


def as_typed(argument: str) -> str:
    """An argument as a user types it: a path without Hydra's quotes, if that means the same."""
    key, _, value = argument.partition("=")
    plain = f"{key}={unquoted(value)}"
    return plain if is_path(key) and quoted_path(plain, sweep=False) == argument else argument


def home(path: str) -> str:
    """A path with a leading ~ or ~user replaced by a home; if there is no such user, a folder of that name."""
    return os.path.expanduser(path)  # noqa: PTH111 (Path's raises where there is no such user)


def _quoted(value: str) -> str:
    return value if QUOTED.fullmatch(value) else quoted(value)
