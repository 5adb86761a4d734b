"""An expression graph. The same operation on the same arguments is one node, so it is computed only once."""

import struct
from collections.abc import Iterable

Node = tuple[object, ...]

BOOLEAN = frozenset(
    {"lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not", "true", "false", "negative_bits", "ine", "bxor"}
)
INTEGER = frozenset({"bits", "iconst", "iadd", "isub", "iand", "ixor", "ishl", "iashr"})
LEAVES = frozenset({"const", "iconst", "leaf", "true", "false"})


class Graph:
    """Nodes in the order of creation, so arguments come before the nodes that use them.

    A node is (operation, *arguments), where arguments are node numbers. A constant is ("const", its bits), and an
    input is ("leaf", name, index).
    """

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.values: dict[int, float] = {}  # of constants
        self.settled: set[int] = set()  # nodes made of constants and of finite inputs that are the same in all runs
        self._numbers: dict[Node, int] = {}

    def node(self, operation: str, *arguments: object) -> int:
        """The number of this node."""
        key = (operation, *arguments)
        number = self._numbers.get(key)
        if number is None:
            number = self._numbers[key] = len(self.nodes)
            self.nodes.append(key)
        return number

    def constant(self, value: float) -> int:
        """A number; the zeros of both signs differ."""
        number = self.node("const", struct.unpack("<q", struct.pack("<d", value))[0])
        self.values[number] = value
        self.settled.add(number)
        return number

    def truth(self, value: bool) -> int:
        """True or false."""
        return self.node("true" if value else "false")

    def leaf(self, name: str, index: int, settled: bool = False) -> int:
        """An input. settled: the same in all runs, and finite."""
        number = self.node("leaf", name, index)
        if settled:
            self.settled.add(number)
        return number

    def arguments(self, number: int) -> tuple[int, ...]:
        """The nodes that this one uses."""
        node = self.nodes[number]
        return () if node[0] in LEAVES else node[1:]  # type: ignore[return-value]

    def is_boolean(self, number: int) -> bool:
        """Whether a node is a truth value, not a number."""
        return self.nodes[number][0] in BOOLEAN

    def needed(self, outputs: Iterable[int]) -> list[int]:
        """The nodes that these need, in order."""
        found: set[int] = set()
        waiting = list(outputs)
        while waiting:
            number = waiting.pop()
            if number not in found:
                found.add(number)
                waiting += self.arguments(number)
        return sorted(found)
