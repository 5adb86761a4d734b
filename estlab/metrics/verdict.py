"""The verdict on a filter: one word, one sentence with the figures behind it, and a key to change if one is known."""

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
from estlab.metrics.digits import bracketed
from estlab.metrics.intervals import LEVEL, positive_interval, stretched
from estlab.metrics.laws import LEAST_EFFECTIVE
from estlab.metrics.tally import CAUSES, Tally
from estlab.metrics.vocabulary import test_heading

CONSISTENT, OVERCONFIDENT, CONSERVATIVE = "consistent", "overconfident", "conservative"
BIASED, CORRELATED, LOST, STARVED, UNDECIDED = "biased", "correlated", "lost", "starved", "undecided"
WORDS = (CONSISTENT, OVERCONFIDENT, CONSERVATIVE, BIASED, CORRELATED, LOST, STARVED, UNDECIDED)

# A measurement noise four times too large makes innovations correlate by 0.2 (docs/statistics.md, calibration); a
# larger correlation comes from correlated errors of the readings.
_COLOURED = 0.25
_STARVED = 0.5  # share of the runs with too small a cloud at some step
_JUDGED = (NEES, NIS, BIAS, WHITENESS)
_COARSE = 1.5  # the smallest detectable excess of NEES that a verdict mentions

PROCESS, MEASUREMENT = "noise.filter.process_scale", "noise.filter.measurement_scale"


@dataclass(frozen=True)
class Tolerance:
    """The smallest size of a fault, however many runs show it, and the share of lost runs that is too large.

    fault: deviation of NEES and NIS from one, bias in sigmas, correlation. lost: share of the runs.
    """

    fault: float
    lost: float

    def __post_init__(self) -> None:
        for name, value in (("fault", self.fault), ("lost", self.lost)):
            if not 0.0 <= value < 1.0:
                raise ValueError(f"{name} must be at least 0 and below 1, got {value:g}")


class Verdict(NamedTuple):
    """The word, the sentence, the key to change (empty for none) and the smallest adjusted p-value of the tests."""

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
    sample = _sample(tally, sampled_key)
    key = sampled_key if sample and _is_to_blame(by, faults) else ""
    more = f"; raise {key}" if key else ""
    if diverged and diverged >= tolerance.lost * tally.runs:
        return Verdict(LOST, f"{_lost(tally, diverged)}{f', {sample}' if sample else ''}{more}", key, p)
    word = _word(by, faults, explained_by_bias(tally) if BIAS in faults else 0.0)
    order = (BIAS, NEES, NIS, WHITENESS) if word == BIASED else (INSIDE, *_JUDGED)
    figures = [_figure(by[name]) for name in order if name in faults]
    if sample and _is_starved(tally, by, faults):
        unjudged = [] if NEES in faults else [_nees(tally)]
        return Verdict(STARVED, f"starved: {', '.join([sample, *unjudged, *figures])}{more}", key, p)
    if INSIDE in faults:
        return Verdict(OVERCONFIDENT, f"{word}: {', '.join([figures[0], _nees(tally), *figures[1:]])}{more}", key, p)
    if sample and sample_too_small(tally):
        more = f"; {sample}, and a test of NEES needs {LEAST_EFFECTIVE}{_enough(tally, key)}"
    else:
        more = key = ""
    if word == CONSISTENT and not answered:
        return Verdict(UNDECIDED, f"undecided: {_undecided(tally, by)}{more}", key, p)
    if word == CONSISTENT and more and not np.isfinite(by[NEES].p) and np.isfinite(by[BIAS].p):
        parts = [f"{_nees(tally)} (not judged)", *_not_rejected(by)]
        return Verdict(UNDECIDED, f"undecided: {', '.join(parts)}{more}", key, p)
    if word == CONSISTENT:
        return Verdict(CONSISTENT, f"{_consistent(tally, by)}{more}", key, p)
    advised, advice = _advice(word, by, faults, tally.sampled)
    of_what = _as_far_as(by) if word in (OVERCONFIDENT, CONSERVATIVE) else ""
    if word == CORRELATED:
        word_and, figures = "correlated in its innovations", [figures[0].removeprefix("innovations ")]
    else:
        word_and = f"{word}{of_what}"
    return Verdict(word, f"{word_and}: {', '.join(figures)}{advice}{more}", advised or key, p)


def _word(by: dict[str, Test], faults: set[str], explained: float) -> str:
    """The fault that matters most: a bias if it explains at least half of the excess of NEES."""
    if INSIDE in faults:
        return OVERCONFIDENT
    nees = by[NEES].found.value if NEES in faults else 1.0
    size_known = np.isfinite(by[NEES].p) or NIS not in faults
    if size_known and BIAS in faults and nees >= 1.0 and explained >= 0.5 * (nees - 1.0):
        return BIASED
    for name in (NEES, NIS):
        if name in faults:
            return OVERCONFIDENT if by[name].found.value > 1.0 else CONSERVATIVE
    if BIAS in faults:
        return BIASED
    return CORRELATED if WHITENESS in faults else CONSISTENT


def _is_starved(tally: Tally, by: dict[str, Test], faults: set[str]) -> bool:
    """Whether a cloud that is too small at some step is the cause.

    If NEES is judged, it decides. If it has no law, the cloud is starved if it fell to so few states that their
    covariance says nothing, or if NEES is larger than for so few states drawn from the truth's own law. If shares
    inside 3 sigma show how wrong the cloud is, they are reported instead.
    """
    n, size = tally.space.size, _fewest(tally)
    if INSIDE in faults or not (size <= n + 4 or _is_to_blame(by, faults)):
        return False
    if not sample_too_small(tally):
        return BIAS in faults if NEES not in faults else by[NEES].found.value > 1.0
    return size <= n + 4 or positive_interval(nees_of(tally)[1]).low > (size + 1.0) / (size - n - 2.0)


def _is_to_blame(by: dict[str, Test], faults: set[str]) -> bool:
    """Whether a small cloud may be why errors are too large: not if innovations are too large and white, or worse.

    A cloud that lost its states stays on one side of the readings, so its innovations correlate. If they do not, the
    readings are worse than the filter assumes, and that is what makes the cloud small.
    """
    if NIS not in faults or by[NIS].found.value < 1.0:
        return True
    return by[WHITENESS].rejected and by[WHITENESS].found.value > 0.0


def _fewest(tally: Tally) -> float:
    """The smallest size of the sample over a run, mean over runs."""
    return float(tally.moments["fewest"].mean[0])


def _sample(tally: Tally, key: str) -> str:
    """What happened to the samples of half of the runs or more; empty if they are large enough throughout."""
    if not (key and tally.sampled and tally.moments["starved"].mean[0] >= _STARVED):
        return ""
    states, found = key.rpartition(".")[2], f"{_fewest(tally):.3g}"
    if states == "members":
        return f"{found} members are too few"
    states = states.removesuffix("s") if found == "1" else states
    return f"the cloud fell to {found} effective {states}{'' if tally.runs == 1 else ' on average'}"


def _enough(tally: Tally, key: str) -> str:
    """The advice on the sample's size, if a key is given: the effective size grows with the sample."""
    return f": raise {key} by a factor of {math.ceil(LEAST_EFFECTIVE / _fewest(tally))}" if key else ""


def _advice(word: str, by: dict[str, Test], faults: set[str], sampled: bool) -> tuple[str, str]:
    """The key that the calibration supports for a noise that the filter assumes wrongly.

    Errors and innovations too large, and innovations correlated with earlier ones: too little process noise;
    anticorrelated: too little measurement noise. Errors and innovations too small: too much, with the signs reversed.
    Mehra 1970. Any other pattern has no key: correlated readings, a wrong model, a linearisation, a cloud.
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
        return (
            f"{test.of} within 3 sigma for {found} of the time, where any distribution has at least {LEAST_INSIDE:.3f}"
        )
    return f"{test_heading(test.name, test.of)} = {found}"


def _nees(tally: Tally) -> str:
    """NEES where it is shown without being judged."""
    of, moments = nees_of(tally)
    return f"{test_heading(NEES, of)} = {bracketed(positive_interval(moments), 1.0)}"


def _consistent(tally: Tally, by: dict[str, Test]) -> str:
    slight = [name for name in (NEES, NIS, BIAS, WHITENESS) if by[name].rejected]
    but = ", apart from deviations too slight to matter" if slight else ""
    seen = "" if slight else _could_be_seen(tally, by[NEES])
    return f"consistent{_as_far_as(by)}{but}: {', '.join(_not_rejected(by))}{seen}"


def _not_rejected(by: dict[str, Test]) -> list[str]:
    """The results of all tests that were made, for a filter without a fault."""
    parts = [_figure(by[name]) for name in (NEES, NIS) if np.isfinite(by[name].p)]
    for name, word in ((BIAS, "no bias"), (WHITENESS, "white innovations")):
        parts += [_figure(by[name]) if by[name].rejected else word] * bool(np.isfinite(by[name].p))
    return parts


def _as_far_as(by: dict[str, Test]) -> str:
    return "" if np.isfinite(by[NEES].p) else " as far as its innovations tell"


def _could_be_seen(tally: Tally, nees: Test) -> str:
    """Which NEES so many runs would have exposed, if only a large fault would have been visible."""
    if np.isfinite(nees.p):
        reach = nees.found.high / nees.found.value
        return f"; {_would_show(f'{nees.found.n} runs', nees.of, reach)}" if reach > _COARSE else ""
    enough = tally.runs >= FEWEST and not tally.repeated
    if enough or tally.sampled or not int(nees_of(tally)[1].count):
        return ""
    # At most, because a mean over time varies less than its terms: a chi-square of one step, over its n.
    error = math.sqrt(2.0 / (tally.space.size * FEWEST))
    what = "recordings" if tally.repeated else "runs"
    return f"; {_would_show(f'{FEWEST} {what}', nees.of, stretched(error, FEWEST, LEVEL / len(_JUDGED)))}"


def _would_show(runs: str, of: str, reach: float) -> str:
    """Rounded away from one, so that the stated value really is visible."""
    places = 1 - math.floor(math.log10(reach))
    above = math.ceil(reach * 10.0**places) / 10.0**places
    below = 1.0 / reach
    down = 1 - math.floor(math.log10(below))
    below = math.floor(below * 10.0**down) / 10.0**down
    high, low = f"{above:.{max(places, 0)}f}", f"{below:.{max(down, 0)}f}"
    return f"{runs} would show a {test_heading(NEES, of)} beyond {high} or below {low}"


def _undecided(tally: Tally, by: dict[str, Test]) -> str:
    """Why no test has an answer, each reason once, and what more runs would show."""
    whys = dict.fromkeys(by[name].why for name in (NEES, NIS))
    reasons = [f"a test of NEES {why}" if why.startswith("needs") else why for why in whys]
    return f"{' and '.join(reasons)}{_could_be_seen(tally, by[NEES])}"


def _lost(tally: Tally, diverged: int) -> str:
    words = {
        "not_finite": "not finite",
        "not_definite": "not positive definite",
        "lost": "still too far off at the end",
    }
    why = ", ".join(f"{tally.diverged[cause]} {words[cause]}" for cause in CAUSES if tally.diverged[cause])
    return f"lost: {diverged} of {tally.runs} run{'s' * (tally.runs > 1)} diverged ({why})"
