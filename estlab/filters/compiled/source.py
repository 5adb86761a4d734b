"""The text of a module that holds the filter loop for one motion, one sensor and one kind of transform.

Numba keeps compiled code between starts only for a function that gets no function as an argument, closes over none and
stands in a file of its own; and it must know how many components a tuple has. So there is a file for each combination:
the kernel's own text, below the models that it is for, found by name, and a few lines that take arrays apart into the
components that they want.
"""

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from estlab.filters.compiled.models import name_of
from estlab.maths.derivatives import RELATIVE_STEP
from estlab.maths.space import Space


@dataclass(frozen=True)
class Plan:
    """All that the compiled code depends on.

    move, jacobians, measure, slope: those of Motion and Sensor; jacobians and slope None for differences.
    state, reading: their spaces. noises, controls, coordinates: how many components process noise, command, place have.
    linearised: whether beliefs go along tangents, else through points; augmented: whether with the noises.
    """

    move: Callable[..., Any]
    jacobians: Callable[..., Any] | None
    measure: Callable[..., Any]
    slope: Callable[..., Any] | None
    state: Space
    reading: Space
    noises: int
    controls: int
    coordinates: int
    linearised: bool
    augmented: bool

    @property
    def functions(self) -> dict[str, Callable[..., Any]]:
        """The model's functions that are needed, by what they are."""
        found = {"move": self.move, "measure": self.measure}
        if self.jacobians is not None and not self.augmented:
            found["jacobians"] = self.jacobians
        if self.slope is not None and self.linearised:
            found["slope"] = self.slope
        return found


def text(plan: Plan) -> str:
    """The module's source."""
    from estlab.filters.compiled.kernel import differences, line, loop, points

    kernel = [differences, line if plan.linearised else points, loop]
    return "\n\n".join([_header(plan), _adapters(plan), *map(inspect.getsource, kernel), _tangents(plan)])


def _header(plan: Plan) -> str:
    functions = {kind: name_of(function) for kind, function in plan.functions.items()}
    named = [f"{module}.{name}" for module, name in functions.values()]
    return "\n".join(
        [
            f'"""A filter loop for {", ".join(named)}; made by estlab. It may be deleted."""',
            "",
            "from estlab.filters.compiled.models import compiled, found",
            "from estlab.filters.compiled.scalars import jit",
            "",
            f"N, M, Q = {plan.state.size}, {plan.reading.size}, {plan.noises}",
            f"AUGMENTED = {plan.augmented}",
            f"AT_REST = {(0.0,) * plan.controls}",
            f"RELATIVE_STEP = {float(RELATIVE_STEP)!r}",
            "",
            'wrap = compiled(found("estlab.maths.space", "wrap"))',
            *(f'{kind} = compiled(found("{module}", "{name}"))' for kind, (module, name) in functions.items()),
        ]
    )


def _adapters(plan: Plan) -> str:
    n, m, q = plan.state.size, plan.reading.size, plan.noises
    state = _row(n, "p[{}]")
    noisy = plan.augmented and not plan.linearised
    added = [f" + p[{n + i}]" if noisy else "" for i in range(m)]
    return "\n\n".join(
        [
            _function("command(control, k, r)", [f"return {_row(plan.controls, 'control[{}, k, r]')}"]),
            _function("about(places, number)", [f"return {_row(plan.coordinates, 'places[{}, number]')}"]),
            _function("wrap_state(x)", [f"x[{i}] = wrap(x[{i}])" for i in plan.state.angles]),
            _function("wrap_reading(z)", [f"z[{i}] = wrap(z[{i}])" for i in plan.reading.angles]),
            _function(
                "motion(p, given, out)",
                [
                    f"value = move({state}, given[0], {_row(q, 'p[{}]', n)}, given[1])",
                    *_values(n),
                ],
            ),
            _function(
                "sensor(p, given, out)",
                [
                    f"value = measure({state}, given[0])",
                    *(f"out[{i}] = value[{i}]{added[i]}" for i in range(m)),
                    *(["wrap_reading(out)"] if noisy else []),
                ],
            ),
        ]
    )


def _tangents(plan: Plan) -> str:
    """The models' values with their slopes, as they state them or by differences.

    Both are taken from one set of numbers, and before any is written, so that the compiler finds what they share. No
    noise is -0.0, which added to a number leaves it as it is, and the compiler knows.
    """
    n, m, q = plan.state.size, plan.reading.size, plan.noises
    state = f"x = {_row(n, 'p[{}]')}"
    motion, sensor = "motion_tangent = motion_by_differences", "sensor_tangent = sensor_by_differences"
    if plan.jacobians is not None and not plan.augmented:
        lines = [
            state,
            f"value = move(x, given[0], {(-0.0,) * q}, given[1])",
            "a, b = jacobians(x, given[0], given[1])",
        ]
        entries = _entries("in_state", "a", n, n) + _entries("in_noise", "b", n, q)
        motion = _function("motion_tangent(p, given, out, in_state, in_noise)", lines + _values(n) + entries)
    if plan.slope is not None:
        lines = [state, "value = measure(x, given[0])", "a = slope(x, given[0])"]
        sensor = _function("sensor_tangent(p, given, out, slopes)", lines + _values(m) + _entries("slopes", "a", m, n))
    return f"{motion}\n\n{sensor}\n" if plan.linearised else f"{motion}\n"


def _values(size: int) -> list[str]:
    return [f"out[{i}] = value[{i}]" for i in range(size)]


def _row(size: int, entry: str, first: int = 0) -> str:
    """A tuple of entries by their numbers."""
    return "(" + "".join(f"{entry.format(first + i)}, " for i in range(size)) + ")"


def _entries(array: str, rows: str, size: int, columns: int) -> list[str]:
    return [f"{array}[{i}, {j}] = {rows}[{i}][{j}]" for i in range(size) for j in range(columns)]


def _function(head: str, lines: Sequence[str]) -> str:
    return "\n    ".join([f"@jit\ndef {head}:", *(lines or ["pass"])])
