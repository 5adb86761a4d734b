"""How the cost of a filter grows with runs, steps, states and particles: python -m benchmarks.speed.growth

Draws docs/images/performance_growth.png and prints the figures that it shows, medians of three.
"""

import statistics
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.speed.cases import Case
from benchmarks.speed.turns import seconds
from estlab.filters.gaussian import extended, unscented
from estlab.filters.loop import Loop
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Space
from estlab.maths.streams import Streams
from estlab.models.contract import Motion, Sensor
from estlab.record import Readings, Record

IMAGE = Path(__file__).resolve().parents[2] / "docs" / "images" / "performance_growth.png"
REPEATS = 3
EKF, UKF = extended("additive", None), unscented("merwe", 1.0, 2.0, 0.0, "additive", None)

Curve = tuple[str, list[int], Callable[[int], Callable[[], object]]]


def curves() -> dict[str, list[Curve]]:
    """By what grows: a name, the sizes, and what is timed at a size."""
    runs = [1, 3, 10, 30, 100, 300, 1000, 3000]
    return {
        "runs (one block)": [
            ("car UKF, 50 steps", runs, lambda size: car(size, 50)),
            ("landmark EKF, 50 steps", runs, lambda size: landmark(size, 50)),
        ],
        "steps (100 runs)": [
            ("car UKF", [30, 100, 300, 1000, 3000], lambda size: car(100, size)),
            ("landmark EKF", [30, 100, 300, 1000, 3000], lambda size: landmark(100, size)),
        ],
        "states (500 runs, 20 steps)": [
            ("chain UKF", [1, 2, 4, 8, 16], lambda size: chain(size, UKF)),
            ("chain EKF", [1, 2, 4, 8, 16, 32], lambda size: chain(size, EKF)),
        ],
        "particles (20 steps)": [
            ("sonar PF, 1 run", [100, 1000, 10_000, 100_000], lambda size: sonar(size, 1)),
            ("sonar PF, 10 runs", [100, 1000, 10_000], lambda size: sonar(size, 10)),
        ],
    }


def main() -> None:
    """Time all, print and draw."""
    figure = Figure(figsize=(9.0, 6.6), layout="constrained")
    panels = figure.subplots(2, 2).ravel()
    for axes, (what, several) in zip(panels, curves().items(), strict=True):
        for name, sizes, work in several:
            spent = [median(work(size)) for size in sizes]
            print(f"{what}, {name}: " + ", ".join(f"{a} {1e3 * b:.3g} ms" for a, b in zip(sizes, spent, strict=True)))
            axes.loglog(sizes, spent, "o-", ms=4, label=name)
        (low, high), limits = axes.get_xlim(), axes.get_ylim()
        bottom = limits[1] / (high / low)
        axes.loglog([low, high], [bottom, bottom * high / low], "--", color="0.6", lw=1.0, label="in proportion")
        axes.set_ylim(limits)
        axes.set_xlabel(what)
        axes.set_ylabel("seconds, one core")
        axes.grid(alpha=0.3, which="both")
        axes.legend(fontsize="small")
    figure.savefig(IMAGE, dpi=100)
    print(IMAGE)


def median(work: Callable[[], object]) -> float:
    """Seconds, after one turn that is not counted."""
    return statistics.median([seconds(work) for _ in range(REPEATS + 1)][1:])


def car(runs: int, steps: int) -> Callable[[], object]:
    """The car's UKF."""
    words = "filter.noise=additive", f"runs={runs}", f"scenario.duration={steps / 10}"
    case = Case("scenario=car", "filter=ukf", *words, "scenario.truth=model")
    return after_its_record(case)


def landmark(runs: int, steps: int) -> Callable[[], object]:
    """The landmark scenario's EKF."""
    return after_its_record(Case("scenario=landmark", "filter=ekf", f"runs={runs}", f"scenario.duration={steps / 10}"))


def sonar(particles: int, runs: int) -> Callable[[], object]:
    """The sonar scenario's particle filter."""
    words = f"filter.particles={particles}", f"runs={runs}", "scenario.duration=2"
    return after_its_record(Case("scenario=sonar", "filter=pf", *words))


def after_its_record(case: Case) -> Callable[[], object]:
    """The case's filter, when its record has been made."""
    assert case.record.runs == len(case.settings.run_numbers)
    return case.filtered


def chain(states: int, filter: object) -> Callable[[], object]:
    """A chain of integrators, of which the first is measured and the last is driven by noise, in 500 runs."""
    runs, steps, dt = 500, 20, 0.1
    space = Space(tuple(f"x{i}" for i in range(states)), ("m",) * states)
    motion = Motion(space, _integrate, lambda control, dt: np.eye(1) * dt, 1, _jacobians)
    sensor = Sensor(Space(("first",), ("m",)), space, _first, np.eye(1), np.empty((0, 1)), _first_jacobian)
    rng = Streams(1, "chain").generator("readings", 0)
    readings = Readings(np.arange(steps), rng.standard_normal((1, steps, runs)), np.zeros((steps, runs), dtype=int))
    truth, prior = np.zeros((states, steps, runs)), Gaussian(np.zeros((states, runs)), np.eye(states))
    record = Record(0.0, dt * np.arange(1, steps + 1), truth, np.empty((0, steps, 1)), readings, prior)
    loop = Loop(filter, motion, sensor)
    return lambda: loop.estimate(record, Streams(1, "chain").generators("filter", range(runs)))


def _integrate(state, control, noise, dt):
    nexts = [*state[1:], noise[0]]
    return tuple(x + dt * nexts[i] for i, x in enumerate(state))


def _jacobians(state, control, dt) -> tuple[list[list[float]], list[list[float]]]:
    n = len(state)
    in_state = [[1.0 if j == i else dt if j == i + 1 else 0.0 for j in range(n)] for i in range(n)]
    return in_state, [[dt if i == n - 1 else 0.0] for i in range(n)]


def _first(state, landmark):
    return (state[0],)


def _first_jacobian(state, landmark) -> Iterator[list[float]]:
    return [[1.0, *[0.0] * (len(state) - 1)]]


if __name__ == "__main__":
    main()
