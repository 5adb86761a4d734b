"""A radar's range and bearing in Cartesian coordinates. Seed document 000, problem II.

One step without readings: the prior is Gaussian in range and bearing, and the motion is the change of coordinates. Each
filter's prediction is its transform; there is nothing to update with.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from estlab.maths.gaussian_belief import Gaussian, ellipses
from estlab.maths.space import Array, Space
from estlab.maths.streams import Streams
from estlab.models import polar
from estlab.models.contract import Motion, Sensor
from estlab.record import Record
from estlab.scenarios import simulation
from estlab.scenarios.scenario import History, Scales, Scenario, check_positive, diagonal_cov

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SHOWN = 3000  # samples to draw: enough to show their shape
_INSTEAD = "set scenario.distance_sd or scenario.bearing_sd"
_MARKERS = "osDv^P*h"


@dataclass(frozen=True)
class Radar(Scenario):
    """A position measured once by range and bearing, in Cartesian coordinates.

    particles: the number for filter=pf, unless you set it.
    """

    case: Literal["i", "ii"]
    distance: float
    bearing: float
    distance_sd: float
    bearing_sd: dict[str, float]
    particles: int

    def __post_init__(self) -> None:
        check_positive(distance=self.distance, distance_sd=self.distance_sd, particles=self.particles)
        if set(self.bearing_sd) != {"i", "ii"}:
            raise ValueError(f"bearing_sd must have the keys i and ii, got {', '.join(self.bearing_sd)}")
        check_positive(**{f"bearing_sd.{case}": sd for case, sd in self.bearing_sd.items()})

    def unread(self, source: Literal["simulated", "files"]) -> dict[str, str]:
        other = "ii" if self.case == "i" else "i"
        return {f"bearing_sd.{other}": f"scenario.case={other}"} | super().unread(source)

    @property
    def space(self) -> Space:
        return polar.PLACE

    @property
    def exact(self) -> Gaussian:
        """Mean (2,) and covariance (2, 2) of the position, in closed form."""
        return polar.exact_moments(self.distance, self.bearing, self.distance_sd, self.bearing_sd[self.case])

    def motion(self, noise: Scales) -> Motion:
        simulation.refuse_scales(noise, _INSTEAD)
        return Motion(polar.PLACE, polar.place, simulation.no_cov, 0, polar.place_jacobians, polar.place_hessians)

    def sensor(self, noise: Scales, landmarks: Array) -> Sensor:
        return simulation.no_sensor(polar.PLACE)

    def simulate(self, streams: Streams, runs: Sequence[int], noise: Scales) -> Record:
        sds = [self.distance_sd, self.bearing_sd[self.case]]
        prior = Gaussian(np.array([[self.distance], [self.bearing]]), diagonal_cov(sds))
        record = simulation.one_prediction(streams, runs, self.motion(noise), prior)
        # About the exact mean, so that sums of squares over millions of samples lose no digits.
        off = record.truth[:, 0] - self.exact.mean[:, None]
        sums = {"count": np.array(len(runs)), "first": off.sum(axis=1), "second": off @ off.T}
        return replace(record, extra={"samples": record.truth[:, 0, :_SHOWN]}, sums=sums)

    def table(self, histories: dict[str, History]) -> dict[str, list[Any]]:
        rows = {name: Gaussian(h.mean[:, -1], h.cov[:, :, -1]) for name, h in histories.items()}
        extra = next(iter(histories.values())).extra
        rows |= {"exact": self.exact, "samples": _sample_moments(extra, self.exact.mean)}
        return {
            "transform": list(rows),
            "mean x [m]": [float(row.mean[0]) for row in rows.values()],
            "mean y [m]": [float(row.mean[1]) for row in rows.values()],
            "Pxx [m^2]": [float(row.cov[0, 0]) for row in rows.values()],
            "Pxy [m^2]": [float(row.cov[0, 1]) for row in rows.values()],
            "Pyy [m^2]": [float(row.cov[1, 1]) for row in rows.values()],
        }

    def pictures(self, histories: dict[str, History]) -> "dict[str, Figure]":
        from matplotlib.figure import Figure

        extra = next(iter(histories.values())).extra
        colours = [history.colour for history in histories.values()]
        beliefs = {name: Gaussian(h.mean[:, -1], h.cov[:, :, -1]) for name, h in histories.items()}
        figure = Figure(figsize=(10.0, 7.6), layout="constrained")
        whole, near = figure.subplots(1, 2)
        of = f"{extra['samples'].shape[1]} of {int(extra['count'])} samples"
        whole.plot(*extra["samples"], ".", color="0.75", ms=2, zorder=0, label=of)
        for axes, size in ((whole, 4.0), (near, 8.0)):
            _draw_beliefs(axes, {"exact": self.exact} | beliefs, ["black", *colours], size)
            axes.set_xlabel("x [m]")
            axes.set_ylabel("y [m]")
            axes.grid(alpha=0.3)
        whole.set_title("samples, means and 3-sigma ellipses")
        whole.set_aspect("equal", adjustable="datalim")
        near.set_title("the means, close up")
        _zoom(near, self.exact.mean, np.stack([belief.mean for belief in beliefs.values()], axis=1))
        degrees = np.degrees(self.bearing_sd[self.case])
        figure.suptitle(
            f"radar, case {self.case} · sd of the bearing {degrees:.3g}°, of the range {self.distance_sd:g} m"
        )
        handles, labels = whole.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False)
        return {"transform.png": figure}


def _sample_moments(extra: dict[str, Array], about: Array) -> Gaussian:
    """Mean and unbiased covariance from sums about a point; no covariance for a single sample."""
    count, shift = int(extra["count"]), extra["first"] / extra["count"]
    free = count - 1 if count > 1 else np.nan
    return Gaussian(about + shift, (extra["second"] - count * np.outer(shift, shift)) / free)


def _draw_beliefs(axes: "Axes", beliefs: dict[str, Gaussian], colours: Sequence[str], size: float) -> None:
    """Means and ellipses, the first filled black. Coinciding ones stay visible: each ring is wider than the next,
    is, each marker smaller than the next.
    """
    for i, ((name, belief), colour) in enumerate(zip(beliefs.items(), colours, strict=True)):
        marker = "o" if i == 0 else _MARKERS[(i - 1) % len(_MARKERS)]
        width = 0.9 + 2.3 * (1.0 - i / len(beliefs))
        outline = ellipses(belief.mean[:, None], belief.cov[:, :, None])[..., 0]
        axes.plot(*outline, color=colour, lw=width)
        face = "black" if i == 0 else "none"
        grown = size * (0.6 if i == 0 else 1.0 + 0.35 * (i - 1))
        axes.plot(*belief.mean[:, None], marker, color=colour, mfc=face, mew=1.4, ms=grown)
        # A single legend entry for both.
        axes.plot([], [], marker=marker, color=colour, mfc=face, mew=1.4, ms=6, lw=width, label=name)


def _zoom(axes: "Axes", centre: Array, means: Array) -> None:
    """The square about a centre that contains all means (2, N) with a margin."""
    half = 1.3 * max(float(np.abs(means - centre[:, None]).max()), 1e-6)
    axes.set_xlim(centre[0] - half, centre[0] + half)
    axes.set_ylim(centre[1] - half, centre[1] + half)
    axes.set_aspect("equal", adjustable="box")
    axes.ticklabel_format(useOffset=False)
    axes.tick_params(axis="x", rotation=30)
