"""Whole command lines, from the shell to the exit code, against what Python itself takes."""

import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial

from benchmarks.speed.turns import Row, within

_IMPORTS = "import numpy, pandas, matplotlib.pyplot, hydra"
_ALLOWANCE = 0.15  # seconds that an answer may take beyond Python's own start


def rows() -> Iterator[Row]:
    """A run with all its tables, pictures and page; then the commands that answer at once."""
    with tempfile.TemporaryDirectory() as folder:
        run = ("run", "scenario=car", "filter=ukf", "runs=100", f"output={folder}")
        yield within("estlab run scenario=car filter=ukf runs=100", _estlab(*run), _IMPORTS, _python(_IMPORTS), 4.0)
    for word in ("--help", "list"):
        reference = f"python -c pass, and {_ALLOWANCE:g} s"
        yield within(f"estlab {word}", _estlab(word), reference, _python("pass"), 1.0, _ALLOWANCE)


def _estlab(*words: str) -> Callable[[], object]:
    return partial(_call, "-m", "estlab", *words)


def _python(code: str) -> Callable[[], object]:
    return partial(_call, "-c", code)


def _call(*words: str) -> None:
    subprocess.run([sys.executable, *words], check=True, capture_output=True)
