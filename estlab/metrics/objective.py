"""What a tuning minimises, read from the rows of metrics.csv."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estlab.metrics.vocabulary import heading, unit_of

_OF_ALL = {"nis": "anis", "nees": "anees", "loglik": "loglik"}
_BROKEN = ("not_finite", "not_definite")


@dataclass(frozen=True)
class Objective:
    """A metric of a component, of one filter; of the first filter if none is named.

    nis and nees: |log| of the mean over its expectation, so that half and twice are equally bad and 0 is best. rmse:
    the value itself. loglik: its negative.
    """

    name: str
    component: str
    filter: str

    @classmethod
    def parse(cls, text: str) -> "Objective":
        """Read nis, nees, loglik or rmse:<component>, each optionally followed by :<filter>.

        Raises ValueError for anything else.
        """
        name, *rest = text.split(":")
        if name == "rmse" and 1 <= len(rest) <= 2 and all(rest):
            return cls(name, rest[0], "".join(rest[1:]))
        if name in _OF_ALL and len(rest) <= 1 and all(rest):
            return cls(name, "all", "".join(rest))
        raise ValueError(
            f"objective must be {', '.join(_OF_ALL)} or rmse:<component>, followed by :<filter> to choose "
            f"one of several, got {text}"
        )

    @property
    def words(self) -> str:
        """The objective, as an axis names it."""
        metric = _OF_ALL.get(self.name, self.name)
        named = heading(metric, self.component, unit_of(metric))
        words = {"rmse": named, "loglik": f"minus {named}"}.get(self.name, f"|log({named})|")
        return f"{words}, {self.filter}" if self.filter else words

    def of(self, rows: Sequence[Mapping[str, str]], lost: float) -> float:
        """The number, from rows of text. Infinite if more than a share ``lost`` of the runs broke.

        The means leave such runs out, which would make a filter look better the sooner it breaks. Raises ValueError
        that says what is missing if there is no such number.
        """
        filter = self.filter or (rows[0]["filter"] if rows else "")
        mine = {(row["metric"], row["component"]): row for row in rows if row["filter"] == filter}
        metric = _OF_ALL.get(self.name, self.name)
        if (metric, self.component) not in mine:
            raise ValueError(f"there is no {metric} {self.component} of {filter or 'any filter'}")
        broken = [mine[cause, "all"] for cause in _BROKEN if (cause, "all") in mine]
        if sum(float(row["value"]) for row in broken) > lost * max((int(row["n"]) for row in broken), default=0):
            return math.inf
        value = float(mine[metric, self.component]["value"] or "nan")
        if math.isnan(value) or (self.name in ("nis", "nees") and value <= 0.0):
            raise ValueError(f"{metric} {self.component} of {filter} is not a number to compare")
        return {"rmse": value, "loglik": -value}.get(self.name, abs(math.log(value)) if value > 0.0 else math.inf)
