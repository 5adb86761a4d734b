"""Evaluates a graph with NumPy, node by node."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from estlab.compiled.graph import Graph

Leaf = tuple[str, int]

OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "abs": np.absolute,
    "sqrt": np.sqrt,
    "floor": np.floor,
    "rint": np.rint,
    "min": np.minimum,
    "max": np.maximum,
    "copysign": np.copysign,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "arctan2": np.arctan2,
    "hypot": np.hypot,
    "remainder": np.remainder,
    "exp": np.exp,
    "log": np.log,
    "select": np.where,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "and": np.logical_and,
    "or": np.logical_or,
    "not": np.logical_not,
    # The operations that elementary functions consist of.
    "bits": lambda a: np.asarray(a, dtype=float).view(np.int64),
    "from_bits": lambda a: np.asarray(a).view(float),
    "negative_bits": lambda a: np.less(a, 0),
    "iadd": np.add,
    "isub": np.subtract,
    "iand": np.bitwise_and,
    "ixor": np.bitwise_xor,
    "ishl": np.left_shift,
    "iashr": np.right_shift,
    "ine": np.not_equal,
    "bxor": np.logical_xor,
}


class Interpreted:
    """Some nodes of a graph as a function of its leaves."""

    def __init__(self, graph: Graph, outputs: Sequence[int]) -> None:
        self._outputs, self._leaves = list(outputs), list[tuple[int, Leaf]]()
        self._constants: dict[int, Any] = {}
        self._steps: list[tuple[int, Callable[..., Any], tuple[int, ...]]] = []
        for number in graph.needed(outputs):
            name, *rest = graph.nodes[number]
            if name == "leaf":
                self._leaves.append((number, (str(rest[0]), int(rest[1]))))  # type: ignore[call-overload]
            elif name in ("true", "false"):
                self._constants[number] = name == "true"
            elif name == "iconst":
                self._constants[number] = np.int64(str(rest[0]))
            elif name == "const":
                self._constants[number] = graph.values[number]
            else:
                self._steps.append((number, OPERATIONS[str(name)], graph.arguments(number)))

    def __call__(self, leaves: Mapping[Leaf, Any]) -> list[Any]:
        """The values of the nodes; constants are Python's own numbers."""
        values = dict(self._constants)
        for number, leaf in self._leaves:
            values[number] = leaves[leaf]
        for number, function, given in self._steps:
            values[number] = function(*[values[a] for a in given])
        return [values[number] for number in self._outputs]
