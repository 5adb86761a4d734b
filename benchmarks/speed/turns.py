"""Timing by turns: what is compared is run in turn, so that a machine that is busy for a while slows both."""

import statistics
import time
from collections.abc import Callable
from typing import NamedTuple

REPEATS = 5


class Row(NamedTuple):
    """A line of the table: what was timed, its reference, and the ratio with its extremes over the repeats.

    goal: in words, empty for none. met: whether it was; None for none.
    """

    work: str
    seconds: float
    reference: str
    reference_seconds: float
    ratio: float
    low: float
    high: float
    goal: str
    met: bool | None


def faster(
    work: str,
    run: Callable[[], object],
    reference: str,
    plain: Callable[[], object],
    share: float,
    goal: float | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> Row:
    """How many times faster ``run`` is than its reference.

    share: how much of the work the reference does once: a plain loop over 2 of 1000 runs does 0.002 of it, and its time
    is scaled up. goal: the least ratio, None for none. clock: of the process's own time where a machine is shared.
    """
    pairs = [(spent, plain_spent / share) for spent, plain_spent in in_turn(run, plain, clock)]
    return row(work, reference, pairs, [plain_spent / spent for spent, plain_spent in pairs], goal, least=True)


def within(
    work: str,
    run: Callable[[], object],
    reference: str,
    plain: Callable[[], object],
    goal: float,
    allowance: float = 0.0,
    clock: Callable[[], float] = time.perf_counter,
) -> Row:
    """How many times the reference's time ``run`` takes. goal: the largest ratio. allowance: seconds added to it.

    clock: as that of :func:`faster`.
    """
    pairs = [(spent, plain_spent + allowance) for spent, plain_spent in in_turn(run, plain, clock)]
    return row(work, reference, pairs, [spent / plain_spent for spent, plain_spent in pairs], goal, least=False)


def in_turn(
    run: Callable[[], object], plain: Callable[[], object], clock: Callable[[], float] = time.perf_counter
) -> list[tuple[float, float]]:
    """Seconds of both, turn by turn, after one turn that is not counted."""
    return [(seconds(run, clock), seconds(plain, clock)) for _ in range(REPEATS + 1)][1:]


def seconds(work: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    """How long one call takes."""
    began = clock()
    work()
    return clock() - began


def row(
    work: str, reference: str, pairs: list[tuple[float, float]], ratios: list[float], goal: float | None, least: bool
) -> Row:
    """Medians of the repeats. pairs: seconds of the work and of its reference. least: whether the goal is the least."""
    run, plain = (statistics.median(column) for column in zip(*pairs, strict=True))
    ratio = statistics.median(ratios)
    words = "" if goal is None else f"at {'least' if least else 'most'} {goal:g}"
    met = None if goal is None else (ratio >= goal if least else ratio <= goal)
    return Row(work, run, reference, plain, ratio, min(ratios), max(ratios), words, met)
