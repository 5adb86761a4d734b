"""One word and one sentence on a filter: what its tests say, with the figure that says so and the key to look at."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estlab.metrics.consistency import BIAS, NEES, NIS, WHITENESS, Test, explained_by_bias, sample_too_small
from estlab.metrics.digits import bracketed
from estlab.metrics.intervals import positive_interval
from estlab.metrics.tally import CAUSES, Tally

CONSISTENT, OVERCONFIDENT, CONSERVATIVE = "consistent", "overconfident", "conservative"
BIASED, CORRELATED, LOST, UNDECIDED = "biased", "correlated", "lost", "undecided"
WORDS = (CONSISTENT, OVERCONFIDENT, CONSERVATIVE, BIASED, CORRELATED, LOST, UNDECIDED)

# Correlated errors of readings make innovations a little too small; much smaller, the filter has lost its way.
_COLOURED = 0.5

PROCESS, MEASUREMENT = "noise.filter.process_scale", "noise.filter.measurement_scale"


@dataclass(frozen=True)
class Tolerance:
    """How large a fault must be to be called one, however many runs show it, and how many lost runs are too many.

    fault: of NEES and NIS from one, of a bias in sigmas, of a correlation. lost: share of the runs.
    """

    fault: float
    lost: float

    def __post_init__(self) -> None:
        for name, value in (("fault", self.fault), ("lost", self.lost)):
            if not 0.0 <= value < 1.0:
                raise ValueError(f"{name} must be at least 0 and below 1, got {value:g}")


class Verdict(NamedTuple):
    """The word, the sentence, the key to look at (empty for none) and the smallest adjusted p-value of the tests."""

    word: str
    sentence: str
    key: str
    p: float


def judge(tally: Tally, tests: Sequence[Test], tolerance: Tolerance, sampled_key: str = "") -> Verdict:
    """The verdict on a filter from its tests. sampled_key: the key of the size of its sample, if it has one."""
    by = {test.name: test for test in tests}
    faults = {test.name for test in tests if test.rejected and abs(test.found.value - test.expected) > tolerance.fault}
    diverged = sum(tally.diverged.values())
    answered = [test.adjusted for test in tests if np.isfinite(test.adjusted)]
    p = min(answered, default=np.nan)
    if diverged and diverged >= tolerance.lost * tally.runs:
        key = sampled_key or PROCESS
        return Verdict(LOST, f"{_lost(tally, diverged)}; raise {key}", key, p)
    figures = [_figure(by[name]) for name in (NEES, NIS, BIAS, WHITENESS) if name in faults]
    word = _word(by, faults, explained_by_bias(tally) if BIAS in faults else 0.0)
    if word == CONSISTENT:
        if by[NEES].why and by[NEES].why == sample_too_small(tally):
            figure = _figure(by[NEES]._replace(found=positive_interval(tally.moments["anees"]), of="n"))
            advice = f"; raise {sampled_key}" if sampled_key else ""
            return Verdict(UNDECIDED, f"undecided: {by[NEES].why}, {figure}{advice}", sampled_key, p)
        if not answered:
            return Verdict(UNDECIDED, f"undecided: {by[NEES].why}", "", p)
        return Verdict(CONSISTENT, _consistent(by), "", p)
    key, advice = _advice(word, by, faults, sampled_key)
    return Verdict(word, f"{_said(word)}: {', '.join(figures)}; {advice}", key, p)


def _word(by: dict[str, Test], faults: set[str], explained: float) -> str:
    """The one fault that matters most: a bias where it explains at least half of what the NEES is too large by."""
    nees = by[NEES].found.value if NEES in faults else 1.0
    if BIAS in faults and nees >= 1.0 and explained >= 0.5 * (nees - 1.0):
        return BIASED
    for name in (NEES, NIS):
        if name in faults:
            return OVERCONFIDENT if by[name].found.value > 1.0 else CONSERVATIVE
    if BIAS in faults:
        return BIASED
    return CORRELATED if WHITENESS in faults else CONSISTENT


def _advice(word: str, by: dict[str, Test], faults: set[str], sampled_key: str) -> tuple[str, str]:
    """The key, and what to do with it.

    Innovations too large and correlated with those before come of too much trust in the models, too large and
    anticorrelated of too much trust in the readings; too small, the other way about. Mehra 1970.
    """
    if word == BIASED:
        return "scenario", f"the models are off: see scenario, or trust them less by raising {PROCESS}"
    nis = by[NIS].found.value
    size = float(np.sign(nis - 1.0)) if NIS in faults else 0.0
    correlation = float(np.sign(by[WHITENESS].found.value)) if WHITENESS in faults else 0.0
    if np.isnan(nis):
        return "filter", "try another filter, or what it is made of"
    if word == OVERCONFIDENT and size < 0.0 and nis > _COLOURED and correlation > 0.0:
        return MEASUREMENT, f"the readings' errors seem correlated: raise {MEASUREMENT}"
    if word == OVERCONFIDENT and (size < 0.0 or size == correlation == 0.0):
        remedy = f"raise {sampled_key}" if sampled_key else f"try another filter, or raise {PROCESS}"
        return sampled_key or "filter", f"the innovations do not show it: {remedy}"
    if size == correlation == 0.0:
        return PROCESS, f"lower {PROCESS}"
    if size == 0.0:
        return PROCESS, f"{'raise' if correlation > 0.0 else 'lower'} {PROCESS}"
    verb = "raise" if size > 0.0 else "lower"
    if size > 0.0 and sampled_key and correlation == 0.0:
        return sampled_key, f"raise {sampled_key}, or else {PROCESS} and {MEASUREMENT}"
    if correlation == 0.0:
        return PROCESS, f"{verb} {PROCESS} and {MEASUREMENT}"
    key = PROCESS if correlation * size > 0.0 else MEASUREMENT
    return key, f"{verb} {key}"


def _figure(test: Test) -> str:
    found = bracketed(test.found)
    if test.name == BIAS:
        return f"{test.of} off by {found} sigma"
    if test.name == WHITENESS:
        return f"innovations correlated {found} at {test.of}"
    return f"{test.name.upper()} / {test.of} = {found}"


def _consistent(by: dict[str, Test]) -> str:
    parts = [_figure(by[name]) for name in (NEES, NIS) if np.isfinite(by[name].p)]
    for name, word in ((BIAS, "no bias"), (WHITENESS, "white innovations")):
        parts += [_figure(by[name]) if by[name].rejected else word] * bool(np.isfinite(by[name].p))
    slight = [name for name in (NEES, NIS, BIAS, WHITENESS) if by[name].rejected]
    but = ", but for what is too slight to matter" if slight else ""
    by_what = "" if np.isfinite(by[NEES].p) else " as far as its innovations tell"
    return f"consistent{by_what}{but}: {', '.join(parts)}"


def _said(word: str) -> str:
    return "correlated innovations" if word == CORRELATED else word


def _lost(tally: Tally, diverged: int) -> str:
    words = {"not_finite": "not finite", "not_definite": "not positive definite", "lost": "too far off to the end"}
    why = ", ".join(f"{tally.diverged[cause]} {words[cause]}" for cause in CAUSES if tally.diverged[cause])
    return f"lost: {diverged} of {tally.runs} runs diverged ({why})"
