"""The Gaussian family by NumPy on one core, against the plain loop.

python -m benchmarks.speed gaussian
"""

import contextlib
import io
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks.speed.cases import PLAIN, Case, OneReading
from benchmarks.speed.reference import unscented_by_matrices
from benchmarks.speed.turns import REPEATS, Row, faster, row, seconds
from estlab.experiment import experiment
from estlab.experiment.monte_carlo import record_of
from estlab.rundir import RunDirectory

RUNS = 1000
EKF, UKF = ("filter=ekf",), ("filter=ukf", "filter.noise=additive")
REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "MRCLAM_Dataset6"
_MOST = 40e-6  # seconds an event


def rows() -> Iterator[Row]:
    """The car's UKF and the landmark scenario's EKF and UKF; then a real recording, where it is."""
    car = "scenario=car", "filter=ukf", "filter.noise=additive", "engine=numpy"
    many, one = Case(*car, f"runs={RUNS}"), Case(*car, "runs=1")
    steps, share = many.record.time.size, 1.0 / RUNS
    work = f"car UKF, {RUNS} runs × {steps} steps, one core, engine=numpy"
    yield faster(work, many.filtered, PLAIN, many.plain_car(steps), share, 300.0)
    by_matrices = many.plain_car(steps, unscented_by_matrices)
    yield faster(work, many.filtered, f"{PLAIN}, its sums as products of matrices", by_matrices, share)
    yield faster(f"car UKF, 1 run × {steps} steps, engine=numpy", one.filtered, PLAIN, one.plain_car(steps), 1.0, 6.0)
    for name, words in (("EKF", EKF), ("UKF", UKF)):
        dense, usual = (
            OneReading(*words, f"runs={RUNS}", "steps=200", "engine=numpy"),
            Case("scenario=landmark", *words, f"runs={RUNS}", "engine=numpy"),
        )
        for case, what, goal in ((dense, "a reading a step", 300.0), (usual, "readings as they come", None)):
            steps = case.record.time.size
            work = f"landmark {name}, {RUNS} runs × {steps} steps, {what}, one core, engine=numpy"
            yield faster(work, case.filtered, PLAIN, case.plain_robot(steps, name == "EKF"), share, goal)
    if REAL.is_dir():
        yield recording("numpy")


def recording(engine: str, clock: Callable[[], float] = time.perf_counter) -> Row:
    """A real recording from its files to all tables, less the time that reading takes."""
    words = "scenario=landmark", "filter=ekf", "data=files", f"data.path={REAL}", "data.prefix=Robot1_"
    case = Case(*words, "runs=1", "plots=false", "report=false", f"engine={engine}")
    events = case.record.time.size

    def run() -> None:
        with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
            experiment.run(case.settings, RunDirectory(Path(folder) / "run"), [])

    def read() -> None:
        record_of(case.settings, range(1))

    run()
    pairs = [(seconds(run, clock) - seconds(read, clock), _MOST * events) for _ in range(REPEATS)]
    work = f"MRCLAM_Dataset6 Robot1, EKF, {events:,} events, after reading, to all tables, engine={engine}"
    return row(work, "40 µs an event", pairs, [spent / most for spent, most in pairs], goal=1.0, least=False)
