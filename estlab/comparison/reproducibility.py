"""Whether two run directories hold the same figures, and what differs in how they were made."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from estlab import rundir
from estlab.maths.space import Array
from estlab.rundir.finished import array_names, arrays, plugins_of, table

if TYPE_CHECKING:
    from pandas import DataFrame

_TABLES = {
    rundir.METRICS: ("filter", "metric", "component", "unit"),
    rundir.ERRORS: ("filter", "component", "unit"),
    rundir.NEES: ("filter",),
    rundir.NIS: ("filter",),
}


class Deviation(NamedTuple):
    """The largest difference in a column of a table, or in an array; infinite if shapes or words differ.

    relative: to the largest value in the column; for a metric, to its value and interval.
    """

    file: str
    what: str
    before: float
    now: float
    relative: float


def deviations(before: Path, now: Path) -> list[Deviation]:
    """Where the figures of two run directories differ, largest first; empty if they are equal to the last bit.

    Raises UserError that names the file if one cannot be read.
    """
    found = [*_of_estimates(before, now)]
    for file, words in _TABLES.items():
        old, new = table(before, file, words), table(now, file, words)
        if file == rundir.METRICS:
            new = _known(old, new, words)
        found += _of_tables(file, words, old, new)
    return sorted(found, key=lambda one: -one.relative)


def changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What differs between the two in run.json: versions, commit, machine, source of plugins. One line each."""
    found = [
        f"{name} {_or_unknown(old)} before, {_or_unknown(new)} now"
        for name, old, new in _provenance(before, now)
        if old != new and not (name.startswith("git") and old is None)
    ]
    found += _changed_plugins(plugins_of(before), plugins_of(now))
    if any(_part(facts, "git").get("dirty") for facts in (before, now)):
        found.append("estlab had uncommitted changes")
    return found


def _changed_plugins(before: Mapping[str, str], now: Mapping[str, str]) -> Iterator[str]:
    """A line for each module of plugins whose source differs, so that figures may differ."""
    for module in dict.fromkeys([*before, *now]):
        old, new = (one[module][:12] if module in one else "" for one in (before, now))
        if not old:
            yield f"source of {module}: not stored before, SHA-256 {new} now, so it is unknown whether it has changed"
        elif not new:
            yield f"source of {module}: SHA-256 {old} before, not imported now; figures may differ because of it"
        elif before[module] != now[module]:
            yield f"source of {module}: SHA-256 {old} before, {new} now; figures may differ because of it"


def _provenance(before: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    for name in ("estlab", "python"):
        yield name, before.get(name), now.get(name)
    for part, keys in (("git", ("commit",)), ("machine", ("system", "node"))):
        for key in keys:
            yield f"{part} {key}", _part(before, part).get(key), _part(now, part).get(key)
    old, new = _part(before, "packages"), _part(now, "packages")
    for name in dict.fromkeys([*old, *new]):
        yield str(name), old.get(name), new.get(name)


def _part(facts: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    part = facts.get(name)
    return part if isinstance(part, Mapping) else {}


def _or_unknown(value: object) -> str:
    return "unknown" if value is None else str(value)[:80]


def _known(old: "DataFrame", new: "DataFrame", words: Sequence[str]) -> "DataFrame":
    """The metrics that the earlier run has too, in its order: later versions have more, and other orders."""
    wanted = old[[*words]].drop_duplicates()
    return wanted.merge(new, on=[*words], how="inner")[list(new.columns)]


def _of_tables(file: str, words: Sequence[str], before: "DataFrame", now: "DataFrame") -> Iterator[Deviation]:
    """For each column of numbers, and each group of lines with the same words."""
    if list(before.columns) != list(now.columns) or before.shape != now.shape:
        shapes = f"{before.shape[0]} lines of {before.shape[1]} columns, now {now.shape[0]} of {now.shape[1]}"
        yield Deviation(file, shapes, np.nan, np.nan, np.inf)
        return
    labels = [[tuple(line) for line in one[[*words]].itertuples(index=False)] for one in (before, now)]
    if labels[0] != labels[1]:
        here, there = next(pair for pair in zip(*labels, strict=True) if pair[0] != pair[1])
        yield Deviation(file, f"{' '.join(here)}, now {' '.join(there)}", np.nan, np.nan, np.inf)
        return
    columns = [column for column in before.columns if column not in words]
    groups: dict[tuple[str, ...], list[int]] = {}
    for number, label in enumerate(labels[0]):
        groups.setdefault(label, []).append(number)
    values = [one[columns].to_numpy(dtype=float) for one in (before, now)]
    for name, lines in groups.items():
        old, new = (one[lines] for one in values)
        scale = _scale(np.stack([old, new]), axis=(0, 1))
        if file == rundir.METRICS:
            # A metric is compared with itself, including its interval; a p-value beside a verdict is a share.
            of_row = [columns.index(column) for column in ("value", "ci_low", "ci_high")]
            scale[of_row] = 1.0 if "verdict" in name else scale[of_row].max()
        for i, column in enumerate(columns):
            what = " ".join([*(word for word in name if word), column])
            yield from _largest(file, what, old[:, i], new[:, i], scale[i])


def _of_estimates(before: Path, now: Path) -> Iterator[Deviation]:
    """For each array, and each component of its first axis. Clouds that only one of both has are ignored."""
    file = rundir.ESTIMATES
    names = array_names(before, file), array_names(now, file)
    alone = {name for name in {*names[0]} ^ {*names[1]} if "cloud" not in name.split(".")[:-1]}
    if alone:
        yield Deviation(file, f"arrays {' '.join(sorted(alone))}", np.nan, np.nan, np.inf)
        return
    both = {*names[0]} & {*names[1]}
    found = (
        ((name, one) for name, one in zip(own, arrays(path, file), strict=True) if name in both)
        for own, path in zip(names, (before, now), strict=True)
    )
    for (name, old), (_, new) in zip(*found, strict=True):
        if old.shape != new.shape or old.dtype.kind not in "fiub":
            if old.shape != new.shape or not np.array_equal(old, new):
                yield Deviation(file, f"{name} {old.shape}, now {new.shape}", np.nan, np.nan, np.inf)
        elif not np.array_equal(old, new, equal_nan=old.dtype.kind == "f"):
            for i, (mine, other) in enumerate(zip(np.atleast_1d(old), np.atleast_1d(new), strict=True)):
                mine, other = np.ravel(mine).astype(float), np.ravel(other).astype(float)
                label = f"{name}[{i}]" if old.ndim > 1 else name
                yield from _largest(file, label, mine, other, float(_scale(np.stack([mine, other]), axis=(0, 1))))


def _largest(file: str, what: str, before: Array, now: Array, scale: float) -> Iterator[Deviation]:
    """The largest difference of two vectors; infinite if only one of them has a number."""
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.where(before == now, 0.0, np.abs(now - before) / scale)
    off = np.where(np.isnan(before) & np.isnan(now), 0.0, np.where(np.isnan(off), np.inf, off))
    if off.size and off.max() > 0.0:
        at = int(off.argmax())
        yield Deviation(file, what, float(before[at]), float(now[at]), float(off[at]))


def _scale(values: Array, axis: tuple[int, ...]) -> Array:
    """The largest finite magnitude."""
    return np.max(np.where(np.isfinite(values), np.abs(values), 0.0), axis=axis, initial=0.0)
