"""NumPy's functions of numbers as nodes of a graph, by their NumPy names.

Each takes node numbers and returns one, or a line that says why it cannot.
"""

import math
from collections.abc import Callable

from estlab.compiled.graph import Graph
from estlab.compiled.rules import operation

Known = Callable[..., int | str]


def number(graph: Graph, a: int) -> int:
    """A truth value as 1 or 0; a number unchanged."""
    if graph.is_boolean(a):
        return operation(graph, "select", a, graph.constant(1.0), graph.constant(0.0))
    return a


def truth(graph: Graph, a: int) -> int:
    """Whether a number is not zero; a truth value unchanged."""
    return a if graph.is_boolean(a) else operation(graph, "ne", a, graph.constant(0.0))


def _plain(name: str) -> Known:
    return lambda graph, *given: operation(graph, name, *[number(graph, a) for a in given])


def _logical(name: str) -> Known:
    return lambda graph, *given: operation(graph, name, *[truth(graph, a) for a in given])


def _bitwise(name: str) -> Known:
    def known(graph: Graph, *given: int) -> int | str:
        if not all(graph.is_boolean(a) for a in given):
            return "it takes & | ~ of numbers: take them of comparisons"
        return operation(graph, name, *given)

    return known


def _of_truths(name: str, instead: str) -> Known:
    """The equivalent of an operation between truth values; none if it depends on the context."""

    def known(graph: Graph, a: int, b: int) -> int | str:
        if graph.is_boolean(a) and graph.is_boolean(b):
            return operation(graph, instead, a, b) if instead else "it adds or subtracts truths: take np.where, & or |"
        return operation(graph, name, number(graph, a), number(graph, b))

    return known


def _of_one(name: str) -> Known:
    """An operation that has no meaning for a truth value."""

    def known(graph: Graph, a: int) -> int | str:
        return f"it takes {name} of a truth" if graph.is_boolean(a) else operation(graph, name, a)

    return known


def _xor(graph: Graph, a: int, b: int) -> int:
    a, b = truth(graph, a), truth(graph, b)
    return operation(graph, "or", _and_not(graph, a, b), _and_not(graph, b, a))


def _and_not(graph: Graph, a: int, b: int) -> int:
    return operation(graph, "and", a, operation(graph, "not", b))


def _bitwise_xor(graph: Graph, a: int, b: int) -> int | str:
    both = graph.is_boolean(a) and graph.is_boolean(b)
    return _xor(graph, a, b) if both else "it takes ^ of numbers: take it of comparisons"


def _sign(graph: Graph, a: int) -> int:
    zero, a = graph.constant(0.0), number(graph, a)
    signed = operation(graph, "copysign", graph.constant(1.0), a)
    settled = operation(graph, "select", operation(graph, "eq", a, zero), zero, signed)
    return operation(graph, "select", operation(graph, "eq", a, a), settled, a)


def _square(graph: Graph, a: int) -> int:
    return operation(graph, "mul", number(graph, a), number(graph, a))


def _reciprocal(graph: Graph, a: int) -> int:
    return operation(graph, "div", graph.constant(1.0), number(graph, a))


def _arctan(graph: Graph, a: int) -> int:
    return operation(graph, "arctan2", number(graph, a), graph.constant(1.0))


def _cathetus(graph: Graph, a: int) -> int:
    """sqrt(1 - a^2), without cancellation."""
    one = graph.constant(1.0)
    product = operation(graph, "mul", operation(graph, "sub", one, a), operation(graph, "add", one, a))
    return operation(graph, "sqrt", product)


def _arcsin(graph: Graph, a: int) -> int:
    a = number(graph, a)
    return operation(graph, "arctan2", a, _cathetus(graph, a))


def _arccos(graph: Graph, a: int) -> int:
    a = number(graph, a)
    return operation(graph, "arctan2", _cathetus(graph, a), a)


def _radians(graph: Graph, a: int) -> int:
    return operation(graph, "mul", number(graph, a), graph.constant(math.pi / 180.0))


def _degrees(graph: Graph, a: int) -> int:
    return operation(graph, "mul", number(graph, a), graph.constant(180.0 / math.pi))


def _floor_divide(graph: Graph, a: int, b: int) -> int:
    a, b = number(graph, a), number(graph, b)
    whole = operation(graph, "sub", a, operation(graph, "remainder", a, b))
    return operation(graph, "rint", operation(graph, "div", whole, b))


def _ceil(graph: Graph, a: int) -> int:
    return operation(graph, "neg", operation(graph, "floor", operation(graph, "neg", number(graph, a))))


def _trunc(graph: Graph, a: int) -> int:
    a = number(graph, a)
    return operation(graph, "copysign", operation(graph, "floor", operation(graph, "abs", a)), a)


def _power(graph: Graph, a: int, b: int) -> int | str:
    """By multiplications and roots for halves of small integers, otherwise exp(b log a) for nonnegative a."""
    a, exponent = number(graph, a), graph.values.get(number(graph, b))
    if exponent is None:
        return "it raises to a power that is no constant: take np.exp"
    if exponent < 0.0:
        found = _power(graph, a, graph.constant(-exponent))
        return found if isinstance(found, str) else _reciprocal(graph, found)
    if exponent == 0.0:
        return graph.constant(1.0)
    if not (2.0 * exponent).is_integer() or exponent > 16.0:
        if exponent.is_integer():
            return f"it raises to the power {exponent:g}, which is beyond 16"
        return operation(graph, "exp", operation(graph, "mul", graph.constant(exponent), operation(graph, "log", a)))
    factors = [a]
    while 2.0 ** len(factors) <= exponent:
        factors.append(_square(graph, factors[-1]))
    taken = [factor for i, factor in enumerate(factors) if int(exponent) >> i & 1]
    if exponent % 1.0:
        taken.append(operation(graph, "sqrt", a))
    product = taken[0]
    for factor in taken[1:]:
        product = operation(graph, "mul", product, factor)
    return product


def _hypot(graph: Graph, a: int, b: int) -> int:
    return operation(graph, "hypot", number(graph, a), number(graph, b))


def _where(graph: Graph, condition: int, yes: int, no: int) -> int:
    condition = truth(graph, condition)
    if graph.is_boolean(yes) and graph.is_boolean(no):
        chosen = operation(graph, "and", condition, yes)
        return operation(graph, "or", chosen, _and_not(graph, no, condition))
    return operation(graph, "select", condition, number(graph, yes), number(graph, no))


def _isnan(graph: Graph, a: int) -> int:
    a = number(graph, a)
    return operation(graph, "ne", a, a)


def _isfinite(graph: Graph, a: int) -> int:
    return operation(graph, "lt", operation(graph, "abs", number(graph, a)), graph.constant(math.inf))


def _isinf(graph: Graph, a: int) -> int:
    return operation(graph, "eq", operation(graph, "abs", number(graph, a)), graph.constant(math.inf))


def _same(graph: Graph, a: int) -> int:
    return a


UFUNCS: dict[str, Known] = {
    "add": _of_truths("add", ""),
    "subtract": _of_truths("sub", ""),
    "multiply": _of_truths("mul", "and"),
    "minimum": _of_truths("min", "and"),
    "maximum": _of_truths("max", "or"),
    "divide": _plain("div"),
    "negative": _of_one("neg"),
    "positive": _same,
    "conjugate": _same,
    "absolute": lambda graph, a: a if graph.is_boolean(a) else operation(graph, "abs", a),
    "fabs": _plain("abs"),
    "sign": _sign,
    "square": _square,
    "reciprocal": _reciprocal,
    "sqrt": _plain("sqrt"),
    "power": _power,
    "float_power": _power,
    "hypot": _hypot,
    "floor": _plain("floor"),
    "ceil": _ceil,
    "trunc": _trunc,
    "rint": _plain("rint"),
    "remainder": _plain("remainder"),
    "floor_divide": _floor_divide,
    "copysign": _plain("copysign"),
    "sin": _plain("sin"),
    "cos": _plain("cos"),
    "tan": _plain("tan"),
    "arcsin": _arcsin,
    "arccos": _arccos,
    "arctan": _arctan,
    "arctan2": _plain("arctan2"),
    "exp": _plain("exp"),
    "log": _plain("log"),
    "radians": _radians,
    "deg2rad": _radians,
    "degrees": _degrees,
    "rad2deg": _degrees,
    **{f"{name}": _plain(short) for name, short in (("less", "lt"), ("less_equal", "le"), ("greater", "gt"))},
    **{f"{name}": _plain(short) for name, short in (("greater_equal", "ge"), ("equal", "eq"), ("not_equal", "ne"))},
    "logical_and": _logical("and"),
    "logical_or": _logical("or"),
    "logical_xor": _xor,
    "logical_not": _logical("not"),
    "bitwise_and": _bitwise("and"),
    "bitwise_or": _bitwise("or"),
    "bitwise_xor": _bitwise_xor,
    "invert": _bitwise("not"),
    "isnan": _isnan,
    "isfinite": _isfinite,
    "isinf": _isinf,
    # Not NumPy's names: np.where, and a truth value that is added.
    "where": _where,
    "counted": number,
}

# Methods that NumPy calls on each entry of an array of objects.
METHODS = frozenset(
    [
        "sqrt",
        "square",
        "reciprocal",
        "rint",
        "floor",
        "ceil",
        "trunc",
        "sin",
        "cos",
        "tan",
        "arcsin",
        "arccos",
        "arctan",
        "arctan2",
        "hypot",
        "exp",
        "log",
        "fabs",
        "sign",
        "radians",
        "deg2rad",
        "degrees",
        "rad2deg",
        "conjugate",
        "logical_not",
    ]
)
