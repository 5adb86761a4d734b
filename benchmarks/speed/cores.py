"""Both cores against one, and memory against the number of runs.

``python -m benchmarks.speed cores`` prints these rows alone.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path

from benchmarks.speed.cases import PLAIN, Case
from benchmarks.speed.turns import Row, faster, row
from estlab.experiment.blocks import block
from estlab.experiment.monte_carlo import block_of, record_of
from estlab.maths.streams import Streams
from estlab.parallel.pool import Workers
from estlab.record import Record

OnStep = Callable[[], None]
Work = Callable[[int, OnStep], object]

RUNS = 1000
BLOCKS = range(2)
_WORDS = "scenario=car", "filter=ukf", "filter.noise=additive", f"runs={RUNS}"
CAR, AS_USUAL = Case(*_WORDS, "engine=numpy"), Case(*_WORDS)
_SAMPLED_EVERY = 0.01  # seconds


def rows() -> Iterator[Row]:
    """Filter loops of prepared blocks and whole blocks on both cores, the worker's start included; then memory.

    A process that is forked here writes to pages that it shares with a warm one: of four times as many runs, its start
    is a smaller share.
    """
    for number in BLOCKS:
        prepared(number)  # before the fork, for both processes
    work = f"car UKF, {RUNS} runs x 200 steps, engine=numpy"
    yield faster(f"{work}, both cores", both_cores(loop), PLAIN, CAR.plain_car(200), 1.0 / RUNS, 550.0)
    yield faster(f"{work}, both cores", both_cores(loop), "one core", one_core(loop), 1.0, 1.8)
    yield faster(f"four times {work}, both cores", both_cores(loop, 4), "one core", one_core(loop, 4), 1.0, 1.8)
    whole = partial(block_of, AS_USUAL.settings, None)
    simulated = f"car UKF, {RUNS} runs, simulated, filtered and scored"
    yield faster(f"{simulated}, both cores", both_cores(whole), "one core", one_core(whole), 1.0, 1.6)
    yield from memory()


@cache
def prepared(number: int) -> Record:
    """Truth and readings of a block."""
    return record_of(CAR.settings, block(CAR.settings, number))


def loop(number: int, on_step: OnStep) -> None:
    """The filter over a prepared block, one of two by turns; what it finds stays where it is."""
    number %= len(BLOCKS)
    record = prepared(number)
    CAR.loop.estimate(record, Streams(1, "benchmark").generators("filter", block(CAR.settings, number)), on_step)


def both_cores(work: Work, times: int = 1) -> Callable[[], object]:
    """All blocks, so many times, in two processes, of which one is started and ended for it."""

    def run() -> None:
        with Workers(work, range(times * len(BLOCKS)), 2) as workers:
            list(workers.results(work, lambda steps: None))

    return run


def one_core(work: Work, times: int = 1) -> Callable[[], object]:
    """The same in this process."""
    return lambda: [work(number, lambda: None) for number in range(times * len(BLOCKS))]


def memory() -> Iterator[Row]:
    """Peak memory of the radar's UKF with a million runs against a thousand: the largest process, and all at a time."""
    (small, small_all, little), (large, large_all, long) = (peaks(runs) for runs in (1_000, 1_000_000))
    for what, one, many in (("its largest process", small, large), ("all its processes", small_all, large_all)):
        work = f"radar UKF, 1,000,000 runs on both cores, memory of {what}, {many:.0f} MB"
        yield row(work, f"1,000 runs, {one:.0f} MB", [(long, little)], [many / one], goal=1.2, least=False)


def peaks(runs: int) -> tuple[float, float, float]:
    """Peak memory [MB] of an estlab run's largest process and of all at a time, shared pages counted once, and [s]."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["scenario=radar", "filter=ukf", f"runs={runs}", "block_runs=500", "cores=2", "plots=false"]
        command = [sys.executable, "-m", "estlab", "run", *words, f"hydra.run.dir={folder}/run"]
        began = time.perf_counter()
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        largest = together = 0.0
        while process.poll() is None:
            found = [memory_of(pid) for pid in family(process.pid)]
            largest = max(largest, *(peak for peak, _ in found), 0.0)
            together = max(together, sum(now for _, now in found))
            time.sleep(_SAMPLED_EVERY)
        if process.returncode:
            raise RuntimeError(f"{' '.join(command)} ended with exit code {process.returncode}")
        return largest, together, time.perf_counter() - began


def family(pid: int) -> list[int]:
    """A process and all that it started."""
    try:
        children = [
            int(child) for file in Path(f"/proc/{pid}/task").glob("*/children") for child in file.read_text().split()
        ]
    except OSError:
        return []
    return [pid, *(one for child in children for one in family(child))]


def memory_of(pid: int) -> tuple[float, float]:
    """Largest resident memory so far, and its share of what is resident now [MB]; zeros for a process that is gone."""
    try:
        peak = Path(f"/proc/{pid}/status").read_text().partition("VmHWM:")[2].split()
        now = Path(f"/proc/{pid}/smaps_rollup").read_text().partition("Pss:")[2].split()
    except OSError:
        return 0.0, 0.0
    return tuple(float(words[0]) / 1024.0 if words else 0.0 for words in (peak, now))
