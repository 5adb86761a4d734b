"""The runs that are kept whole: as the arrays of estimates.npz, and one of them as a scenario draws it."""

from collections.abc import Sequence

import numpy as np

from estlab.experiment.monte_carlo import Ensemble
from estlab.maths.space import Array
from estlab.report.palette import colours
from estlab.scenarios.scenario import History


def histories_of(ensemble: Ensemble, first: int) -> dict[str, Array]:
    """The arrays of estimates.npz: complete runs, from the first on, without readings that none of them has.

    mean and cov for one filter, <filter>.mean and <filter>.cov for several; for a particle filter also a sample of
    the cloud at some steps, cloud.step (K,), cloud.points (n, K, S, runs) and cloud.weights (K, S, runs).
    """
    readings, record = ensemble.record.readings, ensemble.record
    count = next(iter(ensemble.kept.values()))["truth"].shape[2]
    taken = np.isfinite(readings.values[:, :, :count]).any(axis=(0, 2))
    arrays = {
        "run": np.arange(first, first + count),
        "time": record.time,
        "truth": record.truth[:, :, :count],
        "step": readings.step[taken],
        "values": readings.values[:, taken, :count],
        "target": readings.landmark_number[taken, :count],
        "places": record.landmarks,
    }
    for name, kept in ensemble.kept.items():
        prefix = f"{name}." if len(ensemble.kept) > 1 else ""
        arrays |= {f"{prefix}{key}": array for key, array in kept.items() if key != "truth"}
    sums = {} if ensemble.failure else ensemble.total.sums
    return arrays | {f"shown.{name}": array for name, array in (record.extra | sums).items()}


def history_of(arrays: dict[str, Array], name: str, filters: Sequence[str], row: int = 0) -> History:
    """The run of one of the filters at a place among those kept, from the arrays of estimates.npz."""
    prefix = f"{name}." if len(filters) > 1 else ""
    extra = {key.removeprefix("shown."): array for key, array in arrays.items() if key.startswith("shown.")}
    return History(
        time=arrays["time"],
        truth=arrays["truth"][..., row],
        mean=arrays[f"{prefix}mean"][..., row],
        cov=arrays[f"{prefix}cov"][..., row],
        step=arrays["step"],
        values=arrays["values"][..., row],
        landmark_number=arrays["target"][..., row],
        landmarks=arrays["places"],
        extra=extra,
        run=int(arrays["run"][row]),
        colour=colours(filters)[name],
    )
