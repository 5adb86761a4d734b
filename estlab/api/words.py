"""Python keys and values as the words of a command line."""

import re
from collections.abc import Iterator, Mapping, Sequence
from os import PathLike, fspath
from typing import Any

import numpy as np

from estlab.config.locations import groups
from estlab.errors import UserError
from estlab.launch.path_arguments import is_path
from estlab.launch.quoting import quoted

# A text that Hydra's grammar accepts as it is: not a number, not a reserved word, no special characters.
_PLAIN = re.compile(r"(?!(?:null|true|false|inf|nan)\Z)[A-Za-z_][\w.-]*", re.IGNORECASE)


def words_of(words: Sequence[str], keys: Mapping[str, Any]) -> list[str]:
    """Words as typed, then a word for each key: a mapping is a group of keys, a list is written in brackets.

    Raises UserError for a value that a configuration cannot have.
    """
    for word in words:
        if not isinstance(word, str):
            raise UserError(f"{word!r} is not a text: write key=value as on the command line, or a keyword")
    return [*words, *(word for key, value in keys.items() for word in _words(key, value))]


def _words(key: str, value: Any) -> Iterator[str]:
    if isinstance(value, Mapping) and value:
        for name, inner in value.items():
            yield from _words(f"{key}.{name}", inner)
    elif key == "experiment":
        yield f"+experiment={value}"
    elif isinstance(value, str | PathLike) and (is_path(key) or key in groups()):
        yield f"{key}={fspath(value)}"
    elif key in groups() and isinstance(value, list | tuple):
        yield f"{key}=[{','.join(map(str, value))}]"
    else:
        yield f"{key}={_text(key, value)}"


def _text(key: str, value: Any) -> str:
    """A value in Hydra's grammar."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return value if _PLAIN.fullmatch(value) else quoted(value)
    if isinstance(value, PathLike):
        return quoted(fspath(value))
    if isinstance(value, list | tuple | range):
        return f"[{','.join(_text(key, item) for item in value)}]"
    if isinstance(value, Mapping):
        return f"{{{','.join(f'{name}: {_text(key, item)}' for name, item in value.items())}}}"
    raise UserError(
        f"{key} is a {type(value).__name__}; a value must be a number, a text, true or false, None, or a list"
    )
