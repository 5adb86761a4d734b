"""The compiled engine against plain loops and engine=numpy, and what its first start takes.

python -m benchmarks.speed compiled. Code is compiled before the clock runs, but in the last rows; the clock is the
process's own.
"""

import os
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace

from benchmarks.speed.cases import PLAIN, Case, OneReading
from benchmarks.speed.gaussian import EKF, REAL, RUNS, UKF, recording
from benchmarks.speed.turns import Row, faster, row, seconds
from estlab.compiled import cache
from estlab.experiment.monte_carlo import loop_of
from estlab.maths.streams import Streams
from estlab.parallel.cores import keep_memory
from estlab.record import Estimates

_STEPS = 1000  # of the references, whose time is scaled up
CLOCK = time.process_time  # one process and one thread: what others take of the machine does not count
COMPILED = "engine=compiled"


def rows() -> Iterator[Row]:
    """Many runs, one run of many steps, a real recording where it is, and the first compiling of each kind."""
    keep_memory()  # as a run does
    car = Case("scenario=car", *UKF, f"runs={RUNS}", COMPILED)
    steps = car.record.time.size
    work = f"car UKF, {RUNS} runs × {steps} steps, one core"
    yield faster(work, car.filtered, PLAIN, car.plain_car(steps), 1.0 / RUNS, 2500.0, clock=CLOCK)
    usual = Case("scenario=car", "filter=ukf", "runs=500", COMPILED)
    work = f"car UKF as shipped (augmented), 500 runs × {steps} steps, one core"
    yield faster(work, usual.filtered, "engine=numpy", lambda: by_numpy(usual), 1.0, 15.0, clock=CLOCK)
    for name, words, goal in (("EKF", EKF, 2500.0), ("UKF", UKF, 4000.0)):
        dense = OneReading(*words, f"runs={RUNS}", "steps=200", COMPILED)
        steps = dense.record.time.size
        work = f"landmark {name}, {RUNS} runs × {steps} steps, a reading a step, one core"
        yield faster(
            work, dense.filtered, PLAIN, dense.plain_robot(steps, name == "EKF"), 1.0 / RUNS, goal, clock=CLOCK
        )
    yield from single()
    yield from first()


def single() -> Iterator[Row]:
    """One run."""
    share = _STEPS / 30_000
    landmark = Case("scenario=landmark", *EKF, "scenario.duration=3000", "runs=1", COMPILED)
    work = "landmark EKF, 1 run × 30,000 steps"
    yield faster(
        work, landmark.filtered, PLAIN, landmark.plain_robot(_STEPS, linearised=True), share, 550.0, clock=CLOCK
    )
    car = Case("scenario=car", *UKF, "scenario.dt=0.001", "scenario.duration=30", "runs=1", COMPILED)
    yield faster("car UKF, 1 run × 30,000 steps", car.filtered, PLAIN, car.plain_car(_STEPS), share, 450.0, clock=CLOCK)
    if REAL.is_dir():
        words = "data=files", f"data.path={REAL}", "data.prefix=Robot1_"
        real = Case("scenario=landmark", *EKF, *words, "runs=1", COMPILED)
        events = real.record.time.size
        work = f"MRCLAM_Dataset6 Robot1, EKF, {events:,} events"
        yield faster(work, real.filtered, "engine=numpy", lambda: by_numpy(real, _STEPS), _STEPS / events, clock=CLOCK)
        yield recording("compiled", CLOCK)


def by_numpy(case: Case, steps: int | None = None) -> Estimates:
    """What the NumPy engine finds, in the first steps or in all."""
    settings = replace(case.settings, engine="numpy")
    loop, runs = loop_of(settings, settings.filter, case.record.landmarks), case.settings.run_numbers
    return loop.estimate(case.record.first(steps), Streams(1, "benchmark").generators("filter", runs))


def first() -> Iterator[Row]:
    """The slowest of the first compilings of each scenario's filters, from models to machine code."""
    kinds = ("ekf", "iekf", "second_order", "ukf", "ckf", "ghkf", "srukf", "srckf", "dead_reckoning")
    for scenario in ("radar", "car", "sonar", "field", "landmark", "epuck"):
        names = [name for name in kinds if (scenario, name) != ("car", "ghkf")]  # whose 729 points NumPy goes through
        spent = {name: compiling(f"scenario={scenario}", f"filter={name}") for name in names}
        slowest = max(spent, key=spent.__getitem__)
        work = f"{scenario}, first compiling of {len(names)} filters, the slowest: {slowest}"
        yield row(work, "a second and a half", [(spent[slowest], 1.5)], [spent[slowest] / 1.5], 1.0, least=False)
    spent_by_ukf = compiling("scenario=car", "filter=ukf")
    work = "car UKF as shipped (augmented), first compiling"
    yield row(work, "1.2 s", [(spent_by_ukf, 1.2)], [spent_by_ukf / 1.2], 1.0, least=False)


def compiling(*words: str) -> float:
    """Seconds from a filter and its models to compiled code, with nothing kept."""
    case = Case(*words, "runs=8", "steps=2", COMPILED)
    generators = Streams(1, "benchmark").generators("filter", case.settings.run_numbers)
    case.record  # noqa: B018 - made before the clock runs
    kept = os.environ.get("ESTLAB_CACHE")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["ESTLAB_CACHE"] = folder
        cache.lanes()  # the compiler itself is loaded
        spent = seconds(lambda: case.loop.prepare(case.record, generators), CLOCK)
    os.environ.pop("ESTLAB_CACHE")
    if kept is not None:
        os.environ["ESTLAB_CACHE"] = kept
    return spent
