"""What each of the first runs answers, one by one: which was the worst, and how it did in another filter's hands."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estlab.maths.space import Array, Space
from estlab.metrics.scores import quietly
from estlab.record import Record

MOST = 5000  # runs, about 1 MB of text a filter


@dataclass
class EachRun:
    """RMSE of each component and the position, and NEES / n, of each of the first runs and for each filter.

    truth_mark and readings_mark are the root mean squares of all that a run's truth and readings hold. They mean
    nothing, but two runs made apart that have the same marks met the same truth and readings.
    """

    space: Space
    runs: dict[str, Array] = field(default_factory=dict)
    answers: dict[str, dict[str, Array]] = field(default_factory=dict)

    @quietly
    def add(
        self, record: Record, squares: Mapping[str, Mapping[str, Array]], numbers: Sequence[int], begin: int
    ) -> None:
        """Take in a block of runs with these numbers, once: each filter's mean squares, as Tally.add returns them.

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
        """Of the runs of both, those of the other coming after."""
        answers = {filter: _joined(mine, other.answers[filter]) for filter, mine in self.answers.items()}
        return replace(self, runs=_joined(self.runs, other.runs), answers=answers)

    def columns(self, filter: str) -> dict[str, Array]:
        """The columns of a filter's table, a line a run."""
        return self.runs | self.answers[filter]


def _joined(first: Mapping[str, Array], second: Mapping[str, Array]) -> dict[str, Array]:
    return {name: np.concatenate([array, second[name]]) for name, array in first.items()}


def _mark(values: Array) -> Array:
    """(runs,) the root mean square of what is finite in (m, N, runs); 0 where nothing is."""
    known = np.isfinite(values)
    total = np.where(known, values, 0.0) ** 2
    return np.sqrt(total.sum(axis=(0, 1)) / np.maximum(known.sum(axis=(0, 1)), 1))
