"""What is known of an operation without computing it.

Every rule holds for all numbers of IEEE 754, infinities, NaN and zeros of both signs. x + (-0) is x, but x + 0 is not
(it turns -0 into +0). 0 x is 0 only if x is known to be finite and the same in all runs, as a duration is.
"""

import math
from collections.abc import Callable

import numpy as np

from estlab.compiled.graph import Graph

COMMUTATIVE = frozenset({"add", "mul", "eq", "ne", "and", "or"})


def _numpy(function: Callable[..., object]) -> Callable[..., float]:
    def evaluated(*values: float) -> float:
        with np.errstate(all="ignore"):
            return float(function(*map(np.float64, values)))  # type: ignore[arg-type]

    return evaluated


NUMERIC: dict[str, Callable[..., float]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "neg": lambda a: -a,
    "abs": abs,
    "div": _numpy(np.divide),
    "sqrt": _numpy(np.sqrt),
    "floor": _numpy(np.floor),
    "rint": _numpy(np.rint),
    "min": _numpy(np.minimum),
    "max": _numpy(np.maximum),
    "copysign": math.copysign,
    "sin": _numpy(np.sin),
    "cos": _numpy(np.cos),
    "tan": _numpy(np.tan),
    "arctan2": _numpy(np.arctan2),
    "exp": _numpy(np.exp),
    "log": _numpy(np.log),
}
LOGIC: dict[str, Callable[[float, float], bool]] = {
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "gt": lambda a, b: a > b,
    "ge": lambda a, b: a >= b,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a != b,
}


def operation(graph: Graph, name: str, *arguments: int) -> int:
    """The node of this operation, or an equal but simpler one."""
    values = [graph.values.get(a) for a in arguments]
    if None not in values:
        if name in NUMERIC:
            return graph.constant(NUMERIC[name](*values))
        if name in LOGIC:
            return graph.truth(LOGIC[name](*values))  # type: ignore[arg-type]
    simpler = SIMPLER.get(name)
    found = simpler(graph, arguments, values) if simpler else None
    if found is not None:
        return found
    if name in COMMUTATIVE and arguments[0] > arguments[1]:
        arguments = arguments[::-1]
    number = graph.node(name, *arguments)
    if name in NUMERIC and all(a in graph.settled for a in arguments):
        graph.settled.add(number)
    return number


Values = list[float | None]
Rule = Callable[[Graph, tuple[int, ...], Values], int | None]


def _is(value: float | None, wanted: float) -> bool:
    return value == wanted and math.copysign(1.0, value) == math.copysign(1.0, wanted)


def _add(graph: Graph, given: tuple[int, ...], values: Values) -> int | None:
    a, b = given
    if _is(values[0], -0.0):
        return b
    return a if _is(values[1], -0.0) else None


def _subtract(graph: Graph, given: tuple[int, ...], values: Values) -> int | None:
    a, b = given
    if _is(values[1], 0.0):
        return a
    return operation(graph, "neg", b) if _is(values[0], -0.0) else None


def _multiply(graph: Graph, given: tuple[int, ...], values: Values) -> int | None:
    for one, other in ((0, 1), (1, 0)):
        value, rest = values[one], given[other]
        if value == 1.0:
            return rest
        if value == -1.0:
            return operation(graph, "neg", rest)
        if value == 0.0 and rest in graph.settled:
            return given[one]
    return None


def _divide(graph: Graph, given: tuple[int, ...], values: Values) -> int | None:
    a, _ = given
    if values[1] == 1.0:
        return a
    if values[1] is not None and math.frexp(values[1])[0] in (0.5, -0.5) and 1e-300 < abs(values[1]) < 1e300:
        return operation(graph, "mul", a, graph.constant(1.0 / values[1]))  # a power of two: exact either way
    return None


def _negate(graph: Graph, given: tuple[int, ...], values: Values) -> int | None:
    node = graph.nodes[given[0]]
    return node[1] if node[0] == "neg" else None  # type: ignore[return-value]


def _absolute(graph: Graph, given: tuple[int, ...], values: Values) -> int | None:
    node = graph.nodes[given[0]]
    if node[0] == "neg":
        return operation(graph, "abs", node[1])  # type: ignore[arg-type]
    return given[0] if node[0] == "abs" else None


def _select(graph: Graph, given: tuple[int, ...], values: Values) -> int | None:
    condition, yes, no = given
    name = graph.nodes[condition][0]
    if name in ("true", "false"):
        return yes if name == "true" else no
    return yes if yes == no else None


def _both(graph: Graph, given: tuple[int, ...], values: Values) -> int | None:
    for one, other in ((0, 1), (1, 0)):
        name = graph.nodes[given[one]][0]
        if name in ("true", "false"):
            return given[other] if name == "true" else given[one]
    return given[0] if given[0] == given[1] else None


def _either(graph: Graph, given: tuple[int, ...], values: Values) -> int | None:
    for one, other in ((0, 1), (1, 0)):
        name = graph.nodes[given[one]][0]
        if name in ("true", "false"):
            return given[one] if name == "true" else given[other]
    return given[0] if given[0] == given[1] else None


def _opposite(graph: Graph, given: tuple[int, ...], values: Values) -> int | None:
    node = graph.nodes[given[0]]
    if node[0] in ("true", "false"):
        return graph.truth(node[0] == "false")
    return node[1] if node[0] == "not" else None  # type: ignore[return-value]


SIMPLER: dict[str, Rule] = {
    "add": _add,
    "sub": _subtract,
    "mul": _multiply,
    "div": _divide,
    "neg": _negate,
    "abs": _absolute,
    "select": _select,
    "and": _both,
    "or": _either,
    "not": _opposite,
}
