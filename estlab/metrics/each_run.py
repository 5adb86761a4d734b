"""The results of each of the first runs: to find the worst run, and to compare filters run by run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estlab.maths.space import Array, Space
from estlab.metrics.scores import quietly
from estlab.record import Record

MOST = 5000  # runs, about 1 MB of text for each filter


@dataclass
class EachRun:
    """RMSE of each component and the position, and NEES / n, for each of the first runs and each filter.

    truth_mark and readings_mark are the root mean squares of all truth and readings of a run. Two runs made
    separately with the same marks had the same truth and readings.
    """

    space: Space
    runs: dict[str, Array] = field(default_factory=dict)
    answers: dict[str, dict[str, Array]] = field(default_factory=dict)

    @quietly
    def add(
        self, record: Record, squares: Mapping[str, Mapping[str, Array]], numbers: Sequence[int], begin: int
    ) -> None:
        """Add a block of runs with these numbers, once: each filter's mean squares, as Tally.add returns them.

        begin: the number of the ensemble's first run.
        """
        room = max(0, begin + MOST - numbers[0])
        marks = {"truth_mark": _mark(record.truth), "readings_mark": _mark(record.readings.values)}
        shared = {"run": np.asarray(numbers), **marks}
        self.runs = {name: np.broadcast_to(array, len(numbers))[:room] for name, array in shared.items()}
        for filter, one in squares.items():
            names = (f"rmse.{name}" for name in self.space.names)
            answers = dict(zip(names, np.sqrt(one["mean_square"]), strict=True))
            if "position_square" in one:
                answers["rmse.position"] = np.sqrt(one["position_square"])
            if "state_square" in one:
                answers["rmse.all"] = np.sqrt(one["state_square"])
            answers["anees"] = one["anees"]
            self.answers[filter] = {name: array[:room] for name, array in answers.items()}

    def plus(self, other: "EachRun") -> "EachRun":
        """The runs of both; those of the other come after."""
        answers = {filter: _joined(mine, other.answers[filter]) for filter, mine in self.answers.items()}
        return replace(self, runs=_joined(self.runs, other.runs), answers=answers)

    def columns(self, filter: str) -> dict[str, Array]:
        """The columns of a filter's table, one line per run."""
        return self.runs | self.answers[filter]


def _joined(first: Mapping[str, Array], second: Mapping[str, Array]) -> dict[str, Array]:
    return {name: np.concatenate([array, second[name]]) for name, array in first.items()}


def _mark(values: Array) -> Array:
    """(runs,) the root mean square of the finite numbers in (m, N, runs); 0 if there are none."""
    known = np.isfinite(values)
    total = np.where(known, values, 0.0) ** 2
    return np.sqrt(total.sum(axis=(0, 1)) / np.maximum(known.sum(axis=(0, 1)), 1))
