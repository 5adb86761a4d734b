"""estlab: a laboratory for nonlinear state estimation, on the command line and in Python.

    import estlab

    run = estlab.run("scenario=car", filter=["ekf", "ukf"], runs=200)
    run.metrics            # pandas DataFrames: metrics, errors, nees, nis, tests, runs
    run.verdict["ukf"]     # the tests' verdict on a filter
    run.figure("errors")   # a matplotlib figure

    estlab.load("runs/latest")    # a run from its directory
    estlab.runs("runs")           # all of them, a row for each filter of each run
    estlab.sweep("filter=ekf,ukf", "noise.filter.process_scale=0.5,1,2")
    estlab.estimate("ukf", motion, sensor, prior, time, readings)   # a filter over your own arrays

Every name is imported on first use, so ``import estlab`` itself takes no time. See docs/python.md.
"""

import importlib
from typing import TYPE_CHECKING, Any

from estlab import earlier_names

__version__ = "0.1.0"

earlier_names.find_modules()

if TYPE_CHECKING:
    from estlab import errors
    from estlab.api.comparing import compare
    from estlab.api.estimates import FilterEstimates
    from estlab.api.estimation import estimate, make_filter
    from estlab.api.finding import load, runs
    from estlab.api.run import Run
    from estlab.api.running import run
    from estlab.api.sweeping import Sweep, sweep
    from estlab.errors import EstlabError, UserError
    from estlab.filters.filter import Filter
    from estlab.maths.gaussian_belief import Gaussian
    from estlab.maths.space import Space
    from estlab.maths.streams import Streams
    from estlab.maths.uniform import Uniform
    from estlab.models.contract import Motion, Sensor

_HOMES = {
    "EstlabError": "estlab.errors",
    "Filter": "estlab.filters.filter",
    "FilterEstimates": "estlab.api.estimates",
    "Gaussian": "estlab.maths.gaussian_belief",
    "Motion": "estlab.models.contract",
    "Run": "estlab.api.run",
    "Sensor": "estlab.models.contract",
    "Space": "estlab.maths.space",
    "Sweep": "estlab.api.sweeping",
    "Streams": "estlab.maths.streams",
    "Uniform": "estlab.maths.uniform",
    "UserError": "estlab.errors",
    "compare": "estlab.api.comparing",
    "estimate": "estlab.api.estimation",
    "load": "estlab.api.finding",
    "make_filter": "estlab.api.estimation",
    "run": "estlab.api.running",
    "runs": "estlab.api.finding",
    "sweep": "estlab.api.sweeping",
}
_MODULES = ("errors",)

__all__ = [
    "EstlabError",
    "Filter",
    "FilterEstimates",
    "Gaussian",
    "Motion",
    "Run",
    "Sensor",
    "Space",
    "Streams",
    "Sweep",
    "Uniform",
    "UserError",
    "__version__",
    "compare",
    "errors",
    "estimate",
    "load",
    "make_filter",
    "run",
    "runs",
    "sweep",
]


if not TYPE_CHECKING:  # a type checker knows what there is, and says what there is not

    def __getattr__(name: str) -> Any:
        if name in _MODULES:
            return importlib.import_module(f"estlab.{name}")
        if name not in _HOMES:
            raise AttributeError(f"module 'estlab' has no attribute {name!r}")
        found = getattr(importlib.import_module(_HOMES[name]), name)
        globals()[name] = found
        return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
