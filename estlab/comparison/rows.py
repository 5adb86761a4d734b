"""The lines of a comparison: each filter of each run, its metrics, and what distinguishes it from the others."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from estlab import rundir
from estlab.config.settings import NEITHER, RECORD, without
from estlab.errors import UserError
from estlab.metrics.intervals import Estimate
from estlab.metrics.vocabulary import Metric
from estlab.record import SMOOTHED
from estlab.rundir.finished import Finished, table

_OF_FILTERS = ("filter", "filters")  # which stand in a row otherwise
_SHOWN, _LONGEST = 4, 32


class Figure(NamedTuple):
    """A metric's value, and its unit."""

    found: Estimate
    unit: str


@dataclass(frozen=True)
class ComparisonRow:
    """A filter of a run. label: what distinguishes it from other rows. settings: dotted keys and values."""

    run: Finished
    filter: str
    metrics: Mapping[Metric, Figure]
    verdict: str
    settings: Mapping[str, Any]
    label: str = ""


def rows_of(run: Finished) -> list[ComparisonRow]:
    """A row for each set of estimates in a run's metrics.csv.

    Raises UserError that names the file if one cannot be used.
    """
    words, numbers = ("filter", "metric", "component", "unit"), ("value", "ci_low", "ci_high", "n")
    metrics = table(run.path, rundir.METRICS, words, numbers)
    if metrics.empty:
        raise UserError(f"{run.path / rundir.METRICS}: contains no line")
    found = []
    for name, lines in metrics.groupby("filter", sort=False):
        figures: dict[Metric, Figure] = {}
        verdict = ""
        for _, metric, component, unit, value, low, high, n in lines[[*words, *numbers]].itertuples(index=False):
            if metric == "verdict":
                verdict = component
            else:
                count = int(n) if 0 <= n < 1e15 else 0
                figures[metric, component] = Figure(Estimate(value, low, high, count), unit)
        found.append(ComparisonRow(run, str(name), figures, verdict, _settings(run, str(name))))
    return found


def labelled(rows: Sequence[ComparisonRow]) -> list[ComparisonRow]:
    """The rows with labels: the scenario if it varies, the filter, each key whose value differs from that of most
    rows, and the directory if these are equal.
    """
    several = len({row.run.scenario for row in rows}) > 1
    differing = _differing(rows)
    labels = []
    for row, keys in zip(rows, differing, strict=True):
        parts = [row.run.scenario] * several + [row.filter]
        parts += [f"{key}={short(row.settings[key])}" for key in keys[:_SHOWN]]
        labels.append(" ".join(parts))
    return [
        replace(row, label=label if labels.count(label) == 1 else f"{label} {_place(row, rows)}")
        for row, label in zip(rows, labels, strict=True)
    ]


def short(value: object) -> str:
    """A value as typed, cut if it is long."""
    text = f"{value:g}" if isinstance(value, float) else str(value)
    if value is None or isinstance(value, bool):
        text = {None: "null", True: "true", False: "false"}[value]
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def flat(node: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Every value of a configuration by its dotted key; a list is a value."""
    for key, value in node.items() if isinstance(node, Mapping) else ():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _settings(run: Finished, filter: str) -> dict[str, Any]:
    config = run.config
    several = config.get("filters")
    of_filter = config.get("filter")
    if isinstance(several, Mapping):
        of_filter = several.get(filter, several.get(filter.removesuffix(SMOOTHED), of_filter))
    kept = {key: value for key, value in without(config, NEITHER, RECORD).items() if key not in _OF_FILTERS}
    return dict(flat(kept)) | dict(flat({"filter": of_filter}))


def _differing(rows: Sequence[ComparisonRow]) -> list[list[str]]:
    """For each row, the keys whose values differ from most similar rows: of a scenario, of a filter, or of all."""
    usual: dict[tuple[str, str], dict[str, str | None]] = {}
    for of, keys in (("scenario", ("scenario.",)), ("filter", ("filter.",)), ("", ("",))):
        groups: dict[str, list[ComparisonRow]] = {}
        for row in rows:
            groups.setdefault(_group(row, of), []).append(row)
        for name, alike in groups.items():
            usual[of, name] = _usual(alike, keys)
    return [
        [
            key
            for key, value in row.settings.items()
            if usual[_kind(key), _group(row, _kind(key))][key] != _written(value)
        ]
        for row in rows
    ]


def _usual(rows: Sequence[ComparisonRow], beginnings: tuple[str, ...]) -> dict[str, str | None]:
    """For each key, the value that more than half of the rows with that key share; None if there is none."""
    values: dict[str, Counter[str]] = {}
    for row in rows:
        for key, value in row.settings.items():
            if key.startswith(beginnings):
                values.setdefault(key, Counter())[_written(value)] += 1
    most = {key: (counts.most_common(1)[0], counts.total()) for key, counts in values.items()}
    return {key: value if 2 * count > total else None for key, ((value, count), total) in most.items()}


def _written(value: object) -> str:
    """Equal texts for equal values."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return repr(float(str(value))) if number else repr(value)


def _kind(key: str) -> str:
    group = key.partition(".")[0]
    return group if group in ("scenario", "filter") else ""


def _group(row: ComparisonRow, kind: str) -> str:
    return {"scenario": row.run.scenario, "filter": row.filter}.get(kind, "")


def same(a: object, b: object) -> bool:
    """Whether two values of configurations are equal: 1 and 1.0 are, 1 and true are not."""
    return _written(a) == _written(b)


def _place(row: ComparisonRow, rows: Sequence[ComparisonRow]) -> str:
    """A run directory's name, with its folder's if another has the same name."""
    names = {other.run.path.resolve() for other in rows if other.run.path.resolve().name == row.run.path.resolve().name}
    path = row.run.path.resolve()
    return path.name if len(names) == 1 else f"{path.parent.name}/{path.name}"
