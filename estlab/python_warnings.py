"""Warnings of NumPy, of pictures and of plugins: each is reported once, in one line."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from estlab.errors import printable


@contextmanager
def in_a_line(write: Callable[[str], object]) -> Iterator[None]:
    """Pass warnings to ``say``, with their origin at the end. Does not change which warnings there are."""
    seen: set[str] = set()

    def show(message: Any, category: type, filename: str, lineno: int, file: Any = None, line: Any = None) -> None:
        text = printable(" ".join(str(message).split()))
        entry = f"{category.__name__}: {text} ({Path(filename).name}, line {lineno})"
        if entry not in seen:
            seen.add(entry)
            write(entry)

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield
