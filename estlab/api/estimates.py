"""A filter's estimates, as arrays with named components."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from estlab.config.build import nearest
from estlab.errors import UserError
from estlab.maths.space import Array, Space

if TYPE_CHECKING:
    from xarray import Dataset


@dataclass(frozen=True)
class Component:
    """One component of a state over time.

    mean, sd, truth, error: (T, runs), or (T,) if the estimates have no axis of runs, in ``unit``. truth and error are
    NaN where the truth is unknown. error is the estimate minus the truth, for an angle the short way round.
    """

    name: str
    unit: str
    mean: Array
    sd: Array
    truth: Array
    error: Array


@dataclass(frozen=True)
class FilterEstimates:
    """A filter's estimates over time, and the truth where it is known.

    n components, T times, and runs last; estimates from readings without an axis of runs have none either.

    space: names, units and angles of the components.
    time: (T,) [s].
    mean: (n, T, runs). cov: (n, n, T, runs). NaN from where a run diverged.
    truth: (n, T, runs), NaN where it is unknown.
    run: (runs,) the number of each run.
    nis: (T, runs) normalised innovation squared of the reading at each time, a chi-square of m degrees of freedom for a
    consistent filter; NaN where there was no reading. None for estimates that were read from a run directory.

    >>> import numpy as np
    >>> from estlab import FilterEstimates, Space
    >>> space = Space(("height", "speed"), ("m", "m/s"))
    >>> mean, cov = np.array([[1.0, 2.0], [0.5, 0.5]]), np.full((2, 2, 2), 0.25)
    >>> found = FilterEstimates(space, np.array([0.0, 0.1]), mean, cov, mean - 0.1, np.array([0]))
    >>> found
    FilterEstimates(height [m], speed [m/s]; 2 times)
    >>> found["height"].mean
    array([1., 2.])
    >>> found["height"].sd
    array([0.5, 0.5])
    >>> found["height"].error.round(3)
    array([0.1, 0.1])
    """

    space: Space
    time: Array
    mean: Array
    cov: Array
    truth: Array
    run: Array
    nis: Array | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the n components."""
        return self.space.names

    @property
    def units(self) -> tuple[str, ...]:
        """Their units."""
        return self.space.units

    @cached_property
    def sd(self) -> Array:
        """Standard deviations (n, T, runs)."""
        with np.errstate(invalid="ignore"):
            return np.sqrt(np.einsum("ii...->i...", self.cov))

    @cached_property
    def error(self) -> Array:
        """The estimate minus the truth (n, T, runs), angles the short way round; NaN where the truth is unknown."""
        return self.space.minus(self.mean, self.truth)

    def __getitem__(self, name: str) -> Component:
        """A component by its name. Raises UserError for an unknown one."""
        if name not in self.names:
            raise UserError(
                f"there is no component {name}{nearest(str(name), self.names)} (one of {', '.join(self.names)})"
            )
        i = self.names.index(name)
        return Component(name, self.units[i], self.mean[i], self.sd[i], self.truth[i], self.error[i])

    def to_xarray(self) -> "Dataset":
        """The same as an xarray Dataset with named dimensions: component, component_, time, run.

        Raises UserError where xarray is not installed.
        """
        try:
            from xarray import Dataset
        except ImportError as error:
            raise UserError("to_xarray needs xarray: pip install xarray") from error
        runs = ("run",) * (self.mean.ndim - 2)
        arrays = {
            "mean": (("component", "time", *runs), self.mean),
            "cov": (("component", "component_", "time", *runs), self.cov),
            "truth": (("component", "time", *runs), self.truth),
        }
        if self.nis is not None:
            arrays["nis"] = (("time", *runs), self.nis)
        names = list(self.names)
        coordinates: dict[str, Any] = {"component": names, "component_": names, "unit": ("component", list(self.units))}
        coordinates |= {"time": ("time", self.time, {"units": "s"})} | ({"run": self.run} if runs else {})
        return Dataset(arrays, coordinates)

    def __repr__(self) -> str:
        components = ", ".join(f"{name} [{unit}]" for name, unit in zip(self.names, self.units, strict=True))
        runs = f", {self.mean.shape[2]} runs" if self.mean.ndim > 2 else ""
        return f"FilterEstimates({components}; {self.time.size} times{runs})"


def of_arrays(space: Space, arrays: Mapping[str, Array], name: str) -> FilterEstimates:
    """A filter's estimates from the arrays of estimates.npz; those of a single filter have no prefix."""
    prefix = f"{name}." if f"{name}.mean" in arrays else ""
    mean, cov = arrays[f"{prefix}mean"], arrays[f"{prefix}cov"]
    return FilterEstimates(space, arrays["time"], mean, cov, arrays["truth"], arrays["run"])
