"""A motion and a sensor in the form that a trace needs: values, derivatives, noise."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from estlab.compiled.algebra import Matrix, Row, is_zero
from estlab.compiled.derivatives import Traced
from estlab.compiled.symbols import Symbol
from estlab.compiled.trace import Tracer, UntraceableError
from estlab.maths.space import TURN, Space

Model = Callable[..., Any]


def wrapped(space: Space, values: Row) -> Row:
    """Angles wrapped to half a turn; see estlab.maths.space.wrap."""
    return [wrap(value) if i in space.angles else value for i, value in enumerate(values)]


def wrap(angle: Any) -> Any:
    """The same angle in [-pi, pi]."""
    if not isinstance(angle, Symbol):
        return angle
    return angle - TURN * rounded(angle * (1.0 / TURN))


def rounded(a: Symbol) -> Symbol:
    """The nearest integer."""
    found: Symbol = a.rint()
    return found


def root(a: Any) -> Any:
    """The square root."""
    return a.sqrt()


@dataclass(frozen=True)
class MotionModel:
    """The parts of estlab.models.contract.Motion. controls: the number of components of a command."""

    space: Space
    move: Model
    noises: int
    controls: int
    stated_jacobians: Model | None
    stated_hessians: Model | None

    def value(self, tracer: Tracer, state: Row, control: Row, noise: Row | None, dt: Any) -> Row:
        """The next state. No noise is -0, because adding it leaves a number unchanged."""
        given = [-0.0 if is_zero(entry) else entry for entry in noise or self._silent]
        found: Row = tracer.call(self.move, state, control, given, dt, shape=(self.space.size,))
        return found

    def jacobians(self, tracer: Tracer, state: Row, control: Row, dt: Any) -> tuple[Matrix, Matrix]:
        """Rows of the derivatives in state and noise: stated, or derived if the stated ones cannot be traced."""
        if self.stated_jacobians is not None:
            stated, n, q = self.stated_jacobians, self.space.size, self.noises
            try:
                joined = tracer.call(
                    lambda *given: _side_by_side(stated(*given), n), state, control, dt, shape=(n, n + q)
                )
            except UntraceableError:
                pass
            else:
                return [row[:n] for row in joined], [row[n:] for row in joined]
        given = (state, control, self._silent, dt)
        in_state = self._traced.at(tracer, self._traced.jacobian((0,)), *given)
        return in_state, self._traced.at(tracer, self._traced.jacobian((2,)), *given)

    def hessians(self, tracer: Tracer, state: Row, control: Row, dt: Any) -> list[Matrix]:
        """For each component, rows of its second derivatives in the state."""
        n = self.space.size
        if self.stated_hessians is not None:
            try:
                return list(tracer.call(self.stated_hessians, state, control, dt, shape=(n, n, n)))
            except UntraceableError:
                pass
        return list(self._traced.at(tracer, self._traced.hessians((0,)), state, control, self._silent, dt))

    def joint_hessians(self, tracer: Tracer, state: Row, control: Row, dt: Any) -> list[Matrix]:
        """For each component, rows of its second derivatives in state and noise."""
        return list(self._traced.at(tracer, self._traced.hessians((0, 2)), state, control, self._silent, dt))

    @property
    def _silent(self) -> list[float]:
        return [-0.0] * self.noises

    @cached_property
    def _traced(self) -> Traced:
        return Traced(self.move, (self.space.size, self.controls, self.noises, None), self.space.size)


def _side_by_side(pair: Any, n: int) -> Any:
    in_state, in_noise = pair
    return [[*a, *b] for a, b in zip(in_state, in_noise, strict=True)]


@dataclass(frozen=True)
class SensorModel:
    """The parts of estlab.models.contract.Sensor, for ``count`` readings about as many landmarks at once.

    coordinates: the number of components of a landmark. single: the space of one reading.
    """

    single: Space
    state: Space
    measure: Model
    coordinates: int
    stated_jacobian: Model | None
    stated_hessians: Model | None
    count: int = 1

    @property
    def space(self) -> Space:
        """The space of all readings together."""
        return self.single if self.count == 1 else self.single.repeat(self.count)

    def value(self, tracer: Tracer, state: Row, landmarks: Sequence[Row]) -> Row:
        """The readings without noise."""
        shape = (self.single.size,)
        return [part for landmark in landmarks for part in tracer.call(self.measure, state, landmark, shape=shape)]

    def jacobian(self, tracer: Tracer, state: Row, landmarks: Sequence[Row]) -> Matrix:
        """Rows of the derivatives in the state."""
        return [row for landmark in landmarks for row in self._jacobian(tracer, state, landmark)]

    def _jacobian(self, tracer: Tracer, state: Row, landmark: Row) -> Matrix:
        if self.stated_jacobian is not None:
            try:
                return list(
                    tracer.call(self.stated_jacobian, state, landmark, shape=(self.single.size, self.state.size))
                )
            except UntraceableError:
                pass
        return list(self._traced.at(tracer, self._traced.jacobian((0,)), state, landmark))

    def hessians(self, tracer: Tracer, state: Row, landmarks: Sequence[Row]) -> list[Matrix]:
        """For each number read, rows of its second derivatives in the state."""
        return [matrix for landmark in landmarks for matrix in self._hessians(tracer, state, landmark)]

    def _hessians(self, tracer: Tracer, state: Row, landmark: Row) -> list[Matrix]:
        n = self.state.size
        if self.stated_hessians is not None:
            try:
                return list(tracer.call(self.stated_hessians, state, landmark, shape=(self.single.size, n, n)))
            except UntraceableError:
                pass
        return list(self._traced.at(tracer, self._traced.hessians((0,)), state, landmark))

    @cached_property
    def _traced(self) -> Traced:
        return Traced(self.measure, (self.state.size, self.coordinates), self.single.size)
