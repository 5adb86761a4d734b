"""The steps of a filter as pieces of a program: prediction, update, and what is kept of each step.

What is written here for components is what estlab.filters writes for arrays; tests hold both to each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from estlab.compiled.algebra import Matrix, Pivots, Row, added, block_diagonal, is_zero, minus, plus, sandwich
from estlab.compiled.algebra import solve_lower, solve_lower_transposed, symmetric, times, total, transpose
from estlab.compiled.models import MotionModel, SensorModel, wrap, wrapped
from estlab.compiled.moments import Moments, Points, along_tangent, bent, by_points, factored
from estlab.compiled.rules import operation
from estlab.compiled.symbols import Symbol
from estlab.compiled.trace import Tracer

Output = tuple[str, int, Any]


@dataclass(frozen=True)
class PointSet:
    """Sigma points as numbers; see estlab.compiled.moments.Points. Symmetric ones are given by the square of their
    distance; others by their places for a unit covariance (axes, p) and their weights.
    """

    spread2: float = 1.0
    listed: tuple[tuple[float, ...], ...] | None = None
    weights: tuple[float, ...] = ()
    bonus: float = 0.0


@dataclass(frozen=True)
class Method:
    """A filter, by what its steps do.

    transform: along tangents, with second derivatives (of which form), through points, or through points on factors.
    motion, sensor: the points for each. augmented: whether the noises go through the models with the state.
    iterations: of the update. updating: whether readings are used. gated: whether some are refused.
    """

    transform: Literal["tangent", "gaussian", "modified", "points", "factors"]
    motion: PointSet | None = None
    sensor: PointSet | None = None
    augmented: bool = False
    iterations: int = 1
    updating: bool = True
    gated: bool = False


@dataclass
class Parameters:
    """Numbers that are the same in all runs and steps, and no part of the code."""

    values: list[float] = field(default_factory=list)
    _numbers: dict[str, int] = field(default_factory=dict)

    def leaf(self, tracer: Tracer, name: str, value: float) -> Symbol:
        """The parameter of this name as a component."""
        if name not in self._numbers:
            self._numbers[name] = len(self.values)
            self.values.append(float(value))
        return tracer.leaf("parameter", self._numbers[name], settled=True)


class Piece:
    """A part of the program: components in, components out."""

    def __init__(self, n: int) -> None:
        self.tracer = Tracer()
        self.outputs: list[Output] = []
        self.failed = Pivots()
        self.n = n

    def belief(self, name: str = "belief") -> tuple[Row, Matrix]:
        """Mean, and covariance or factor, as they are kept: the mean, then the lower triangle."""
        n = self.n
        mean = [self.tracer.leaf(name, i) for i in range(n)]
        return mean, symmetric(n, lambda i, j: self.tracer.leaf(name, triangular(n, i, j)))

    def keep(self, mean: Row, matrix: Matrix) -> None:
        """Put mean and lower triangle in the place of the belief."""
        for i in range(self.n):
            self.outputs.append(("belief", i, mean[i]))
            self.outputs += [("belief", triangular(self.n, i, j), matrix[i][j]) for j in range(i + 1)]

    def choose(self, condition: Symbol, yes: Any, no: Any) -> Symbol:
        """One component or the other."""
        graph = self.tracer.graph
        parts = [part.number if isinstance(part, Symbol) else graph.constant(part) for part in (yes, no)]
        return Symbol(graph, operation(graph, "select", condition.number, *parts))


def triangular(n: int, i: int, j: int) -> int:
    """Where entry (i, j) of the lower triangle is kept, after n components of the mean."""
    return n + i * (i + 1) // 2 + j


def slots(n: int) -> int:
    """How many numbers a belief has: mean, triangle, then 1 if it is beyond what the code can do, and readings refused."""
    return triangular(n, n, 0) + 2


class Steps:
    """The pieces of a filter.

    noise: which entries (i, j), j <= i, of the process noise's covariance (or factor) are not zero, in the order of the
    table they come from. measurement_noise: rows of the covariance of the readings, and of its factor.
    quantiles: of the gate, by how many numbers were measured.
    """

    def __init__(
        self,
        motion: MotionModel,
        sensor: SensorModel,
        method: Method,
        noise: Sequence[tuple[int, int]],
        measurement_noise: tuple[Matrix, Matrix],
        quantiles: Sequence[float],
    ) -> None:
        self.motion, self.sensor, self.method = motion, sensor, method
        self.noise, self.measurement_noise, self.quantiles = list(noise), measurement_noise, quantiles
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
        """Its covariance or lower factor, by what the method wants."""
        q = self.motion.noises
        rows: Matrix = [[0.0] * q for _ in range(q)]
        whole = not self.factors_noise
        for k, (i, j) in enumerate(self.noise):
            rows[i][j] = tracer.leaf("noise", k)
            if whole:
                rows[j][i] = rows[i][j]
        return rows

    @property
    def factors_noise(self) -> bool:
        """Whether the noises are given by the factors of their covariances."""
        return self.method.transform == "factors" or (self.method.augmented and self.method.transform == "points")

    def reading_noise(self, tracer: Tracer, factor: bool) -> Matrix:
        """The covariance of the readings' noise, or its lower factor."""
        m, count = self.sensor.single.size, self.sensor.count
        name, given = ("measurement noise factor", self.measurement_noise[1]) if factor else (
            "measurement noise", self.measurement_noise[0]
        )  # fmt: skip
        single = [
            [
                0.0 if given[i][j] == 0.0 else self.parameters.leaf(tracer, f"{name} {max(i, j)} {min(i, j)}", given[i][j])
                for j in range(m)
            ]
            for i in range(m)
        ]
        whole: Matrix = []
        for _ in range(count):
            whole = block_diagonal(whole, single) if whole else single
        return whole

    def given(self, piece: Piece) -> tuple[Row, Any]:
        """Command and length of a prediction."""
        return piece.tracer.leaves("control", self.motion.controls), piece.tracer.leaf("lapse", 0, settled=True)

    def predict(self, paused: bool = False) -> Piece:
        """A prediction; paused, of those runs alone that have the next reading."""
        from estlab.compiled.roots import predicted_root

        piece = Piece(self.n)
        mean, matrix = piece.belief()
        control, dt = self.given(piece)
        predicted = predicted_root if self.method.transform == "factors" else predicted_state
        after = predicted(self, piece, mean, matrix, control, dt, 0)
        new, cov = wrapped(self.motion.space, after.mean), after.cov
        if paused:
            has = self.has(piece, piece.tracer.leaves("value", self.sensor.space.size))
            new = [piece.choose(has, new[i], mean[i]) for i in range(self.n)]
            cov = symmetric(self.n, lambda i, j: piece.choose(has, cov_of(after, i, j), matrix[i][j]))
        piece.keep(new, cov)
        return piece

    def has(self, piece: Piece, values: Row) -> Symbol:
        """Whether a run has any of a reading."""
        present = [value == value for value in values]  # noqa: PLR0124 - NaN is not
        found = present[0]
        for other in present[1:]:
            found = found | other
        return found

    def update(self) -> Piece:
        """An update with a reading, of the runs that have it."""
        from estlab.compiled.roots import updated_root
        from estlab.compiled.updates import updated

        piece = Piece(self.n)
        if self.method.updating and self.sensor.space.size:
            (updated_root if self.method.transform == "factors" else updated)(self, piece)
        return piece

    def record(self, gated: bool = True) -> Piece:
        """What is kept of a step: mean and covariance, how many readings were refused; and whether all is finite."""
        piece = Piece(self.n)
        mean, matrix = piece.belief()
        every = total([*mean, *(matrix[i][j] for i in range(self.n) for j in range(i + 1))])
        piece.failed.append(~(abs(every) < float("inf")))
        if self.method.transform == "factors":
            lower = [[matrix[i][j] if j <= i else 0.0 for j in range(self.n)] for i in range(self.n)]
            matrix = symmetric(
                self.n, lambda i, j: total(times(lower[i][k], lower[j][k]) for k in range(min(i, j) + 1))
            )
        if self.method.gated and gated:
            piece.outputs.append(("gated", 0, piece.tracer.leaf("belief", slots(self.n) - 1)))
            piece.outputs.append(("belief", slots(self.n) - 1, 0.0))
        piece.outputs += [("mean", i, mean[i]) for i in range(self.n)]
        piece.outputs += [("cov", i * self.n + j, matrix[i][j]) for i in range(self.n) for j in range(self.n)]
        return piece

    def smooth(self) -> Piece:
        """A step back of the Rauch-Tung-Striebel smoother: see estlab.filters.smoother."""
        piece = Piece(self.n)
        n = self.n
        later_mean, later_cov = piece.belief()
        mean = piece.tracer.leaves("before_mean", n)
        cov = symmetric(n, lambda i, j: piece.tracer.leaf("before_cov", i * n + j))
        control, dt = self.given(piece)
        after = predicted_state(self, piece, mean, cov, control, dt, n)
        factor = factored(after.cov, piece.failed)
        half = solve_lower(factor, transpose(after.cross, n))
        gain = transpose(solve_lower_transposed(factor, half), n)
        unrolled = wrapped(self.motion.space, after.mean)
        step = wrapped(self.motion.space, [minus(later_mean[i], unrolled[i]) for i in range(n)])
        moved = [plus(mean[i], total(times(gain[i][k], step[k]) for k in range(n))) for i in range(n)]
        change = symmetric(n, lambda i, j: minus(later_cov[i][j], after.cov[i][j]))
        piece.keep(wrapped(self.motion.space, moved), added(cov, sandwich(gain, change)[1]))
        return piece


def cov_of(moments: Moments, i: int, j: int) -> Any:
    """An entry of the covariance."""
    return moments.cov[i][j]


def predicted_state(
    steps: Steps, piece: Piece, mean: Row, cov: Matrix, control: Row, dt: Any, crossed: int
) -> Moments:
    """The motion's moments, noise included, with the cross-covariance of this many components before."""
    motion, method, tracer = steps.motion, steps.method, piece.tracer
    n, noise = steps.n, steps.process_noise(tracer)
    if method.transform == "points":
        points = steps.points(tracer, "motion", method.motion)
        factor = factored(cov, piece.failed)
        if method.augmented:
            joint = block_diagonal(factor, noise)

            def move(at: Row) -> Row:
                return motion.value(tracer, at[:n], control, at[n:], dt)

            return by_points(points, move, list, [*mean, *[0.0] * motion.noises], joint, crossed)
        moments = by_points(
            points, lambda at: motion.value(tracer, at, control, None, dt), list, mean, factor, crossed
        )
    else:
        value = motion.value(tracer, mean, control, None, dt)
        in_state, in_noise = motion.slopes(tracer, mean, control, dt)
        moments = along_tangent(value, in_state, cov)
        if method.transform != "tangent":
            if method.augmented:
                curvatures, joint = motion.joint_curvatures(tracer, mean, control, dt), block_diagonal(cov, noise)
            else:
                curvatures, joint = motion.curvatures(tracer, mean, control, dt), cov
            moments = bent(moments, curvatures, joint, method.transform == "gaussian")
        if motion.noises:
            moments = moments._replace(cov=added(moments.cov, sandwich(in_noise, noise)[1]))
        return moments
    if motion.noises:
        _, in_noise = motion.slopes(tracer, mean, control, dt)
        moments = moments._replace(cov=added(moments.cov, sandwich(in_noise, noise)[1]))
    return moments


def predicted_reading(steps: Steps, piece: Piece, mean: Row, cov: Matrix, places: Sequence[Row]) -> Moments:
    """The reading's moments, noise included, and its cross-covariance with the state."""
    sensor, method, tracer = steps.sensor, steps.method, piece.tracer
    n, m = steps.n, sensor.space.size

    def back(values: Row) -> Row:
        return [wrap(value) if i in sensor.space.angles else value for i, value in enumerate(values)]

    if method.transform == "points":
        points = steps.points(tracer, "sensor", method.sensor)
        factor = factored(cov, piece.failed)
        if method.augmented:

            def noisy(at: Row) -> Row:
                return [plus(value, at[n + i]) for i, value in enumerate(sensor.value(tracer, at[:n], places))]

            joint = block_diagonal(factor, steps.reading_noise(tracer, factor=True))
            return by_points(points, noisy, back, [*mean, *[0.0] * m], joint, n)
        moments = by_points(points, lambda at: sensor.value(tracer, at, places), back, mean, factor, n)
    else:
        value = sensor.value(tracer, mean, places)
        moments = along_tangent(value, sensor.slopes(tracer, mean, places), cov)
        if method.transform in ("gaussian", "modified"):
            curvatures = sensor.curvatures(tracer, mean, places)
            moments = bent(moments, curvatures, cov, method.transform == "gaussian")
    return moments._replace(cov=added(moments.cov, steps.reading_noise(tracer, factor=False)))


def unless(condition: Symbol, piece: Piece, entry: Any, otherwise: float) -> Any:
    """An entry, or a number where the condition is true."""
    if is_zero(entry) and otherwise == 0.0:
        return 0.0
    return piece.choose(condition, otherwise, entry)
