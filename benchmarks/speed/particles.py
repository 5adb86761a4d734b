"""The particle filter on the sonar scenario, against plain NumPy vectorised over the particles.

python -m benchmarks.speed particles
"""

from collections.abc import Iterator

import numpy as np

from benchmarks.speed.cases import settings_of
from benchmarks.speed.plain_particles import Found, Problem, bootstrap
from benchmarks.speed.turns import Row, faster
from estlab.experiment.monte_carlo import loop_of
from estlab.maths.streams import Streams
from estlab.record import Estimates, Record

REFERENCE = "plain NumPy over the particles, run by run"
SEED = 1


def rows() -> Iterator[Row]:
    """A thousand particles in a hundred runs, and a hundred thousand in one."""
    many = Case(1000, range(100), 50)
    few = range(4)
    share = len(few) / len(many.runs)
    work = "sonar pf, 1000 particles × 100 runs × 50 steps, one core"
    yield faster(work, many.estimated, REFERENCE, lambda: [many.plain(run) for run in few], share, 2.0)
    large = Case(100_000, range(1), 20)
    work = "sonar pf, 100,000 particles × 1 run × 20 steps, one core"
    yield faster(work, large.estimated, REFERENCE, lambda: large.plain(0), 1.0, 3.0)


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
