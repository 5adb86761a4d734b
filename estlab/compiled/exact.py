"""Exact derivatives of a model that states none, from its trace, evaluated by NumPy."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from estlab.compiled.derivatives import Traced
from estlab.compiled.interpret import Interpreted
from estlab.compiled.symbols import Symbol, UntraceableError


class Exact:
    """The derivatives of a model of several vectors.

    sizes: of the vectors, None for a single number. size: of the model's result. Raises UntraceableError.
    """

    def __init__(self, function: Callable[..., Any], sizes: Sequence[int | None], size: int) -> None:
        self._traced = Traced(function, sizes, size)
        self._made: dict[tuple[str, tuple[int, ...]], tuple[Any, Interpreted]] = {}
        self._beyond: set[tuple[int, ...]] = set()

    def has_jacobian(self, vectors: tuple[int, ...]) -> None:
        """Raise UntraceableError if there is no such derivative."""
        self._traced.jacobian(vectors)

    def has_hessians(self, vectors: tuple[int, ...]) -> bool:
        """Whether there are second derivatives: not for models without, nor for a large state."""
        if (kind := ("hessians", vectors)) not in self._made and vectors not in self._beyond:
            try:
                answer = self._traced.hessians(vectors)
            except UntraceableError:
                self._beyond.add(vectors)
            else:
                self._made[kind] = answer, Interpreted(self._traced.graph, _numbers(answer))
        return kind in self._made

    def jacobian(self, vectors: tuple[int, ...], *given: Any) -> list[list[Any]]:
        """Rows of the derivatives of each value in the components of these vectors; constants are Python's numbers."""
        return self._evaluated("jacobian", vectors, given)

    def hessians(self, vectors: tuple[int, ...], *given: Any) -> list[list[list[Any]]] | None:
        """For each value, rows of its second derivatives in the components of these vectors; None for a large state."""
        return self._evaluated("hessians", vectors, given) if self.has_hessians(vectors) else None

    def _evaluated(self, kind: str, vectors: tuple[int, ...], given: Sequence[Any]) -> Any:
        if (kind, vectors) not in self._made:
            answer = getattr(self._traced, kind)(vectors)
            self._made[kind, vectors] = answer, Interpreted(self._traced.graph, _numbers(answer))
        answer, code = self._made[kind, vectors]
        leaves = {
            (str(k), i): part
            for k, vector in enumerate(given)
            for i, part in enumerate([vector] if np.ndim(vector) == 0 else vector)
        }
        with np.errstate(all="ignore"):  # also from the branch that np.where does not select
            values = iter(code(leaves))
        return _filled(answer, values)


def exact(function: Callable[..., Any], sizes: Sequence[int | None], size: int, *vectors: int) -> Exact | None:
    """The derivatives of a model in these of its vectors; None if it cannot be traced, or has none."""
    try:
        found = Exact(function, sizes, size)
        for vector in vectors:
            found.has_jacobian((vector,))
    except UntraceableError:
        return None
    return found


def _numbers(answer: Any) -> list[int]:
    if isinstance(answer, list):
        return [number for part in answer for number in _numbers(part)]
    return [answer.number] if isinstance(answer, Symbol) else []


def _filled(answer: Any, values: Any) -> Any:
    if isinstance(answer, list):
        return [_filled(part, values) for part in answer]
    return next(values) if isinstance(answer, Symbol) else answer
