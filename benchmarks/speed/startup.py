"""Whole command lines, from the shell to the exit code, against what Python itself takes.

The clock of a run on one core is what its processes take of the processor, so that a busy machine slows it no more
than its reference; that of what shares both cores is the one on the wall.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial

from benchmarks.speed.turns import Row, within

_IMPORTS = "import numpy, hydra, matplotlib.figure"
_ALLOWANCE = 0.15  # seconds that an answer may take beyond Python's own start


def rows() -> Iterator[Row]:
    """Runs with all their tables, one with its pictures and page too; a sweep; the commands that answer at once."""
    tables = ("plots=false", "report=false")
    many = ("run", "scenario=car", "filter=ukf", "runs=10000", *tables, "cores=1")
    jobs = ("sweep", "scenario=field", "filter=ekf", "runs=20", "seed=range(1,65)", "plots=false")
    for words, goal, clock in (
        (("run", "scenario=car", "filter=ukf"), 2.6, time.perf_counter),
        (many, 6.0, _of_children),
        (jobs, 8.0, time.perf_counter),
    ):
        with tempfile.TemporaryDirectory() as folder:
            command = _estlab(*words, f"output={folder}")
            yield within(f"estlab {' '.join(words)}", command, _IMPORTS, _python(_IMPORTS), goal, clock=clock)
    for word in ("--help", "list"):
        reference = f"python -c pass, and {_ALLOWANCE:g} s"
        yield within(f"estlab {word}", _estlab(word), reference, _python("pass"), 1.0, _ALLOWANCE)


def _of_children() -> float:
    """Seconds of the processor that child processes have taken."""
    times = os.times()
    return times.children_user + times.children_system


def _estlab(*words: str) -> Callable[[], object]:
    return partial(_call, "-m", "estlab", *words)


def _python(code: str) -> Callable[[], object]:
    return partial(_call, "-c", code)


def _call(*words: str) -> None:
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    subprocess.run([sys.executable, *words], check=True, capture_output=True, env=kept)
