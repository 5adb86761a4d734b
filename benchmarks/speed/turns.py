"""Timing by turns: what is compared is run in turn, so that a machine that is busy for a while slows both."""

import statistics
import time
from collections.abc import Callable
from typing import NamedTuple

REPEATS = 5


class Row(NamedTuple):
    """A line of the table: what was timed, its reference, and the ratio with its extremes over the repeats."""

    work: str
    seconds: float
    reference: str
    reference_seconds: float
    ratio: float
    low: float
    high: float
    goal: str
    met: bool


def faster(
    work: str, run: Callable[[], object], reference: str, plain: Callable[[], object], share: float, goal: float
) -> Row:
    """How many times faster ``run`` is than its reference.

    share: how much of the work the reference does once: a plain loop over 2 of 1000 runs does 0.002 of it, and its time
    is scaled up. goal: the least ratio.
    """
    pairs = in_turn(run, plain)
    pairs = [(seconds, reference_seconds / share) for seconds, reference_seconds in pairs]
    ratios = [reference_seconds / seconds for seconds, reference_seconds in pairs]
    ratio = statistics.median(ratios)
    return _row(work, reference, pairs, ratios, f"at least {goal:g} ×", ratio >= goal)


def within(
    work: str,
    run: Callable[[], object],
    reference: str,
    plain: Callable[[], object],
    goal: float,
    allowance: float = 0.0,
) -> Row:
    """How many times the reference's time ``run`` takes. goal: the largest ratio. allowance: seconds added to it."""
    pairs = [(seconds, reference_seconds + allowance) for seconds, reference_seconds in in_turn(run, plain)]
    ratios = [seconds / reference_seconds for seconds, reference_seconds in pairs]
    ratio = statistics.median(ratios)
    return _row(work, reference, pairs, ratios, f"at most {goal:g} ×", ratio <= goal)


def in_turn(run: Callable[[], object], plain: Callable[[], object]) -> list[tuple[float, float]]:
    """Seconds of both, turn by turn, after one turn that is not counted."""
    return [(seconds(run), seconds(plain)) for _ in range(REPEATS + 1)][1:]


def seconds(work: Callable[[], object]) -> float:
    """How long one call takes."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def _row(work: str, reference: str, pairs: list[tuple[float, float]], ratios: list[float], goal: str, met: bool) -> Row:
    run, plain = (statistics.median(column) for column in zip(*pairs, strict=True))
    return Row(work, run, reference, plain, statistics.median(ratios), min(ratios), max(ratios), goal, met)
