"""The particle filter on the sonar scenario, against plain NumPy vectorised over the particles.

python -m benchmarks.speed particles. Code is compiled before the clock runs; the clock is the process's own.
"""

import time
from collections.abc import Iterator
from functools import partial

import numpy as np

from benchmarks.speed.cases import settings_of
from benchmarks.speed.plain_particles import Found, Problem, bootstrap
from benchmarks.speed.turns import Row, faster
from estlab.experiment.monte_carlo import loop_of
from estlab.maths.streams import Streams
from estlab.record import Estimates, Record

REFERENCE = "plain NumPy over the particles, run by run"
SEED = 1
CLOCK = time.process_time  # one process and one thread: what others take of the machine does not count


def rows() -> Iterator[Row]:
    """A thousand particles in a hundred runs, a hundred in a thousand, and a hundred thousand in one."""
    few = range(4)
    for particles, runs, steps, numpy in ((1000, 100, 50, 2.0), (100, 1000, 50, None), (100_000, 1, 20, 3.0)):
        for engine, goal in (("numpy", numpy), ("compiled", 8.0)):
            case = Case(particles, range(runs), steps, engine)
            some = few[:runs]
            one = "run" if runs == 1 else "runs"
            ending = ", engine=numpy" if engine == "numpy" else ""
            work = f"sonar pf, {particles:,} particles × {runs:,} {one} × {steps} steps, one core{ending}"
            yield faster(work, case.estimated, REFERENCE, partial(case.plain_runs, some), len(some) / runs, goal, CLOCK)


class Case:
    """The sonar scenario's robots, and both filters over them with the same random numbers."""

    def __init__(self, particles: int, runs: range, steps: int, engine: str = "compiled") -> None:
        settings = settings_of("scenario=sonar", "filter=pf", f"filter.particles={particles}", f"engine={engine}")
        scenario, noise = settings.scenario, settings.noise.filter
        self.runs, self.particles = runs, particles
        self.record: Record = scenario.simulate(Streams(SEED, "sonar"), runs, noise).first(steps)
        self.loop = loop_of(settings, settings.filter, self.record.landmarks)
        sds = np.array(scenario.process_sd), np.array(scenario.measurement_sd)
        self.problem = Problem(self.record.prior.low, self.record.prior.high, self.record.landmarks.T, *sds)

    def estimated(self) -> Estimates:
        """What estlab finds in all runs."""
        return self.loop.estimate(self.record, Streams(SEED, "sonar").generators("filter/pf", self.runs))

    def plain(self, run: int) -> Found:
        """What the reference finds in one run."""
        moved, heard = self.record.control[:, :, run].T, self.record.readings.values[:, :, run].T
        rng = Streams(SEED, "sonar").generator("filter/pf", self.runs[run])
        return bootstrap(self.problem, moved, heard, self.particles, rng)

    def plain_runs(self, runs: range) -> list[Found]:
        """What it finds in several."""
        return [self.plain(run) for run in runs]
