"""A run's configuration as objects, and what each of its keys changes."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal

from estlab.config.groups import Data, Noise, SweepSettings
from estlab.filters.filter import AnyFilter
from estlab.metrics.objective import Objective
from estlab.metrics.verdict import Tolerance
from estlab.scenarios.scenario import Scenario

# What a key changes, unless it is a figure that a title shows. RECORD: which files there are, the last bits of
# figures, or how the run ends. NEITHER: where and how the run is made, and what is made in addition.
RECORD = {"changes": "record", "in_title": False}
NEITHER = {"changes": "neither", "in_title": False}
# Figures, which every run's title shows anyway or leaves to run.json.
TITLED = {"changes": "figures", "in_title": False}


@dataclass(frozen=True)
class Names:
    """The user's names for the parts of a run, which determine random numbers, and the other typed words.

    filter: if there is only one. set_aside: whether the expectations of the experiment were left out, because they
    belong to other data.
    """

    scenario: str
    filter: str
    changes: tuple[str, ...] = ()
    set_aside: bool = False


@dataclass(frozen=True, kw_only=True)
class _Keys:
    """Every key of a configuration except those of the filters."""

    scenario: Scenario
    noise: Noise
    data: Data = field(metadata=TITLED)
    runs: int = field(metadata=TITLED)
    run_index: int | None
    part: list[int] | None = field(metadata=NEITHER)
    parts: list[str] = field(metadata=NEITHER)
    steps: int | None = field(metadata=TITLED)
    dropped: float
    seed: int = field(metadata=TITLED)
    keep_runs: int = field(metadata=RECORD)
    block_runs: int | None = field(metadata=RECORD)
    cores: int | None = field(metadata=NEITHER)
    engine: Literal["auto", "numpy", "compiled"]
    smooth: bool
    verdict: Tolerance
    plots: bool = field(metadata=NEITHER)
    report: bool = field(metadata=NEITHER)
    output: str = field(metadata=NEITHER)
    plugins: list[str] = field(metadata=RECORD)
    # A nested mapping of names, which estlab.config.expectations knows how to read, or nothing.
    expect: Any = field(metadata=RECORD)
    expect_files: Any = field(metadata=RECORD)  # the same by the SHA-256 of a file that was read
    objective: str = field(metadata=NEITHER)
    sweep: SweepSettings = field(metadata=NEITHER)

    def __post_init__(self) -> None:
        if not 0.0 <= self.dropped <= 1.0:
            raise ValueError(f"dropped must be a share from 0 to 1, got {self.dropped:g}")
        for name in ("runs", "steps", "keep_runs", "block_runs"):
            value = getattr(self, name)
            if value is not None and not 1 <= value <= 1_000_000_000:
                raise ValueError(f"{name} must be from 1 to 1e9, got {value}")
        if self.cores is not None and self.cores < 1:
            raise ValueError(f"cores must be >= 1, got {self.cores}")
        for name in ("seed", "run_index"):
            value = getattr(self, name)
            if value is not None and value < 0:
                raise ValueError(f"{name} must be >= 0, got {value}")

        Objective.parse(self.objective)
        if self.part is not None and not (len(self.part) == 2 and 0 <= self.part[0] < self.part[1]):
            raise ValueError(f"part must be [which, of how many], counting from 0, got {self.part}")

    @property
    def run_numbers(self) -> range:
        """The numbers of the runs: from 0 on, or only the requested one."""
        return range(self.runs) if self.run_index is None else range(self.run_index, self.run_index + 1)


@dataclass(frozen=True, kw_only=True)
class Configuration(_Keys):
    """A configuration as typed: one filter, or several by name."""

    filter: AnyFilter
    filters: dict[str, AnyFilter]


@dataclass(frozen=True, kw_only=True)
class Settings(_Keys):
    """A run's whole configuration as objects, and the names of its parts.

    filters: by name, one or several. filter_group: the key under which they were configured.
    """

    names: Names
    filters: dict[str, AnyFilter]
    filter_group: Literal["filter", "filters"]

    @property
    def filter(self) -> AnyFilter:
        """The filter of a run that has one. Raises ValueError if there are several."""
        (only,) = self.filters.values()
        return only

    def filter_key(self, name: str) -> str:
        """The key that a filter of this name was configured by."""
        return f"filters.{name}" if self.filter_group == "filters" else "filter"


def settings_of(configuration: Configuration, names: Names) -> Settings:
    """The settings of a configuration whose scenario and filter have these names."""
    several = configuration.filters
    filters = several or {names.filter: configuration.filter}
    others = {one.name: getattr(configuration, one.name) for one in fields(_Keys)}
    return Settings(names=names, filters=filters, filter_group="filters" if several else "filter", **others)


_METADATA: dict[str, Mapping[str, Any]] = {one.name: one.metadata for one in fields(Configuration)}


def without(plain: Mapping[str, Any], *metadata: Mapping[str, Any]) -> dict[str, Any]:
    """A configuration without the keys that have such metadata."""
    return {key: value for key, value in plain.items() if _METADATA.get(key) not in metadata}


def words_without(words: Iterable[str], *metadata: Mapping[str, Any]) -> list[str]:
    """The words of a command line whose keys, and the groups of these, have no such metadata."""
    return [word for word in words if _METADATA.get(_key(word).partition(".")[0]) not in metadata]


def changes(words: Iterable[str]) -> tuple[str, ...]:
    """The words that a title shows in addition to the names of scenario and filters, runs, steps and seed."""
    names = ("scenario", "filter")
    titled = words_without(words, RECORD, NEITHER, TITLED)
    return tuple(word.lstrip("+") for word in titled if _key(word) not in names)


def _key(word: str) -> str:
    """The dotted key of a word without Hydra's signs and package, such as filter of +filter@filters.ekf=ekf."""
    return word.lstrip("+~").partition("=")[0].partition("@")[0]
