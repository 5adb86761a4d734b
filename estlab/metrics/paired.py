"""Compares filters on the same truth and readings: the difference of their errors, run by run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np

from estlab.maths.space import Array, Space
from estlab.metrics.intervals import LEVEL, Estimate, holm, judged_at, mean_interval, share_interval, t_test, widened
from estlab.metrics.moments import SampleMoments
from estlab.metrics.scores import has_whole, quietly

_TOGETHER = ("position_square", "state_square")


@dataclass
class Comparison:
    """Moments over runs of the mean square errors of two filters jointly, for every pair and component.

    The comparison is paired, because all filters meet the same truth and readings: difficulties common to both
    cancel. A run in which one filter broke (infinite) enters no mean and counts as lost by that filter. wins, met:
    runs won by the first, and their total.
    """

    space: Space
    repeated: bool = False
    moments: dict[tuple[str, str], SampleMoments] = field(default_factory=dict)
    wins: dict[tuple[str, str], Array] = field(default_factory=dict)
    met: dict[tuple[str, str], Array] = field(default_factory=dict)

    @property
    def components(self) -> tuple[str, ...]:
        """What is compared: each component, the position and all jointly, where these exist."""
        position, whole = ("position",) * bool(self.space.position), ("all",) * has_whole(self.space)
        return (*self.space.names, *position, *whole)

    def add(self, squares: Mapping[str, Mapping[str, Array]]) -> None:
        """Add a block, once: each filter's mean square errors, as Tally.add returns them."""
        stacked = {
            name: np.concatenate([one["mean_square"], *(one[key][None] for key in _TOGETHER if key in one)])
            for name, one in squares.items()
        }
        for a, b in combinations(sorted(stacked), 2):
            both = np.stack([stacked[a], stacked[b]])
            known = ~np.isnan(both).any(axis=0)
            # Half a win each for a tie.
            better, equal = known & (both[0] < both[1]), known & (both[0] == both[1])
            self.wins[a, b] = better.sum(axis=-1) + 0.5 * equal.sum(axis=-1)
            self.met[a, b] = known.sum(axis=-1)
            self.moments[a, b] = SampleMoments.of(both)

    def plus(self, other: "Comparison") -> "Comparison":
        """The runs of both."""
        return replace(
            self,
            moments={pair: moments.plus(other.moments[pair]) for pair, moments in self.moments.items()},
            wins={pair: wins + other.wins[pair] for pair, wins in self.wins.items()},
            met={pair: met + other.met[pair] for pair, met in self.met.items()},
        )

    @quietly
    def rows(self, cost: Mapping[str, float]) -> list[dict[str, Any]]:
        """A line for each pair and component: the RMSE of both, their difference, the share of runs that each wins,
        and the cost.

        cost: seconds per run and step of each filter. p-values are adjusted for the number of pairs (Holm), and each
        interval has the level at which that method judges it: it excludes zero exactly where a difference is
        significant.
        """
        rows: list[dict[str, Any]] = []
        for i, component in enumerate(self.components):
            pairs = list(self.moments)
            tests = [self._difference(pair, i) for pair in pairs]
            p_values = np.array([p for _, p in tests])
            adjusted = zip(holm(p_values), judged_at(p_values), strict=True)
            for (a, b), (unadjusted, p), (fair, level) in zip(pairs, tests, adjusted, strict=True):
                difference = widened(unadjusted, level) if np.isfinite(level) else unadjusted
                moments = self.moments[a, b].at(i)
                n = int(moments.count)
                roots = np.sqrt(moments.mean) if n else np.full(2, np.nan)
                met = int(self.met[a, b][i])
                share = float(self.wins[a, b][i]) / met if met else np.nan
                wins = share_interval(share, 0 if self.repeated else met)
                rows.append(
                    {
                        "filter": a,
                        "against": b,
                        "component": component,
                        "unit": self._units[i],
                        "rmse": float(roots[0]),
                        "rmse_against": float(roots[1]),
                        "difference": difference.value,
                        "ci_low": difference.low,
                        "ci_high": difference.high,
                        "p": p,
                        "p_holm": float(fair),
                        "wins": share,
                        "wins_low": wins.low,
                        "wins_high": wins.high,
                        "n": n,
                        "real": bool(fair < LEVEL),
                        "cost_ratio": cost[a] / cost[b] if cost.get(a) and cost.get(b) else np.nan,
                    }
                )
        return rows

    def _difference(self, pair: tuple[str, str], component: int) -> tuple[Estimate, float]:
        """RMSE of the first minus that of the second, by the delta method, and the p-value of no difference."""
        moments = self.moments[pair].at(component)
        roots = np.sqrt(moments.mean)
        value, n = float(roots[0] - roots[1]), int(moments.count)
        if self.repeated or n < 2:
            return Estimate(value if n else np.nan, np.nan, np.nan, n), np.nan
        # Sums in a fixed order: equal filters differ by exactly nothing, whichever linear algebra is installed.
        first, second = 0.5 / roots
        scatter = moments.scatter
        spread = first * first * scatter[0, 0] - 2.0 * first * second * scatter[0, 1] + second * second * scatter[1, 1]
        line = SampleMoments(moments.count, np.array([value]), np.array([[max(spread, 0.0)]]))
        return mean_interval(line), t_test(line, 0.0)

    @property
    def _units(self) -> tuple[str, ...]:
        position = (self.space.units[i] for i in self.space.position[:1])
        return (*self.space.units, *position, *self.space.units[: has_whole(self.space)])


def against_best(rows: Sequence[Mapping[str, Any]], component: str) -> list[dict[str, Any]]:
    """Each filter against the one with the smallest RMSE in a component, best first; the best has no difference.

    A filter that broke in some runs ranks behind those that did not: its remaining runs may be the easy ones.
    """
    chosen = [dict(row) for row in rows if row["component"] == component]
    rmse: dict[str, float] = {}
    runs: dict[str, int] = {}
    for row in sorted(chosen, key=lambda row: int(row["n"])):  # the sums kept cover the most runs
        rmse |= {row["filter"]: row["rmse"], row["against"]: row["rmse_against"]}
        runs |= {row["filter"]: row["n"], row["against"]: row["n"]}
    order = sorted(rmse, key=lambda name: (np.isnan(rmse[name]), -runs[name], rmse[name]))
    found: list[dict[str, Any]] = [{"filter": order[0], "rmse": rmse[order[0]], "unit": chosen[0]["unit"]}]
    for name in order[1:]:
        row = next(row for row in chosen if {row["filter"], row["against"]} == {name, order[0]})
        found.append(row if row["filter"] == name else _turned(row))
    return found


def _turned(row: Mapping[str, Any]) -> dict[str, Any]:
    """The same line with the filters exchanged."""
    return dict(row) | {
        "filter": row["against"],
        "against": row["filter"],
        "rmse": row["rmse_against"],
        "rmse_against": row["rmse"],
        "difference": -row["difference"],
        "ci_low": -row["ci_high"],
        "ci_high": -row["ci_low"],
        "wins": 1.0 - row["wins"],
        "wins_low": 1.0 - row["wins_high"],
        "wins_high": 1.0 - row["wins_low"],
        "cost_ratio": 1.0 / row["cost_ratio"],
    }
