"""Exact derivatives of a traced model, by differentiating its graph node by node."""

from collections.abc import Callable, Sequence
from typing import Any

from estlab.compiled.algebra import Matrix, is_zero, minus, plus, times
from estlab.compiled.graph import Graph
from estlab.compiled.rules import operation
from estlab.compiled.symbols import Expressions, Symbol
from estlab.compiled.trace import Tracer, UntraceableError

Gradient = dict[int, Any]  # by the number of the variable; missing entries are zero


class Traced:
    """A model of several vectors, traced separately, whose derivatives are then evaluated at other components.

    sizes: of its arguments; None for a single number. size: of its result.
    """

    def __init__(self, function: Callable[..., Any], sizes: Sequence[int | None], size: int) -> None:
        self._tracer = Tracer()
        self._given: list[Any] = [
            self._tracer.leaf(f"{k}", 0) if count is None else self._tracer.leaves(f"{k}", count)
            for k, count in enumerate(sizes)
        ]
        self.values = self._tracer.call(function, *self._given, shape=(size,))
        self._jacobians: dict[tuple[int, ...], Any] = {}

    @property
    def graph(self) -> Expressions:
        """Its graph, whose leaves are (index of the argument, component)."""
        return self._tracer.graph

    def jacobian(self, vectors: tuple[int, ...]) -> Matrix:
        """Rows of the derivatives of each value in the components of these vectors."""
        if vectors not in self._jacobians:
            variables = [symbol.number for k in vectors for symbol in self._given[k]]
            self._jacobians[vectors] = derived(self._tracer.graph, self.values, variables)
        return self._jacobians[vectors]

    def hessians(self, vectors: tuple[int, ...]) -> list[Matrix]:
        """For each value, rows of its second derivatives in the components of these vectors."""
        variables = [symbol.number for k in vectors for symbol in self._given[k]]
        return [derived(self._tracer.graph, list(map(_known, row)), variables) for row in self.jacobian(vectors)]

    def at(self, tracer: Tracer, answer: Any, *given: Any) -> Any:
        """A result of this trace, as nested lists, in another graph, with these components as the arguments."""
        replaced: dict[int, int] = {}
        for own, others in zip(self._given, given, strict=True):
            pairs = [(own, others)] if isinstance(own, Symbol) else zip(own, others, strict=True)
            for leaf, other in pairs:
                component = other if isinstance(other, Symbol) else tracer.constant(other)
                replaced[leaf.number] = component.number
        flat: list[Any] = []
        _flatten(answer, flat)
        wanted = [symbol.number for symbol in flat if isinstance(symbol, Symbol)]
        places = transplanted(self._tracer.graph, wanted, tracer.graph, replaced)
        return _replaced(answer, lambda symbol: Symbol(tracer.graph, places[symbol.number]))


def transplanted(source: Graph, outputs: Sequence[int], target: Graph, replaced: dict[int, int]) -> dict[int, int]:
    """Copies the nodes that the outputs need from one graph into another, with some of them replaced."""
    places = dict(replaced)
    for number in source.needed(outputs):
        if number in places:
            continue
        name = str(source.nodes[number][0])
        if name == "const":
            places[number] = target.constant(source.values[number])
        elif name in ("true", "false"):
            places[number] = target.truth(name == "true")
        else:
            places[number] = operation(target, name, *[places[a] for a in source.arguments(number)])
    return places


def _flatten(answer: Any, found: list[Any]) -> None:
    for part in answer:
        if isinstance(part, list):
            _flatten(part, found)
        else:
            found.append(part)


def _replaced(answer: Any, function: Callable[[Symbol], Symbol]) -> Any:
    if isinstance(answer, list):
        return [_replaced(part, function) for part in answer]
    if isinstance(answer, Symbol):
        symbol = function(answer)
        value = symbol.graph.values.get(symbol.number)
        return value if value == 0.0 else symbol
    return answer


def _known(entry: Any) -> Any:
    """A constant entry as a number."""
    return 0.0 if isinstance(entry, Symbol) and entry.number in entry.graph.values else entry


def derived(graph: Expressions, values: Sequence[Any], variables: Sequence[int]) -> Matrix:
    """Rows of the derivatives of the values in the variables; 0.0 where there is none."""
    outputs = [value.number for value in values if isinstance(value, Symbol)]
    gradients: dict[int, Gradient] = {
        number: {j: Symbol(graph, graph.constant(1.0))} for j, number in enumerate(variables)
    }
    for number in graph.needed(outputs):
        if number in gradients:
            continue
        given = graph.arguments(number)
        if any(gradients.get(a) for a in given) and not graph.is_boolean(number):
            gradients[number] = _chain(graph, number, given, gradients)
    return [
        [
            gradients.get(value.number, {}).get(j, 0.0) if isinstance(value, Symbol) else 0.0
            for j in range(len(variables))
        ]
        for value in values
    ]


def _chain(graph: Expressions, number: int, given: tuple[int, ...], gradients: dict[int, Gradient]) -> Gradient:
    """The gradient of a node from the gradients of its arguments."""
    name = str(graph.nodes[number][0])
    parts = [Symbol(graph, a) for a in given]
    if name in ("select", "min", "max"):
        # The gradient of the selected argument; if both are equal, either choice is correct.
        condition = parts[0] if name == "select" else parts[0] < parts[1] if name == "min" else parts[0] > parts[1]
        yes, no = (gradients.get(a, {}) for a in given[-2:])
        return {j: _either(graph, condition, yes.get(j, 0.0), no.get(j, 0.0)) for j in {*yes, *no}}
    rule = RULES.get(name)
    if rule is None:
        raise UntraceableError(f"there is no derivative of {name}")
    factors = rule(Symbol(graph, number), *parts)
    found: Gradient = {}
    for a, factor in zip(given, factors, strict=True):
        for j, derivative in gradients.get(a, {}).items():
            found[j] = plus(found.get(j, 0.0), times(_entry(factor), derivative))
    return {j: derivative for j, derivative in found.items() if not is_zero(derivative)}


def _entry(factor: Any) -> Any:
    """A factor; zero counts as none."""
    return 0.0 if isinstance(factor, Symbol) and factor.graph.values.get(factor.number) == 0.0 else factor


def _either(graph: Expressions, condition: Symbol, yes: Any, no: Any) -> Symbol:
    parts = [part.number if isinstance(part, Symbol) else graph.constant(part) for part in (yes, no)]
    return Symbol(graph, operation(graph, "select", condition.number, *parts))


def _of(symbol: Symbol, name: str) -> Symbol:
    return Symbol(symbol.graph, operation(symbol.graph, name, symbol.number))


def _off_zero(length: Symbol, derivative: Symbol) -> Symbol:
    """A derivative; 0 where a root is 0, such as a minimal distance: no value is correct, and 0 lies between all."""
    return _either(length.graph, length == 0.0, 0.0, derivative)


def _angle(value: Symbol, y: Symbol, x: Symbol) -> tuple[Any, Any]:
    square = x * x + y * y
    return x / square, -y / square


def _signed(value: Symbol, a: Symbol) -> tuple[Any]:
    """Of |a|: the sign, 0 at 0."""
    graph = a.graph
    sign = operation(graph, "copysign", graph.constant(1.0), a.number)
    return (_either(graph, a == 0.0, 0.0, Symbol(graph, sign)),)


def _copied(value: Symbol, a: Symbol, b: Symbol) -> tuple[Any, Any]:
    graph = a.graph
    same = operation(graph, "copysign", graph.constant(1.0), a.number)
    other = operation(graph, "copysign", graph.constant(1.0), b.number)
    return Symbol(graph, same) * Symbol(graph, other), 0.0


def _remaining(value: Symbol, a: Symbol, b: Symbol) -> tuple[Any, Any]:
    return 1.0, -_of(a / b, "floor")


# The factor for each argument's derivative.
RULES: dict[str, Callable[..., tuple[Any, ...]]] = {
    "add": lambda f, a, b: (1.0, 1.0),
    "sub": lambda f, a, b: (1.0, -1.0),
    "mul": lambda f, a, b: (b, a),
    "div": lambda f, a, b: (1.0 / b, -f / b),
    "neg": lambda f, a: (-1.0,),
    "abs": _signed,
    "copysign": _copied,
    "sqrt": lambda f, a: (_off_zero(f, 0.5 / f),),
    "floor": lambda f, a: (0.0,),
    "rint": lambda f, a: (0.0,),
    "sin": lambda f, a: (_of(a, "cos"),),
    "cos": lambda f, a: (-_of(a, "sin"),),
    "tan": lambda f, a: (1.0 + f * f,),
    "arctan2": _angle,
    "hypot": lambda f, a, b: (_off_zero(f, a / f), _off_zero(f, b / f)),
    "remainder": _remaining,
    "exp": lambda f, a: (f,),
    "log": lambda f, a: (1.0 / a,),
}

__all__ = ["Traced", "derived", "minus", "transplanted"]
