"""One word and one sentence on a filter: what its tests say, with the figures for it, and a key where one is known."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estlab.metrics.consistency import (
    BIAS,
    FEWEST,
    INSIDE,
    LEAST_INSIDE,
    NEES,
    NIS,
    WHITENESS,
    Test,
    explained_by_bias,
    nees_of,
    sample_too_small,
)
from estlab.metrics.digits import bracketed, figure
from estlab.metrics.intervals import LEVEL, mean_interval, positive_interval, stretched
from estlab.metrics.tally import CAUSES, Tally

CONSISTENT, OVERCONFIDENT, CONSERVATIVE = "consistent", "overconfident", "conservative"
BIASED, CORRELATED, LOST, STARVED, UNDECIDED = "biased", "correlated", "lost", "starved", "undecided"
WORDS = (CONSISTENT, OVERCONFIDENT, CONSERVATIVE, BIASED, CORRELATED, LOST, STARVED, UNDECIDED)

# A measurement noise four times too large makes innovations correlate by 0.2 (docs/statistics.md, calibration); by
# more, the readings' own errors are correlated.
_COLOURED = 0.25
_STARVED = 0.5  # share of the runs whose clouds are too small at some step
_JUDGED = (NEES, NIS, BIAS, WHITENESS)
_COARSE = 1.5  # how much larger NEES has to be to be seen, from which on it is said

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
    fewest = _fewest(tally, sampled_key.rpartition(".")[2]) if sampled_key else ""
    more = f"; raise {sampled_key}" if fewest else ""
    if diverged and diverged >= tolerance.lost * tally.runs:
        sentence = f"{_lost(tally, diverged)}{f', {fewest}' if fewest else ''}{more}"
        return Verdict(LOST, sentence, sampled_key if fewest else "", p)
    figures = [_figure(by[name]) for name in (INSIDE, NEES, NIS, BIAS, WHITENESS) if name in faults]
    word = _word(by, faults, explained_by_bias(tally) if BIAS in faults else 0.0)
    if fewest and _is_starved(tally, by, faults):
        unjudged = [] if NEES in faults else [_nees(tally)]
        return Verdict(STARVED, f"starved: {', '.join([fewest, *unjudged, *figures])}{more}", sampled_key, p)
    if INSIDE in faults:
        sentence = f"{OVERCONFIDENT}: {', '.join([figures[0], _nees(tally), *figures[1:]])}{more}"
        return Verdict(OVERCONFIDENT, sentence, sampled_key if fewest else "", p)
    if word == CONSISTENT and not answered:
        return Verdict(UNDECIDED, f"undecided: {_undecided(tally, by)}", "", p)
    if word == CONSISTENT:
        return Verdict(CONSISTENT, _consistent(tally, by), "", p)
    key, advice = _advice(word, by, faults, tally.sampled)
    of_what = _as_far_as(by) if word in (OVERCONFIDENT, CONSERVATIVE) else ""
    return Verdict(word, f"{_said(word)}{of_what}: {', '.join(figures)}{advice}", key, p)


def _word(by: dict[str, Test], faults: set[str], explained: float) -> str:
    """The one fault that matters most: a bias where it explains at least half of what the NEES is too large by."""
    if INSIDE in faults:
        return OVERCONFIDENT
    nees = by[NEES].found.value if NEES in faults else 1.0
    if BIAS in faults and nees >= 1.0 and explained >= 0.5 * (nees - 1.0):
        return BIASED
    for name in (NEES, NIS):
        if name in faults:
            return OVERCONFIDENT if by[name].found.value > 1.0 else CONSERVATIVE
    if BIAS in faults:
        return BIASED
    return CORRELATED if WHITENESS in faults else CONSISTENT


def _is_starved(tally: Tally, by: dict[str, Test], faults: set[str]) -> bool:
    """Whether a cloud that is too small at some step is what is wrong, or leaves nothing else to be said.

    Where shares inside 3 sigma tell how wrong the cloud is, they are what is said.
    """
    if INSIDE in faults:
        return False
    small = NEES in faults and by[NEES].found.value < 1.0
    return bool(sample_too_small(tally)) or (not small and bool({NEES, BIAS} & faults))


def _fewest(tally: Tally, states: str) -> str:
    """What became of the samples of half of the runs or more; empty where they are large enough throughout."""
    if not tally.sampled or not tally.moments["starved"].mean[0] >= _STARVED:
        return ""
    found = figure(mean_interval(tally.moments["fewest"]))
    if states == "members":
        return f"{found} members are too few"
    return f"the cloud fell to {found} effective {states}{'' if tally.runs == 1 else ' in the mean over runs'}"


def _advice(word: str, by: dict[str, Test], faults: set[str], sampled: bool) -> tuple[str, str]:
    """The key that the calibration names where a noise is planted that is not what the filter takes it for.

    Errors and innovations too large, and innovations correlated with those before, come of too little process noise;
    anticorrelated, of too little measurement noise. Too small, of too much, the other way about. Mehra 1970. Whatever
    looks otherwise has no key: correlated readings, a model that is off, a linearisation, a cloud.
    """
    if word not in (OVERCONFIDENT, CONSERVATIVE) or NEES not in faults or sampled:
        return "", ""
    if not (by[NIS].rejected and by[WHITENESS].rejected):
        return "", ""
    above, correlation = by[NEES].found.value > 1.0, by[WHITENESS].found.value
    if (by[NIS].found.value > 1.0) != above or (not above and correlation > _COLOURED):
        return "", ""
    key = PROCESS if (correlation > 0.0) == above else MEASUREMENT
    return key, f"; {'raise' if above else 'lower'} {key}"


def _figure(test: Test) -> str:
    found = bracketed(test.found, test.expected)
    if test.name == BIAS:
        return f"{test.of} off by {found} sigma"
    if test.name == WHITENESS:
        return f"innovations correlated {found} at {test.of}"
    if test.name == INSIDE:
        return f"{test.of} within 3 sigma {found} of the time, which no law of errors has below {LEAST_INSIDE:.3f}"
    return f"{test.name.upper()} / {test.of} = {found}"


def _nees(tally: Tally) -> str:
    """NEES where it is told and not judged."""
    of, moments = nees_of(tally)
    return f"NEES / {of} = {bracketed(positive_interval(moments))}"


def _consistent(tally: Tally, by: dict[str, Test]) -> str:
    parts = [_figure(by[name]) for name in (NEES, NIS) if np.isfinite(by[name].p)]
    for name, word in ((BIAS, "no bias"), (WHITENESS, "white innovations")):
        parts += [_figure(by[name]) if by[name].rejected else word] * bool(np.isfinite(by[name].p))
    slight = [name for name in (NEES, NIS, BIAS, WHITENESS) if by[name].rejected]
    but = ", but for what is too slight to matter" if slight else ""
    seen = "" if slight else _could_be_seen(tally, by[NEES])
    return f"consistent{_as_far_as(by)}{but}: {', '.join(parts)}{seen}"


def _as_far_as(by: dict[str, Test]) -> str:
    return "" if np.isfinite(by[NEES].p) else " as far as its innovations tell"


def _could_be_seen(tally: Tally, nees: Test) -> str:
    """Which NEES so many runs would have shown to be wrong, where only a large fault would have been."""
    if np.isfinite(nees.p):
        reach = nees.found.high / nees.found.value
        return f"; {_would_show(f'{nees.found.n} runs', nees.of, reach)}" if reach > _COARSE else ""
    enough = tally.runs >= FEWEST and not tally.repeated
    if enough or tally.sampled or not int(nees_of(tally)[1].count):
        return ""
    # At most, since a mean over time varies less than what it is of: a chi-square of one step, over its n.
    error = math.sqrt(2.0 / (tally.space.size * FEWEST))
    what = "recordings" if tally.repeated else "runs"
    return f"; {_would_show(f'{FEWEST} {what}', nees.of, stretched(error, FEWEST, LEVEL / len(_JUDGED)))}"


def _would_show(runs: str, of: str, reach: float) -> str:
    """Rounded away from one, so that what is said to be seen is."""
    places = 1 - math.floor(math.log10(reach))
    above = math.ceil(reach * 10.0**places) / 10.0**places
    below = 1.0 / reach
    down = 1 - math.floor(math.log10(below))
    below = math.floor(below * 10.0**down) / 10.0**down
    return f"{runs} would show a NEES / {of} beyond {above:.{max(places, 0)}f} or below {below:.{max(down, 0)}f}"


def _undecided(tally: Tally, by: dict[str, Test]) -> str:
    """Why no test has an answer, each reason once, and what more runs would show."""
    whys = dict.fromkeys(by[name].why for name in (NEES, NIS))
    said = [f"a test of NEES {why}" if why.startswith("needs") else why for why in whys]
    return f"{' and '.join(said)}{_could_be_seen(tally, by[NEES])}"


def _said(word: str) -> str:
    return "correlated innovations" if word == CORRELATED else word


def _lost(tally: Tally, diverged: int) -> str:
    words = {"not_finite": "not finite", "not_definite": "not positive definite", "lost": "too far off to the end"}
    why = ", ".join(f"{tally.diverged[cause]} {words[cause]}" for cause in CAUSES if tally.diverged[cause])
    return f"lost: {diverged} of {tally.runs} runs diverged ({why})"
