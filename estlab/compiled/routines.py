"""The building blocks of a filter's steps: routines of a program, and what they need to know of models and filter."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from estlab.compiled.algebra import Matrix, Pivots, Row, block_diagonal, is_zero, symmetric
from estlab.compiled.model_graphs import MotionModel, SensorModel
from estlab.compiled.moment_matching import Points
from estlab.compiled.rules import operation
from estlab.compiled.symbols import Symbol
from estlab.compiled.trace import Tracer

Output = tuple[str, int, Any]


@dataclass(frozen=True)
class PointSet:
    """Sigma points as numbers; see moment_matching.Points. Symmetric ones are given by the square of their distance;
    others by their positions for a unit covariance (axes, p) and their weights.
    """

    spread2: float = 1.0
    listed: tuple[tuple[float, ...], ...] | None = None
    weights: tuple[float, ...] = ()
    bonus: float = 0.0


@dataclass(frozen=True)
class Method:
    """A filter, described by its steps.

    transform: linearised, with second derivatives (in which form), through points, or through points on factors.
    motion, sensor: the points for each. augmented: whether the noises go through the models with the state.
    iterations: of the update. updating: whether readings are used. gated: whether some are rejected.
    """

    transform: Literal["linearised", "gaussian", "modified", "points", "factors"]
    motion: PointSet | None = None
    sensor: PointSet | None = None
    augmented: bool = False
    iterations: int = 1
    updating: bool = True
    gated: bool = False

    @property
    def factors_noise(self) -> bool:
        """Whether the noises are given by the factors of their covariances."""
        return self.transform == "factors" or (self.augmented and self.transform == "points")


@dataclass
class Parameters:
    """Numbers that are the same in all runs and steps, and not part of the code."""

    values: list[float] = field(default_factory=list)
    _numbers: dict[str, int] = field(default_factory=dict)

    def leaf(self, tracer: Tracer, name: str, value: float) -> Symbol:
        """The parameter of this name as a component."""
        if name not in self._numbers:
            self._numbers[name] = len(self.values)
            self.values.append(float(value))
        return tracer.leaf("parameter", self._numbers[name], settled=True)


class Routine:
    """A part of the program: components in, components out."""

    def __init__(self, n: int) -> None:
        self.tracer = Tracer()
        self.outputs: list[Output] = []
        self.failed = Pivots()
        self.n = n

    def belief(self, name: str = "belief") -> tuple[Row, Matrix]:
        """Mean, and covariance or factor, as they are stored: the mean, then the lower triangle."""
        n = self.n
        mean = [self.tracer.leaf(name, i) for i in range(n)]
        return mean, symmetric(n, lambda i, j: self.tracer.leaf(name, triangular(n, i, j)))

    def keep(self, mean: Row, matrix: Matrix) -> None:
        """Store mean and lower triangle as the belief."""
        for i in range(self.n):
            self.outputs.append(("belief", i, mean[i]))
            self.outputs += [("belief", triangular(self.n, i, j), matrix[i][j]) for j in range(i + 1)]

    def choose(self, condition: Symbol, yes: Any, no: Any) -> Symbol:
        """One component or the other."""
        graph = self.tracer.graph
        parts = [part.number if isinstance(part, Symbol) else graph.constant(part) for part in (yes, no)]
        return Symbol(graph, operation(graph, "select", condition.number, *parts))


def triangular(n: int, i: int, j: int) -> int:
    """The index of entry (i, j) of the lower triangle, after n components of the mean."""
    return n + i * (i + 1) // 2 + j


def slots(n: int) -> int:
    """The size of a belief: mean, triangle, 1 if it is beyond what the code can do, number of rejected readings."""
    return triangular(n, n, 0) + 2


class Steps:
    """The routines of a filter.

    noise: which entries (i, j), j <= i, of the process noise's covariance (or factor) are not zero, in the order of
    their table. measurement_noise: rows of the covariance of the readings, and of its factor. quantiles: of the gate,
    by the number of values measured. masked: whether values may be missing.
    """

    def __init__(
        self,
        motion: MotionModel,
        sensor: SensorModel,
        method: Method,
        noise: Sequence[tuple[int, int]],
        measurement_noise: tuple[Matrix, Matrix],
        quantiles: Sequence[float],
        masked: bool,
    ) -> None:
        self.motion, self.sensor, self.method = motion, sensor, method
        self.noise, self.measurement_noise, self.quantiles = list(noise), measurement_noise, quantiles
        self.masked = masked
        self.parameters = Parameters()
        self.n = motion.space.size

    def points(self, tracer: Tracer, name: str, given: PointSet | None) -> Points:
        """Points with their numbers as parameters."""
        assert given is not None
        bonus = self.parameters.leaf(tracer, "bonus", given.bonus - 1.0)
        if given.listed is not None:
            return Points(listed=given.listed, weights=given.weights, bonus=bonus)
        scale = self.parameters.leaf(tracer, f"{name} scale", given.spread2**0.5)
        weight = self.parameters.leaf(tracer, f"{name} weight", 0.5 / given.spread2)
        return Points(scale, weight, bonus=bonus)

    def process_noise(self, tracer: Tracer) -> Matrix:
        """Its covariance or lower factor, whichever the method needs."""
        q = self.motion.noises
        rows: Matrix = [[0.0] * q for _ in range(q)]
        whole = not self.method.factors_noise
        for k, (i, j) in enumerate(self.noise):
            rows[i][j] = tracer.leaf("noise", k)
            if whole:
                rows[j][i] = rows[i][j]
        return rows

    def reading_noise(self, tracer: Tracer, factor: bool) -> Matrix:
        """The covariance of the readings' noise, or its lower factor."""
        m, count = self.sensor.single.size, self.sensor.count
        name, given = ("measurement noise factor", self.measurement_noise[1]) if factor else (
            "measurement noise", self.measurement_noise[0]
        )  # fmt: skip
        single = [
            [
                0.0
                if given[i][j] == 0.0
                else self.parameters.leaf(tracer, f"{name} {max(i, j)} {min(i, j)}", given[i][j])
                for j in range(m)
            ]
            for i in range(m)
        ]
        whole: Matrix = []
        for _ in range(count):
            whole = block_diagonal(whole, single) if whole else single
        return whole

    def given(self, routine: Routine) -> tuple[Row, Any]:
        """Command and duration of a prediction."""
        return routine.tracer.leaves("control", self.motion.controls), routine.tracer.leaf("lapse", 0, settled=True)

    def has(self, values: Row) -> Symbol | None:
        """Whether a run has any part of a reading; None: each does."""
        if not self.masked:
            return None
        present = [value == value for value in values]
        found = present[0]
        for other in present[1:]:
            found = found | other
        return found


def unless(condition: Symbol | None, routine: Routine, entry: Any, otherwise: float) -> Any:
    """An entry, or a number where the condition is true; None: it never is."""
    if condition is None or (is_zero(entry) and otherwise == 0.0):
        return entry
    return routine.choose(condition, otherwise, entry)
