"""The contract of a motion and of a sensor: what a filter needs to know.

A model itself is a module-level function of components that returns a tuple of components and uses only NumPy's
functions. It never asks how many points or runs there are: every component has shape ``(*batch)``, and the batch is
points, runs, both or nothing.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from estlab.compiled.exact import Exact, exact
from estlab.earlier_names import renamed
from estlab.maths.finite_differences import hessian, jacobian
from estlab.maths.space import Array, Space
from estlab.maths.stacking import Components, Rows, matrix, stacked
from estlab.maths.transforms import Function

Jacobians = Callable[[Array, Array, float], tuple[Rows, Rows]]
Jacobian = Callable[[Array, Array], Rows]
Hessians = Callable[..., Sequence[Rows] | None]


@renamed(line="unrolled")
@dataclass(frozen=True)
class Motion:
    """x[k] = move(x[k-1], u[k], w[k], dt) with w ~ N(0, noise_cov(u, dt)).

    move(state, control, noise, dt): components in, components out. It must not wrap its angles: its results are
    continuous in its arguments, so that sigma points more than half a turn apart stay apart.
    noise_cov(control, dt): (q, q, runs or nothing). noise_size: q.
    jacobians(state, control, dt): rows of dx/dx and of dx/dw at w = 0. None: estlab finds exact ones by tracing
    ``move`` (estlab.compiled), or uses differences if it cannot.
    hessians(state, control, dt): for each component of x, rows of its second derivative in x, or None likewise.
    """

    space: Space
    move: Callable[[Array, Array, Array, float], Components]
    noise_cov: Callable[[Array, float], Array]
    noise_size: int
    jacobians: Callable[[Array, Array, float], tuple[Rows, Rows]] | None = None
    hessians: Callable[[Array, Array, float], tuple[Rows, ...]] | None = None

    @cached_property
    def unrolled(self) -> Space:
        """The state's space with unwrapped angles, for subtracting values of ``move`` from each other."""
        return replace(self.space, angles=())

    def step(self, state: Array, control: Array, noise: Array, dt: float) -> Array:
        """The next state (n, *batch)."""
        batch = state.shape[1:] if noise.ndim == 1 else np.broadcast_shapes(state.shape[1:], noise.shape[1:])
        return stacked(self.move(state, control, noise, dt), batch)

    def function(self, control: Array, dt: float) -> Function:
        """The motion as a function of the state, without noise."""
        return self.over(control, dt)[0]

    def over(self, control: Array, dt: float) -> tuple[Function, Callable[[Array], Rows]]:
        """The motion as a function of the state, without noise; and of the state, rows of dx/dw at w = 0."""
        silent = np.zeros(self.noise_size)

        def evaluate(points: Array) -> Array:
            return self.step(points, control, silent, dt)

        jacobians, rows = self._derivatives(control)
        hessians = None if rows is None else _stacked_hessians(lambda x: rows(x, control, dt), evaluate, self.unrolled)
        if jacobians is None:
            return Function(evaluate, self.unrolled, None, hessians), lambda at: self.noise_jacobian(at, control, dt)
        # Both Jacobians are needed at one state, so they are computed together.
        both = _Latest(lambda state: jacobians(state, control, dt))
        return Function(evaluate, self.unrolled, lambda at: both(at)[0], hessians), lambda at: both(at)[1]

    def _derivatives(self, control: Array) -> tuple[Jacobians | None, Hessians | None]:
        """Jacobians and Hessians as stated, otherwise exact ones; None if the motion cannot be traced."""
        jacobians: Jacobians | None = self.jacobians
        hessians: Hessians | None = self.hessians
        silent = np.zeros(self.noise_size)
        if (jacobians is None or hessians is None) and (traced := self._exact(len(control))) is not None:
            jacobians = jacobians or (lambda x, u, dt: (traced.jacobian((0,), x, u, silent, dt),
                                                        traced.jacobian((2,), x, u, silent, dt)))  # fmt: skip
            hessians = hessians or (lambda x, u, dt: traced.hessians((0,), x, u, silent, dt))
        return jacobians, hessians

    @cached_property
    def _traces(self) -> dict[int, Exact | None]:
        return {}

    def _exact(self, controls: int) -> Exact | None:
        """Derivatives of ``move`` for commands of so many components."""
        if controls not in self._traces:
            n, q = self.space.size, self.noise_size
            self._traces[controls] = exact(self.move, (n, controls, q, None), n, 0, 2)
        return self._traces[controls]

    def joint_function(self, control: Array, dt: float) -> Function:
        """The motion as a function of (state, noise)."""
        n, joint_jacobian, joint_hessians = self.space.size, None, None

        def evaluate(points: Array) -> Array:
            return self.step(points[:n], control, points[n:], dt)

        jacobians, traced = self._derivatives(control)[0], self._exact(len(control))
        if jacobians is not None:

            def joint_jacobian(joint: Array) -> Rows:
                in_state, in_noise = jacobians(joint[:n], control, dt)
                return [(*a, *b) for a, b in zip(in_state, in_noise, strict=True)]

        if traced is not None:
            joint_hessians = _stacked_hessians(
                lambda joint: traced.hessians((0, 2), joint[:n], control, joint[n:], dt), evaluate, self.unrolled
            )
        return Function(evaluate, self.unrolled, joint_jacobian, joint_hessians)

    def noise_jacobian(self, state: Array, control: Array, dt: float) -> Array:
        """dx/dw (n, q, *batch) at w = 0."""
        if (jacobians := self._derivatives(control)[0]) is not None:
            return matrix(jacobians(state, control, dt)[1], state.shape[1:])
        silent = np.zeros((self.noise_size, *state.shape[1:]))
        return jacobian(lambda noise: self.step(state[:, None], control, noise, dt), silent, self.unrolled)


@renamed(places="landmarks", slope="jacobian", place="landmark")
@dataclass(frozen=True)
class Sensor:
    """z = measure(x, landmark) + v with v ~ N(0, noise_cov).

    measure(state, landmark): components in, components out. space: of the readings. state: the space of the state.
    noise_cov: (m, m).
    landmarks: (p, number of landmarks), what a reading may be about; (0, 1) if there are none.
    jacobian(state, landmark): rows of dz/dx, or None as in Motion.
    hessians(state, landmark): for each component of z, rows of its second derivative in x, or None likewise.
    """

    space: Space
    state: Space
    measure: Callable[[Array, Array], Components]
    noise_cov: Array
    landmarks: Array = field(default_factory=lambda: np.empty((0, 1)))
    jacobian: Callable[[Array, Array], Rows] | None = None
    hessians: Callable[[Array, Array], tuple[Rows, ...]] | None = None

    def landmark(self, number: Array) -> Array:
        """The landmarks (p, *number.shape) with these numbers."""
        return self.landmarks.take(number, axis=1)

    def read(self, state: Array, landmark: Array) -> Array:
        """The reading (m, *batch) without noise."""
        return stacked(self.measure(state, landmark), state.shape[1:])

    def function(self, landmark: Array) -> Function:
        """The sensor as a function of the state, without noise."""
        jacobian, rows = self._derivatives
        fixed = None if jacobian is None else lambda state: jacobian(state, landmark)

        def evaluate(points: Array) -> Array:
            return self.read(points, landmark)

        hessians = None if rows is None else _stacked_hessians(lambda x: rows(x, landmark), evaluate, self.space)
        return Function(evaluate, self.space, fixed, hessians)

    @cached_property
    def _derivatives(self) -> tuple[Jacobian | None, Hessians | None]:
        """Jacobian and Hessians as stated, otherwise exact ones; None if the sensor cannot be traced."""
        jacobian: Jacobian | None = self.jacobian
        hessians: Hessians | None = self.hessians
        sizes = self.state.size, len(self.landmarks)
        if (jacobian is None or hessians is None) and (
            traced := exact(self.measure, sizes, self.space.size, 0)
        ) is not None:
            jacobian = jacobian or (lambda state, landmark: traced.jacobian((0,), state, landmark))
            hessians = hessians or (lambda state, landmark: traced.hessians((0,), state, landmark))
        return jacobian, hessians

    def joint_function(self, landmark: Array, n: int) -> Function:
        """The sensor as a function of (state, noise), the noise added."""
        return Function(
            lambda points: self.space.plus(self.read(points[:n], landmark), points[n:]),
            self.space,
            self._joint_jacobian(landmark, n),
        )

    def _joint_jacobian(self, landmark: Array, n: int) -> Callable[[Array], Rows] | None:
        rows = self._derivatives[0]
        if rows is None:
            return None
        identity = np.eye(self.space.size).tolist()
        return lambda joint: [(*a, *b) for a, b in zip(rows(joint[:n], landmark), identity, strict=True)]

    @cached_property
    def _stacks(self) -> dict[int, "Sensor"]:
        return {}

    def times(self, count: int) -> "Sensor":
        """The sensor that gives ``count`` readings at once, about the landmarks (p, count, *batch)."""
        if count not in self._stacks:
            jacobian, hessians = self._derivatives
            self._stacks[count] = replace(
                self,
                space=self.space.repeat(count),
                measure=lambda state, landmark: _in_turn(self.measure, state, landmark),
                noise_cov=np.kron(np.eye(count), self.noise_cov),
                jacobian=None if jacobian is None else lambda state, landmark: _in_turn(jacobian, state, landmark),
                hessians=None if hessians is None else lambda state, landmark: _in_turn(hessians, state, landmark),
            )
        return self._stacks[count]


def _stacked_hessians(
    rows: Callable[[Array], Any], evaluate: Callable[[Array], Array], space: Space
) -> Callable[[Array], Array]:
    """Hessians as one array (m, n, n, *batch), by differences if none are stated."""

    def hessians(state: Array) -> Array:
        if (found := rows(state)) is None:
            return hessian(evaluate, state, space)
        return np.stack([matrix(one, state.shape[1:]) for one in found])

    return hessians


class _Latest:
    """A function of one argument that caches the result for its latest argument."""

    def __init__(self, function: Callable[[Array], Any]) -> None:
        self._function, self._argument, self._answer = function, np.empty(0), None

    def __call__(self, argument: Array) -> Any:
        if argument is not self._argument:
            self._argument, self._answer = argument, self._function(argument)
        return self._answer


def _in_turn(function: Callable[[Array, Array], Any], state: Array, landmark: Array) -> Any:
    results: list[Any] = [function(state, landmark[:, k]) for k in range(landmark.shape[1])]
    if any(result is None for result in results):
        return None
    return tuple(part for result in results for part in result)
