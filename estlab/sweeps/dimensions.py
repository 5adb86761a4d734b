"""What a tuning may choose from: a key's interval, range or choice in Hydra's grammar, in Optuna's form."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from estlab.errors import UserError
from estlab.launch.quoting import angle_as_typed

if TYPE_CHECKING:
    from hydra.core.override_parser.types import Override
    from optuna.distributions import BaseDistribution

_DIGITS = 6  # digits of a suggested number: more would show nothing, and nobody types them


@dataclass(frozen=True)
class Numbers:
    """Numbers from low to high, both included, optionally in steps."""

    key: str
    low: float
    high: float
    step: float | None
    whole: bool
    log: bool

    def distribution(self) -> "BaseDistribution":
        """The distribution in Optuna's form."""
        from optuna.distributions import FloatDistribution, IntDistribution

        if self.whole:
            return IntDistribution(int(self.low), int(self.high), log=self.log, step=int(self.step or 1))
        return FloatDistribution(self.low, self.high, log=self.log, step=self.step)

    def word(self, value: object) -> str:
        """A suggestion as a typed word."""
        return str(value) if self.whole else f"{value:.{_DIGITS}g}"


@dataclass(frozen=True)
class Choices:
    """One of several words."""

    key: str
    words: tuple[str, ...]

    def distribution(self) -> "BaseDistribution":
        """The distribution in Optuna's form."""
        from optuna.distributions import CategoricalDistribution

        return CategoricalDistribution(self.words)

    def word(self, value: object) -> str:
        """A suggestion as a typed word."""
        return str(value)


Dimension = Numbers | Choices


def dimension(override: "Override") -> Dimension:
    """The dimension for a key with several values.

    Raises UserError for one without any value.
    """
    from hydra.core.override_parser.types import IntervalSweep, RangeSweep, Sweep

    key, sweep, word = override.get_key_element(), override.value(), str(override.input_line)
    log = isinstance(sweep, Sweep) and "log" in sweep.tags
    if isinstance(sweep, IntervalSweep):
        low, high = sweep.start, sweep.end
        if low is None or high is None or not (low < high and (low > 0 or not log)):
            raise UserError(f"{word}: write an interval from low to high" + ", both above zero, for log" * log)
        return Numbers(key, float(low), float(high), None, isinstance(low, int) and isinstance(high, int), log)
    words = [angle_as_typed(str(value)) for value in override.sweep_string_iterator()]
    if not words:
        raise UserError(f"{word}: there is no value in it")
    if isinstance(sweep, RangeSweep):
        return _range(key, word, words, log)
    if log:
        raise UserError(f"{word}: log is for intervals and ranges of numbers")
    return Choices(key, tuple(words))


def _range(key: str, word: str, words: Sequence[str], log: bool) -> Dimension:
    values = sorted(float(one) for one in words)
    whole = all(one.lstrip("+-").isdigit() for one in words)
    step = values[1] - values[0] if len(values) > 1 else 1.0
    if log and not (whole and step == 1.0 and values[0] > 0.0):
        raise UserError(f"{word}: log takes steps of one above zero; write tag(log,interval(...)) for others")
    return Numbers(key, values[0], values[-1], step, whole, log)
