"""False alarms and power of every test that estlab ships, on a linear problem whose filter is exact.

    python benchmarks/calibration.py [replications]

prints two Markdown tables: how often each test rejects at nominal 5 % where nothing is wrong, with the binomial
interval of that share, and how often where a fault is planted. 2000 replications take about three minutes on one core.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from estlab.filters.gaussian import extended
from estlab.filters.loop import Loop
from estlab.maths.gaussian_belief import Gaussian
from estlab.maths.space import Array, Space
from estlab.maths.streams import Streams
from estlab.metrics.consistency import BIAS, NEES, NIS, WHITENESS, Test, consistency_tests
from estlab.metrics.digits import bracketed
from estlab.metrics.intervals import chi_square_test, positive_interval, share_interval
from estlab.metrics.paired import Comparison
from estlab.metrics.tabulated import coverage_rows
from estlab.metrics.tally import Tally
from estlab.metrics.verdict import CONSISTENT, Tolerance, judge
from estlab.models.contract import Motion, Sensor
from estlab.record import Estimates, Readings, Record

STATE = Space(("position", "velocity"), ("m", "m/s"))
READING = Space(("position",), ("m",))
DT, Q, R = 0.1, 1.0, 0.25  # acceleration noise [m^2/s^3] and reading noise [m^2]
P0 = np.diag([1.0, 1.0])
TESTS = (NEES, NIS, BIAS, WHITENESS)


@dataclass(frozen=True)
class Fault:
    """What the truth has that the filter does not know: factors on the variances, a bias and a correlation of readings.

    bias: in standard deviations of a reading. correlation: of a reading's noise with that of the reading before.
    """

    process: float = 1.0
    measurement: float = 1.0
    bias: float = 0.0
    correlation: float = 0.0


# What is planted is told from the filter's side: its Q halved is a truth with twice the Q.
FAULTS = {
    "Q halved": Fault(process=2.0),
    "Q doubled": Fault(process=0.5),
    "R halved": Fault(measurement=2.0),
    "R doubled": Fault(measurement=0.5),
    "R four times": Fault(measurement=0.25),
    "bias of half a sigma": Fault(bias=0.5),
    "correlated noise (0.5)": Fault(correlation=0.5),
    "R doubled, correlated noise (0.5)": Fault(measurement=0.5, correlation=0.5),
}


def move(state: Array, control: Array, noise: Array, dt: float) -> tuple[Array, Array]:
    """A point pushed at random."""
    position, velocity = state
    (push,) = noise
    return position + dt * velocity + 0.5 * dt * dt * push, velocity + dt * push


MOTION = Motion(STATE, move, lambda control, dt: np.array([[Q / dt]]), 1)
SENSOR = Sensor(READING, STATE, lambda state, landmark: (state[0],), np.array([[R]]), np.empty((0, 1)))


def records(fault: Fault, runs: int, steps: int, seed: int, missing: float = 0.0) -> Record:
    """Truth drawn about the prior's mean, readings with the fault, a share of them missing."""
    random = np.random.default_rng(seed)
    state = np.sqrt(np.diag(P0))[:, None] * random.standard_normal((2, runs))
    truth, values = np.empty((2, steps, runs)), np.empty((1, steps, runs))
    blur = random.standard_normal(runs)
    for k in range(steps):
        push = np.sqrt(fault.process * Q / DT) * random.standard_normal((1, runs))
        state = np.stack(move(state, np.empty(0), push, DT))
        blur = fault.correlation * blur + np.sqrt(1.0 - fault.correlation**2) * random.standard_normal(runs)
        truth[:, k] = state
        values[0, k] = state[0] + np.sqrt(R) * (np.sqrt(fault.measurement) * blur + fault.bias)
    values[0, random.random((steps, runs)) < missing] = np.nan
    readings = Readings(np.arange(steps), values, np.zeros((steps, runs), dtype=int))
    prior = Gaussian(np.zeros((2, runs)), P0)
    return Record(0.0, DT * np.arange(1, steps + 1), truth, np.empty((0, steps, 1)), readings, prior)


def filtered(record: Record, gate: float | None = None) -> Estimates:
    """By the Kalman filter."""
    return Loop(extended("additive", gate), MOTION, SENSOR).estimate(
        record, Streams(1, "calibration").generators("none", ())
    )


def ensembles(
    fault: Fault,
    replications: int,
    runs: int,
    steps: int,
    missing: float = 0.0,
    seed: int = 1,
    gate: float | None = None,
) -> Iterator[Tally]:
    """The tallies of so many independent ensembles of so many runs."""
    at_once = max(1, 20_000 // runs)
    for begin in range(0, replications, at_once):
        count = min(at_once, replications - begin)
        record = records(fault, count * runs, steps, seed=seed + begin, missing=missing)
        estimates = filtered(record, gate)
        for i in range(count):
            part = slice(i * runs, (i + 1) * runs)
            tally = Tally(STATE, record.time)
            tally.add(_runs(record, part), _estimates(estimates, part), range(runs))
            yield tally


def sampled_ensembles(replications: int, runs: int, size: int, weighted: bool, seed: int = 1) -> Iterator[Tally]:
    """Clouds of states drawn where the truth is drawn, as an ensemble or a particle filter answers with.

    weighted: drawn from a Gaussian twice as wide and weighted, so that the effective sample size is what counts.
    """
    random = np.random.default_rng(seed)
    steps = 10  # independent of each other
    readings = Readings(np.empty(0, dtype=int), np.empty((1, 0, runs)), np.empty((0, runs), dtype=int))
    for _ in range(replications):
        truth = random.standard_normal((2, steps, runs))
        cloud = random.standard_normal((2, size, steps, runs)) * (np.sqrt(2.0) if weighted else 1.0)
        weight = np.exp(-0.25 * (cloud**2).sum(axis=0)) if weighted else np.ones((size, steps, runs))
        weight /= weight.sum(axis=0)
        effective = 1.0 / (weight**2).sum(axis=0)
        mean = (weight * cloud).sum(axis=1)
        off = cloud - mean[:, None]
        cov = np.einsum("iptr,jptr->ijtr", weight * off, off)
        scale = 1.0 - 1.0 / effective
        if not weighted:  # the ensemble filter's covariance is the unbiased one
            cov, scale = cov / scale, np.ones_like(scale)
        sample = np.stack([effective, scale])
        prior = Gaussian(mean[:, 0], P0)
        record = Record(0.0, np.arange(1.0, steps + 1), truth, np.empty((0, steps, 1)), readings, prior)
        tally = Tally(STATE, record.time)
        tally.add(
            record, Estimates(mean, cov, readings.values, np.zeros_like(readings.values), sample, {}), range(runs)
        )
        yield tally


def comparisons(replications: int, runs: int, excess: float, seed: int = 1) -> Iterator[float]:
    """p-values of the difference of the Kalman filter disturbed twice, once with so much more variance."""
    record = records(Fault(), replications * runs, 30, seed)
    estimates, random = filtered(record), np.random.default_rng([seed, 1])
    disturbed = {
        name: replace(estimates, mean=estimates.mean + np.sqrt(variance) * random.standard_normal(estimates.mean.shape))
        for name, variance in (("a", 0.02), ("b", 0.02 + excess))
    }
    for i in range(replications):
        part = slice(i * runs, (i + 1) * runs)
        comparison = Comparison(STATE)
        comparison.add(
            {
                name: Tally(STATE, record.time).add(_runs(record, part), _estimates(found, part), range(runs))
                for name, found in disturbed.items()
            }
        )
        yield comparison.rows({})[0]["p"]


def rejections(tallies: Iterator[Tally]) -> dict[str, Array]:
    """Whether each test rejected by itself at 5 %, and the verdict was another than consistent; (replications,)."""
    found: dict[str, list[float]] = {name: [] for name in (*TESTS, "verdict")}
    for tally in tallies:
        tests = consistency_tests(tally)
        for test in tests:
            found[test.name].append(_rejected(test))
        found["verdict"].append(judge(tally, tests, Tolerance(0.0, 0.01)).word != CONSISTENT)
    return {name: np.array(values) for name, values in found.items()}


def verdicts(tallies: Iterator[Tally]) -> dict[str, float]:
    """Share of each verdict and key."""
    said = [judge(tally, consistency_tests(tally), Tolerance(0.05, 0.01)) for tally in tallies]
    words = [f"{verdict.word} {verdict.key}".strip() for verdict in said]
    return {word: words.count(word) / len(words) for word in dict.fromkeys(words)}


def counted_naively(tallies: Iterator[Tally]) -> Array:
    """Whether a chi-square test rejects that takes the NEES of all steps for independent; (replications,)."""
    totals = ((tally.sums["nees"].sum(), tally.sums["nees_runs"].sum() * STATE.size) for tally in tallies)
    return np.array([chi_square_test(total, freedom) < 0.05 for total, freedom in totals])


def coverage_misses(tallies: Iterator[Tally]) -> dict[str, Array]:
    """Whether the interval of each share within 1 and 2 sigma, jointly, leaves out its nominal value."""
    found: dict[str, list[float]] = {}
    for tally in tallies:
        for row in coverage_rows(tally):
            if row["component"] == "all" and row["sigmas"] < 3:
                miss = not row["ci_low"] <= row["nominal"] <= row["ci_high"]
                found.setdefault(f"coverage, {row['sigmas']} sigma, {row['when']}", []).append(miss)
    return {name: np.array(values) for name, values in found.items()}


def _rejected(test: Test) -> float:
    return np.nan if np.isnan(test.p) else float(test.p < 0.05)


def _runs(record: Record, part: slice) -> Record:
    readings = record.readings
    return replace(
        record,
        truth=record.truth[..., part],
        readings=replace(
            readings, values=readings.values[..., part], landmark_number=readings.landmark_number[:, part]
        ),
    )


def _estimates(estimates: Estimates, part: slice) -> Estimates:
    return replace(
        estimates,
        mean=estimates.mean[..., part],
        cov=estimates.cov[..., part],
        whitened=estimates.whitened[..., part],
        log_scale=estimates.log_scale[..., part],
        notes={},
    )


def _share(hits: Array) -> str:
    hits = hits[~np.isnan(hits.astype(float))]
    if hits.size == 0:
        return "-"
    found = share_interval(float(hits.mean()), hits.size)
    return f"{100 * found.value:.1f} [{100 * found.low:.1f}, {100 * found.high:.1f}]"


def _table(heads: list[str], rows: Iterator[list[str]]) -> None:
    print("| " + " | ".join(heads) + " |")
    print("|" + "---|" * len(heads))
    for row in rows:
        print("| " + " | ".join(row) + " |", flush=True)
    print()


def main(replications: int) -> None:
    """Print the tables."""
    print(f"False alarms in % at nominal 5 %, {replications} replications\n")
    matched: dict[str, Callable[[], Iterator[Tally]]] = {
        "100 runs, 100 steps": lambda: ensembles(Fault(), replications, 100, 100),
        "20 runs, 100 steps": lambda: ensembles(Fault(), replications, 20, 100),
        "5 runs, 100 steps": lambda: ensembles(Fault(), replications, 5, 100),
        "100 runs, 1 step": lambda: ensembles(Fault(), replications, 100, 1),
        "20 runs, 100 steps, 30 % of readings missing": lambda: ensembles(Fault(), replications, 20, 100, 0.3),
        "20 runs, 100 steps, filter.gate=0.99": lambda: ensembles(Fault(), replications, 20, 100, gate=0.99),
        "1 run, 200 steps": lambda: ensembles(Fault(), replications, 1, 200),
        "samples of 8, 50 runs": lambda: sampled_ensembles(replications, 50, 8, False),
        "samples of 30, 50 runs": lambda: sampled_ensembles(replications, 50, 30, False),
        "weighted samples of 400, 50 runs": lambda: sampled_ensembles(replications, 50, 400, True),
    }
    _table(
        ["matched problem", *TESTS, "verdict"],
        ([name, *(_share(hits) for hits in rejections(make()).values())] for name, make in matched.items()),
    )
    for size in (140, 400):
        (tally,) = sampled_ensembles(1, 20_000, size, True)
        found = positive_interval(tally.moments["nees"])
        print(f"mean NEES over that of its law, weighted samples of {size}: {bracketed(found)}\n")
    misses = {
        f"{name}, {runs} runs": hits
        for runs in (100, 5)
        for name, hits in coverage_misses(ensembles(Fault(), replications, runs, 100)).items()
    }
    differences = {
        "difference of two equal filters, 100 runs": np.array(list(comparisons(replications, 100, 0.0))) < 0.05,
        "difference of two equal filters, 10 runs": np.array(list(comparisons(replications, 10, 0.0))) < 0.05,
    }
    _table(["intervals and comparison", "misses"], ([k, _share(v)] for k, v in (misses | differences).items()))
    naive = _share(counted_naively(ensembles(Fault(), replications, 20, 200)))
    print(f"For comparison, a chi-square test of NEES that treats steps as independent, 20 runs, 200 steps: {naive}\n")
    print(f"Power in % at nominal 5 %, {replications // 4} replications\n")
    cases = [(name, fault, runs) for name, fault in FAULTS.items() for runs in (20, 100)]
    _table(
        ["planted fault", *TESTS, "verdict"],
        (
            [
                f"{name}, {runs} runs",
                *(_share(h) for h in rejections(ensembles(fault, replications // 4, runs, 100)).values()),
            ]
            for name, fault, runs in cases
        ),
    )
    more = np.array(list(comparisons(replications // 4, 100, 0.01))) < 0.05
    print(f"a filter with 0.01 m^2 more error variance than another, 100 runs: {_share(more)}\n")
    _table(
        ["planted fault, 100 runs", "verdicts and the key that each names, in %"],
        (
            [
                name,
                ", ".join(
                    f"{100 * v:.0f} {k}" for k, v in verdicts(ensembles(fault, replications // 4, 100, 100)).items()
                ),
            ]
            for name, fault in FAULTS.items()
        ),
    )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
