"""What makes the rows of a comparison not comparable, one line each."""

from collections.abc import Iterable, Mapping, Sequence
from hashlib import sha256

from estlab.comparison.rows import ComparisonRow, short
from estlab.metrics.vocabulary import Metric

_NAMED = 4


def mismatches(rows: Sequence[ComparisonRow], metrics: Sequence[Metric]) -> list[str]:
    """One line for each thing that should be equal and differs, from scenario, data and seed to units."""
    found = [_line("scenario", [row.run.scenario for row in rows])]
    if len({row.run.scenario for row in rows}) == 1:
        found.append(_line("the scenario's configuration", _settings(rows, ("scenario.",))))
    found.append(_line("the truth's configuration", _settings(rows, ("noise.truth.", "steps", "data.source"))))
    found.append(_line("seed", [short(row.settings.get("seed")) for row in rows]))
    found.append(_line("data files", [_hashes(row.run.data) for row in rows]))
    found.append(_line("estlab", [str(row.run.facts.get("estlab")) for row in rows]))
    found.append(_plugins([row.run.plugins for row in rows]))
    for metric in metrics:
        units = [row.metrics[metric].unit for row in rows if metric in row.metrics]
        numbers = [i for i, row in enumerate(rows, 1) if metric in row.metrics]
        found.append(_line(f"unit of {' '.join(metric)}", [unit or "none" for unit in units], numbers))
    return [line for line in found if line]


def _settings(rows: Sequence[ComparisonRow], prefixes: tuple[str, ...]) -> list[str]:
    """For each row, the values of the keys with these prefixes that differ between rows."""
    keys = dict.fromkeys(key for row in rows for key in row.settings if key.startswith(prefixes))
    written = {key: [short(row.settings.get(key, "none")) for row in rows] for key in keys}
    differing = {key: values for key, values in written.items() if len(set(values)) > 1}
    return [" ".join(f"{key}={values[i]}" for key, values in differing.items()) for i in range(len(rows))]


def _plugins(plugins: Sequence[Mapping[str, str]]) -> str:
    """Modules that several rows have, but with different source."""
    modules = dict.fromkeys(module for one in plugins for module in one)
    differing = [m for m in modules if len({one[m] for one in plugins if m in one}) > 1]
    sources = [", ".join(f"{m} SHA-256 {one[m][:12]}" for m in differing if m in one) or "without" for one in plugins]
    line = _line("the source of plugins", sources)
    return f"{line}; figures may differ because of it" if line else ""


def _hashes(data: Mapping[str, str]) -> str:
    """Data files in a form that tells them apart: one by its hash, several by the hash of all hashes."""
    hashes = sorted(data.values())
    if len(hashes) < 2:
        return f"SHA-256 {hashes[0][:12]}" if hashes else "none"
    return f"{len(hashes)} files, SHA-256 of all {sha256(' '.join(hashes).encode()).hexdigest()[:12]}"


def _line(what: str, values: Sequence[str], numbers: Iterable[int] | None = None) -> str:
    """'seed differs: 1 (rows 1, 2), 2 (row 3)', or nothing."""
    groups: dict[str, list[int]] = {}
    for number, value in zip(numbers or range(1, len(values) + 1), values, strict=True):
        groups.setdefault(value, []).append(number)
    if len(groups) < 2:
        return ""
    parts = [f"{value} (row{'s' * (len(of) > 1)} {_few(of)})" for value, of in groups.items()]
    more = f" and {len(parts) - _NAMED} more" if len(parts) > _NAMED else ""
    return f"{what} differ{'s' * (not what.endswith('files'))}: {', '.join(parts[:_NAMED])}{more}"


def _few(numbers: Sequence[int]) -> str:
    few = ", ".join(map(str, numbers[:6]))
    return few if len(numbers) <= 6 else f"{few}, ..."
