"""``engine=numba`` on long single recordings, against plain loops and the NumPy engine; compiled before the clock runs.

python -m benchmarks.speed compiled
"""

from collections.abc import Iterator
from dataclasses import replace

from benchmarks.speed.cases import PLAIN, Case
from benchmarks.speed.gaussian import REAL, recording
from benchmarks.speed.turns import Row, faster
from estlab.ensemble import loop_of
from estlab.maths.streams import Streams
from estlab.record import Estimates

GOAL = 100.0
_STEPS = 1000  # of the references, whose time is scaled up


def rows() -> Iterator[Row]:
    """Landmark EKF and car UKF on 30,000 steps; a real recording, where it is, against the NumPy engine."""
    share = _STEPS / 30_000
    landmark = Case("scenario=landmark", "filter=ekf", "scenario.duration=3000", "runs=1", "engine=numba")
    work = "landmark EKF, 1 run × 30,000 steps, engine=numba"
    yield faster(work, landmark.filtered, PLAIN, landmark.plain_robot(_STEPS, linearised=True), share, GOAL)
    brief = "scenario.dt=0.001", "scenario.duration=30"
    car = Case("scenario=car", "filter=ukf", "filter.noise=additive", *brief, "runs=1", "engine=numba")
    work = "car UKF, 1 run × 30,000 steps, engine=numba"
    yield faster(work, car.filtered, PLAIN, car.plain_car(_STEPS), share, GOAL)
    if REAL.is_dir():
        words = "data=files", f"data.path={REAL}", "data.prefix=Robot1_"
        real = Case("scenario=landmark", "filter=ekf", *words, "runs=1", "engine=numba")
        events = real.record.time.size
        work = f"MRCLAM_Dataset6 Robot1, EKF, {events:,} events, engine=numba"
        yield faster(work, real.filtered, "engine=numpy", lambda: by_numpy(real), _STEPS / events)
        yield recording("numba")


def by_numpy(case: Case) -> Estimates:
    """What the NumPy engine finds in the first steps."""
    settings = replace(case.settings, engine="numpy")
    loop = loop_of(settings, settings.filter, case.record.places)
    return loop.estimate(case.record.first(_STEPS), Streams(1, "benchmark").draws("filter", range(1)))
