"""Warnings of NumPy, of pictures and of plugins: each is reported once, in one line."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from estlab.errors import printable


@contextmanager
def in_a_line(say: Callable[[str], object]) -> Iterator[None]:
    """Pass warnings to ``say``, with their origin at the end. Does not change which warnings there are."""
    heard: set[str] = set()

    def show(message: Any, category: type, filename: str, lineno: int, file: Any = None, line: Any = None) -> None:
        text = printable(" ".join(str(message).split()))
        said = f"{category.__name__}: {text} ({Path(filename).name}, line {lineno})"
        if said not in heard:
            heard.add(said)
            say(said)

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield
