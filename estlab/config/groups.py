"""Groups of keys without a class of their own: noise, data, sweep."""

from dataclasses import dataclass
from typing import Literal

from estlab.datasets.data_files import Options
from estlab.scenarios.scenario import Scales, check_positive


@dataclass(frozen=True)
class Noise:
    """The noise that the filter assumes and the noise of the truth, separately."""

    filter: Scales
    truth: Scales


@dataclass(frozen=True)
class Data:
    """Where truth and readings come from: simulated here, or read from files."""

    source: Literal["simulated", "files"]
    path: str | None
    prefix: str
    files: dict[str, str]
    clock_faults: float
    clock_gap: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.clock_faults <= 1.0:
            raise ValueError(f"clock_faults must be a share from 0 to 1, got {self.clock_faults:g}")
        check_positive(clock_gap=self.clock_gap)
        if "/" in self.prefix:
            raise ValueError(
                f"prefix must be the beginning of the files' names, got {self.prefix!r}; put folders into data.path"
            )

    @property
    def options(self) -> Options:
        """How to read recordings."""
        return Options(self.files, self.clock_faults, self.clock_gap)


@dataclass(frozen=True)
class SweepSettings:
    """How to make and run the jobs of a sweep."""

    dir: str
    zip: list[str]
    repeats: int
    split_runs: int
    workers: int | None
    retries: int
    timeout: float | None
    fail_fast: bool
    dry_run: bool
    trials: int
    batch: int

    def __post_init__(self) -> None:
        if not 1 <= self.repeats <= 1_000_000:
            raise ValueError(f"repeats must be from 1 to 1e6, got {self.repeats}")
        if not 1 <= self.split_runs <= 10_000:
            raise ValueError(f"split_runs must be from 1 to 1e4, got {self.split_runs}")
        if not 0 <= self.retries <= 1000:
            raise ValueError(f"retries must be from 0 to 1000, got {self.retries}")
        if self.workers is not None and not 1 <= self.workers <= 10_000:
            raise ValueError(f"workers must be from 1 to 1e4, got {self.workers}")
        for name in ("trials", "batch"):
            if not 1 <= getattr(self, name) <= 100_000:
                raise ValueError(f"{name} must be from 1 to 1e5, got {getattr(self, name)}")
        if self.timeout is not None and not 0.0 < self.timeout <= 1e9:
            raise ValueError(f"timeout must be > 0 and at most 1e9, got {self.timeout:g}")
