"""All rows as one Markdown table, each as it is found: python -m benchmarks.speed [WORD ...]

WORD: the modules wanted, of gaussian, cores, particles, compiled, startup; all by default (about ten minutes). The exit
code is 1 if a goal was not met.
"""

import importlib
import os
import platform
import sys

import numpy as np

from benchmarks.speed.turns import REPEATS, Row

MODULES = ("gaussian", "cores", "particles", "compiled", "startup")


def main(wanted: list[str]) -> int:
    """Print the table; the exit code."""
    print(
        f"Python {platform.python_version()}, NumPy {np.__version__}, {os.cpu_count()} cores; medians of {REPEATS}.\n"
    )
    print("| work | takes | reference | takes | ratio | goal |\n|---|---|---|---|---|---|", flush=True)
    unmet = 0
    for name in wanted or MODULES:
        for row in importlib.import_module(f"benchmarks.speed.{name}").rows():
            print(line(row), flush=True)
            unmet += row.met is False
    return int(unmet > 0)


def line(row: Row) -> str:
    """A row as Markdown: the median ratio with its smallest and largest."""
    ratio = f"{row.ratio:.3g} ({row.low:.3g} to {row.high:.3g})" if row.high > row.low else f"{row.ratio:.3g}"
    goal = f"{row.goal}: {'met' if row.met else 'not met'}" if row.goal else ""
    cells = row.work, duration(row.seconds), row.reference, duration(row.reference_seconds), ratio, goal
    return f"| {' | '.join(cells)} |"


def duration(seconds: float) -> str:
    """A time in a unit that suits it."""
    return f"{seconds:.3g} s" if seconds >= 1.0 else f"{1e3 * seconds:.3g} ms"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
