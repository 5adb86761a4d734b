"""What a run is expected to find, and whether it did.

An expectation is a path, ``<metric>[.<filter>][.<component>]`` with filter and component in either order, and the
allowed values there in metrics.csv. Without a filter it applies to each; without a component, to the metric's only one
or the one called ``all``. A cell of a problem's own table is ``table.<column>.<row>``: the row by the content of its
first column, the column with or without its unit. A value that is missing or NaN meets no expectation.
Values are compared to twelve digits, so a share of time that is one except for the last bit is one.
"""

import math
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

from estlab.config.build import nearest
from estlab.errors import UserError
from estlab.metrics.digits import bracket
from estlab.metrics.verdict import WORDS

_Row = Mapping[str, Any]

VERDICT, TABLE = "verdict", "table"

# These have no row in metrics.csv if nothing was counted.
_COUNTED = ("gated", "vanished")
_ALL = "all"
_SLACK = 1e-12
_NAMED = 4  # metrics to name if the wrong name resembles none


@dataclass(frozen=True)
class Bounds:
    """From low to high, both included; either may be infinite."""

    low: float
    high: float

    def admit(self, value: float) -> bool:
        low, high = self.low - _SLACK * abs(self.low), self.high + _SLACK * abs(self.high)
        return low <= value <= high

    def __str__(self) -> str:
        if self.low == self.high:
            return f"{self.low:.10g}"
        if math.isinf(self.high):
            return f"at least {self.low:.10g}"
        return f"at most {self.high:.10g}" if math.isinf(self.low) else f"{self.low:.10g} to {self.high:.10g}"


@dataclass(frozen=True)
class Words:
    """Any of these."""

    allowed: tuple[str, ...]

    def __str__(self) -> str:
        return " or ".join(self.allowed)


@dataclass(frozen=True)
class Expectation:
    """The allowed values of a metric, for each filter if none is named; or of a cell of the problem's own table."""

    metric: str
    filter: str | None
    component: str | None
    allowed: Bounds | Words
    row: str | None = None

    @property
    def what(self) -> str:
        """The path without the filter."""
        return ".".join(filter(None, (self.metric, self.component, self.row)))


@dataclass(frozen=True)
class Finding:
    """An expectation checked for one filter. value: in full, a word for a verdict, and NaN if nothing was found."""

    filter: str
    what: str
    expected: str
    found: str
    met: bool
    value: float | str = math.nan
    low: float = math.nan
    high: float = math.nan

    def cells(self) -> tuple[str, ...]:
        """A line of a table: filter, what, expected, found with its interval, ok or FAILED."""
        outcome = "ok" if self.met else "FAILED"
        return self.filter, self.what, self.expected, self.found + bracket(self.low, self.high), outcome


def parse(expect: Any, filters: Sequence[str]) -> list[Expectation]:
    """The expectations that an ``expect`` block states, for a run with these filters.

    Raises UserError for one that cannot be checked, and for an unknown filter or verdict.
    """
    if expect is None:
        return []
    if not isinstance(expect, Mapping):
        raise UserError(f"expect must be a group, as in expect.rmse.x=[0.1,0.2], or null for none; got {expect!r}")
    return [_expectation(path, leaf, filters) for path, leaf in _leaves(expect, ())]


def of_recording(sets: Any, digests: Sequence[str]) -> Any:
    """The expectations for a recording; none unless one of its files is known.

    sets: expectations by the first digits of a file's SHA-256. digests: of the files that were read.
    """
    return reduce(over, [own for key, own in _sets(sets).items() if any(one.startswith(key) for one in digests)], {})


def over(lower: Any, upper: Any) -> Any:
    """Two blocks of expectations merged: key by key the upper's, if it has one or says null for none."""
    if not (isinstance(upper, Mapping) and isinstance(lower, Mapping)):
        return lower if upper is None else upper
    return {**lower, **{key: value and over(lower.get(key), value) for key, value in upper.items()}}


def parse_sets(sets: Any, filters: Sequence[str]) -> None:
    """Raise UserError for expectations of recordings that cannot be checked."""
    for own in _sets(sets).values():
        parse(own, filters)


def check(
    expected: Sequence[Expectation],
    rows: Mapping[str, Sequence[_Row]],
    table: Mapping[str, Sequence[Any]] | None = None,
) -> list[Finding]:
    """Check each expectation against the rows of metrics.csv of each of its filters, or against the own table."""
    found = []
    for e in expected:
        names = [""] if e.metric == TABLE else [e.filter] if e.filter else rows
        found += [_cell(e, table or {}) if e.metric == TABLE else _find(e, name, rows) for name in names]
    return found


def unmet(findings: Sequence[Finding]) -> str:
    """One line that names the expectations not met; empty if all were."""
    failed = [finding for finding in findings if not finding.met]
    if not failed:
        return ""
    several = len({finding.filter for finding in findings}) > 1
    lines = []
    for finding in failed[:3]:
        found = finding.found if finding.found.startswith("not found") else f"found {finding.found}"
        whose = f" of {finding.filter}" if several and finding.filter else ""
        lines.append(f"{finding.what}{whose} expected {finding.expected}, {found}")
    lines += [f"and {len(failed) - 3} more"] * (len(failed) > 3)
    return f"{len(failed)} of {_counted(len(findings))} not met: {'; '.join(lines)}"


def columns(findings: Sequence[Finding]) -> dict[str, list[Any]]:
    """The columns of expectations.csv. found is in full, a word for a verdict, and the reason if nothing was found."""
    return {
        "filter": [f.filter for f in findings],
        "expectation": [f.what for f in findings],
        "expected": [f.expected for f in findings],
        "found": [f.found if f.value != f.value else f.value for f in findings],
        "ci_low": [f.low for f in findings],
        "ci_high": [f.high for f in findings],
        "met": [f.met for f in findings],
    }


def _sets(sets: Any) -> Mapping[str, Any]:
    if not isinstance(sets or {}, Mapping):
        raise UserError(f"expect_files must be a group, or null for none; got {sets!r}")
    by_digest = {str(key): own for key, own in (sets or {}).items()}
    for key in by_digest:
        if not re.fullmatch(r"[0-9a-f]{8,64}", key):
            raise UserError(f"expect_files takes 8 to 64 digits of a file's SHA-256 as keys, from run.json; got {key}")
    return by_digest


def _counted(count: int) -> str:
    return f"{count} expectation{'s' * (count != 1)}"


def _leaves(node: Mapping[Any, Any], path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """The block's statements, by path; null states nothing."""
    for key, value in node.items():
        here = (*path, str(key))
        bounds = isinstance(value, Mapping) and bool({"min", "max"} & set(value))
        if bounds and all(bound is None for bound in value.values()):
            continue
        if isinstance(value, Mapping) and not bounds:
            yield from _leaves(value, here)
        elif value is not None:
            yield here, value


def _expectation(path: tuple[str, ...], leaf: Any, filters: Sequence[str]) -> Expectation:
    key = ".".join(("expect", *path))
    metric, *names = path
    if metric == TABLE:
        if len(names) != 2:
            raise UserError(f"{key}: a cell of the table is expect.table.<column>.<row>")
        return Expectation(TABLE, None, names[0], _bounds(leaf, key), names[1])
    whose = next((name for name in names if name in filters), None)
    if whose is not None:
        names.remove(whose)
    if len(names) > (0 if metric == VERDICT else 1):
        near = next((near for name in names if (near := nearest(name, [*filters, "min", "max"]))), "")
        if whose is None:
            raise UserError(f"{key}: there is no filter {' or '.join(names)} here{near} (one of {', '.join(filters)})")
        raise UserError(f"{key}: {names[-1]} is one name too many{near}; write metric, filter and component")
    allowed = _words(leaf, key) if metric == VERDICT else _bounds(leaf, key)
    return Expectation(metric, whose, names[0] if names else None, allowed)


def _words(leaf: Any, key: str) -> Words:
    words = leaf if isinstance(leaf, list) and leaf else [leaf]
    for word in words:
        if word not in WORDS:
            raise UserError(f"{key} must be one of {', '.join(WORDS)}, got {word}{nearest(str(word), WORDS)}")
    return Words(tuple(words))


def _bounds(leaf: Any, key: str) -> Bounds:
    if isinstance(leaf, Mapping):
        for name in leaf:
            if name not in ("min", "max"):
                raise UserError(f"{key} takes only min and max, got {name}")
        low, high = leaf.get("min"), leaf.get("max")
    elif isinstance(leaf, list):
        low, high = leaf if len(leaf) == 2 else (leaf, leaf)
    else:
        low = high = leaf
    for bound in (low, high):
        number = isinstance(bound, int | float) and not isinstance(bound, bool) and abs(bound) <= sys.float_info.max
        if not (number or (bound is None and isinstance(leaf, Mapping))):
            raise UserError(f"{key} must be [low, high], min and max, or a number, got {leaf!r}")
    bounds = Bounds(-math.inf if low is None else float(low), math.inf if high is None else float(high))
    if bounds.low > bounds.high:
        raise UserError(f"{key}: write the lower bound first, got {leaf!r}")
    return bounds


def _find(expectation: Expectation, name: str, rows: Mapping[str, Sequence[_Row]]) -> Finding:
    """Check the expectation against the rows of one filter."""
    what, allowed = expectation.what, expectation.allowed
    found = {row["component"]: row for row in rows[name] if row["metric"] == expectation.metric}
    if isinstance(allowed, Words) and found:
        joined = " and ".join(found)
        return Finding(name, what, str(allowed), joined, set(found) <= set(allowed.allowed), joined)
    row = found.get(expectation.component or (_ALL if _ALL in found or len(found) != 1 else next(iter(found))))
    if row is None and expectation.metric in _COUNTED and expectation.component in (None, _ALL):
        row = {"value": 0, "ci_low": math.nan, "ci_high": math.nan}
    if row is None or isinstance(allowed, Words):
        remedy = _remedy(expectation, name, found, rows)
        return Finding(name, what, str(allowed), f"not found ({remedy})", False)
    value, low, high = (float(row[column]) for column in ("value", "ci_low", "ci_high"))
    return Finding(name, what, str(allowed), _shown(value, allowed), allowed.admit(value), value, low, high)


def _cell(expectation: Expectation, table: Mapping[str, Sequence[Any]]) -> Finding:
    """Check the expectation against a cell of the problem's own table."""
    what, allowed = expectation.what, expectation.allowed
    columns_of = {name.partition(" [")[0]: name for name in table} | {name: name for name in table}
    column = columns_of.get(str(expectation.component))
    labels = [str(label) for label in next(iter(table.values()), [])]
    if column is None or expectation.row not in labels:
        there = f"are columns {', '.join(table)}; rows {', '.join(labels)}" if table else "is no table"
        return Finding("", what, str(allowed), f"not found (there {there})", False)
    value = float(table[column][labels.index(expectation.row)])
    assert isinstance(allowed, Bounds)
    return Finding("", what, str(allowed), _shown(value, allowed), allowed.admit(value), value)


def _remedy(expectation: Expectation, name: str, found: Mapping[str, _Row], rows: Mapping[str, Sequence[_Row]]) -> str:
    """The nearest metric or component that exists, as a remedy."""
    if found:
        if expectation.component is None:
            return f"name one of {', '.join(found)}"
        return _near(expectation.component, [*found, *rows]) or f"there are {', '.join(found)}"
    having = [other for other in rows if any(row["metric"] == expectation.metric for row in rows[other])]
    if having:
        return f"{name} has no such metric; name {' or '.join(having)}"
    metrics = list(dict.fromkeys(row["metric"] for row in rows[name]))
    more = f" and {len(metrics) - _NAMED} more in metrics.csv" if len(metrics) > _NAMED else ""
    return _near(expectation.metric, metrics) or f"there are {', '.join(metrics[:_NAMED])}{more}"


def _near(name: str, known: Sequence[str]) -> str:
    return nearest(name, known).removeprefix("; ")


def _shown(value: float, bounds: Bounds) -> str:
    """As few digits as are true: a value just outside the bounds is not rounded onto them."""
    if value.is_integer() and abs(value) < 1e9:
        return f"{value:.0f}"
    texts = (f"{value:.{digits}g}" for digits in range(3, 18))
    return next(text for text in texts if bounds.admit(float(text)) == bounds.admit(value))
