"""Blocks added two by two, in an order that depends only on their numbers."""

from typing import Generic, Protocol, Self, TypeVar


class Addable(Protocol):
    """A sum that can be extended by what comes after it."""

    def plus(self, other: Self) -> Self:
        """The sum of both; this one's runs come first."""


T = TypeVar("T", bound=Addable)


class Pairwise(Generic[T]):
    """Sums over blocks 0, 1, 2, ... as a binary tree; it keeps as many sums as the number of blocks has binary
    digits.

    nodes: by (level, number), a sum of blocks number * 2^level up to the next. Floating-point sums depend on their
    order. Parts of an ensemble, each summed elsewhere, give the same to the last bit only if the order is the same.
    Here it is the same, whoever adds which blocks, and when.
    """

    def __init__(self) -> None:
        self.nodes: dict[tuple[int, int], T] = {}

    def add(self, level: int, number: int, value: T) -> None:
        """Add a node; a single block has level 0."""
        beside = self.nodes.pop((level, number ^ 1), None)
        if beside is None:
            self.nodes[level, number] = value
        else:
            first, second = (beside, value) if number % 2 else (value, beside)
            self.add(level + 1, number // 2, first.plus(second))

    def total(self) -> T:
        """The sum of all blocks, in their order. Raises ValueError if a block is missing or there is none."""
        ordered = sorted(self.nodes, key=lambda node: node[1] << node[0])
        begin = 0
        for level, number in ordered:
            if number << level != begin:
                raise ValueError(f"block {begin} is missing")
            begin += 1 << level
        if not ordered:
            raise ValueError("there is no block")
        total = self.nodes[ordered[0]]
        for node in ordered[1:]:
            total = total.plus(self.nodes[node])
        return total
