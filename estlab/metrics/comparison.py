"""Filters against each other on the same truth and readings: the difference of their errors, run by run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from estlab.maths.space import Array, Space
from estlab.metrics.intervals import Estimate, holm, mean_interval, share_interval, t_test
from estlab.metrics.moments import Moments
from estlab.metrics.scores import quietly

LEVEL = 0.05


@dataclass
class Comparison:
    """Moments over runs of the mean square errors of two filters together, for every pair and component.

    Paired, since all filters meet the same truth and readings: what makes a run hard for both cancels.
    """

    space: Space
    repeated: bool = False
    moments: dict[tuple[str, str], Moments] = field(default_factory=dict)
    wins: dict[tuple[str, str], Array] = field(default_factory=dict)

    @property
    def components(self) -> tuple[str, ...]:
        """What is compared: each component, and the position if there is one."""
        return (*self.space.names, *(("position",) if self.space.position else ()))

    def add(self, squares: Mapping[str, Mapping[str, Array]]) -> None:
        """Take in a block: each filter's mean square errors, as Tally.add returns them."""
        stacked = {
            name: np.concatenate(
                [one["mean_square"], *([one["position_square"][None]] if "position_square" in one else [])]
            )
            for name, one in squares.items()
        }
        for a, b in combinations(sorted(stacked), 2):
            both = np.stack([stacked[a], stacked[b]])
            block = Moments.of(both)
            known = np.isfinite(both).all(axis=0)
            # Half a win each where there is nothing between them.
            won = np.where(known, 0.5 * (both[0] < both[1]) + 0.5 * (both[0] <= both[1]), 0.0).sum(axis=-1)
            self.moments[a, b] = self.moments[a, b].plus(block) if (a, b) in self.moments else block
            self.wins[a, b] = self.wins.get((a, b), 0.0) + won

    @quietly
    def rows(self, cost: Mapping[str, float]) -> list[dict[str, Any]]:
        """A line for each pair and component: the RMSE of both, their difference, who wins how often, and the cost.

        cost: seconds a run and step of each filter. p-values are adjusted for the number of pairs (Holm).
        """
        rows: list[dict[str, Any]] = []
        for i, component in enumerate(self.components):
            pairs = list(self.moments)
            tests = [self._difference(pair, i) for pair in pairs]
            adjusted = holm(np.array([p for _, p in tests]))
            for (a, b), (difference, p), fair in zip(pairs, tests, adjusted, strict=True):
                moments = self.moments[a, b].at(i)
                n = int(moments.count)
                roots = np.sqrt(moments.mean) if n else np.full(2, np.nan)
                wins = share_interval(float(self.wins[a, b][i]) / n if n else np.nan, 0 if self.repeated else n)
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
                        "wins": float(self.wins[a, b][i]) / n if n else np.nan,
                        "wins_low": wins.low,
                        "wins_high": wins.high,
                        "n": n,
                        "real": bool(fair < LEVEL),
                        "cost_ratio": cost[a] / cost[b] if cost.get(a) and cost.get(b) else np.nan,
                    }
                )
        return rows

    def _difference(self, pair: tuple[str, str], component: int) -> tuple[Estimate, float]:
        """RMSE of the first less that of the second, by the delta method, and the p-value of there being none."""
        moments = self.moments[pair].at(component)
        roots = np.sqrt(moments.mean)
        value, n = float(roots[0] - roots[1]), int(moments.count)
        if self.repeated or n < 2:
            return Estimate(value if n else np.nan, np.nan, np.nan, n), np.nan
        slope = np.array([0.5, -0.5]) / roots
        line = Moments(moments.count, np.array([value]), (slope @ moments.scatter @ slope)[None, None])
        return mean_interval(line), t_test(line, 0.0)

    @property
    def _units(self) -> tuple[str, ...]:
        return (*self.space.units, *(self.space.units[i] for i in self.space.position[:1]))


def against_best(rows: Sequence[Mapping[str, Any]], component: str) -> list[dict[str, Any]]:
    """Each filter against the one with the smallest RMSE in a component, best first; the best has no difference."""
    chosen = [dict(row) for row in rows if row["component"] == component]
    rmse: dict[str, float] = {}
    for row in chosen:
        rmse |= {row["filter"]: row["rmse"], row["against"]: row["rmse_against"]}
    order = sorted(rmse, key=lambda name: (np.isnan(rmse[name]), rmse[name]))
    found: list[dict[str, Any]] = [{"filter": order[0], "rmse": rmse[order[0]], "unit": chosen[0]["unit"]}]
    for name in order[1:]:
        row = next(row for row in chosen if {row["filter"], row["against"]} == {name, order[0]})
        found.append(row if row["filter"] == name else _turned(row))
    return found


def _turned(row: Mapping[str, Any]) -> dict[str, Any]:
    """The same line told of the other filter."""
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
