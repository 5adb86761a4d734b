"""Calls a model once with components that have no numbers yet; the result is a graph."""

import os
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from estlab.compiled.symbols import Expressions, Symbol, Symbols, UntraceableError, node, symbols
from estlab.compiled.ufuncs import number

__all__ = ["Symbol", "Tracer", "UntraceableError"]

_HERE = str(Path(__file__).parent)
_NUMPY = str(Path(np.__file__).parent)


class Tracer:
    """A graph that models are traced into."""

    def __init__(self) -> None:
        self.graph = Expressions()

    def leaf(self, name: str, index: int = 0, settled: bool = False) -> Symbol:
        """An input component. settled: the same in all runs, and finite."""
        return Symbol(self.graph, self.graph.leaf(name, index, settled))

    def leaves(self, name: str, size: int, settled: bool = False) -> list[Symbol]:
        """Components that are given."""
        return [self.leaf(name, i, settled) for i in range(size)]

    def constant(self, value: float) -> Symbol:
        """A number as a component."""
        return Symbol(self.graph, self.graph.constant(float(value)))

    def call(self, function: Callable[..., Any], *given: Any, shape: tuple[int, ...]) -> Any:
        """A model's result, as nested lists of components of this shape; None in a shape is any length.

        given: numbers, components, or sequences of them, which the model receives as arrays. Constants that are zero
        come back as Python's 0.0. Raises UntraceableError that names function, file and line, if the model cannot be
        traced.
        """
        answers = []
        # Twice, because a model that draws or counts returns another constant the next time.
        for _ in range(2):
            arguments = [self._fresh(part) for part in given]
            try:
                with np.errstate(all="ignore"):
                    answer = self._answer(function(*arguments), shape)
            except RecursionError as error:
                raise UntraceableError(f"{_named(function)}: it never ends") from error
            except Exception as error:
                raise UntraceableError(_line(function, error, self._taken())) from error
            if (refusal := self._taken()) is not None:
                raise UntraceableError(f"{_named(function)}: {refusal}")
            answers.append(answer)
        if _numbers(answers[0]) != _numbers(answers[1]):
            raise UntraceableError(f"{_named(function)}: it answers otherwise when it is asked again")
        return answers[0]

    def _taken(self) -> str | None:
        refusal, self.graph.refusal = self.graph.refusal, None
        return refusal

    def _fresh(self, part: Any) -> Any:
        """Copies, so that a model that works in place changes only its own arrays."""
        if isinstance(part, Symbol):
            return part.copy()
        if isinstance(part, list):
            if not part:
                return np.zeros(0)
            if isinstance(part[0], list):
                return symbols([self._component(e) for row in part for e in row], (len(part), len(part[0])))
            return symbols([self._component(entry) for entry in part])
        return part

    def _component(self, entry: Any) -> Any:
        return entry.copy() if isinstance(entry, Symbol) else self.constant(entry)

    def _answer(self, answer: Any, shape: tuple[int, ...]) -> Any:
        if shape:
            try:
                parts = list(answer)
            except TypeError:
                raise self.graph.refuse("it answers with one component where several belong") from None
            if len(parts) != shape[0]:
                raise self.graph.refuse(f"it answers with {len(parts)} components where {shape[0]} belong")
            return [self._answer(part, shape[1:]) for part in parts]
        found = number(self.graph, node(self.graph, answer))
        value = self.graph.values.get(found)
        return value if value == 0.0 else Symbol(self.graph, found)


def _numbers(answer: Any) -> Any:
    if isinstance(answer, list):
        return [_numbers(part) for part in answer]
    return answer.number if isinstance(answer, Symbol) else answer


def _named(function: Callable[..., Any]) -> str:
    inner = getattr(function, "func", function)  # of a functools.partial
    code = getattr(inner, "__code__", None)
    name = f"{getattr(inner, '__module__', '?')}.{getattr(inner, '__qualname__', repr(inner))}"
    return f"{name} ({_short(code.co_filename)}:{code.co_firstlineno})" if code else name


def _line(function: Callable[..., Any], error: Exception, refusal: str | None) -> str:
    """Function, file and line where a model was refused, and why."""
    why = refusal or f"{type(error).__name__}: {' '.join(str(error).split())}"
    place = _innermost(error.__traceback__)
    if place is None:
        return f"{_named(function)}: {why}"
    return f"{place.name} ({_short(place.filename)}:{place.lineno}): {why}"


def _innermost(trace: TracebackType | None) -> traceback.FrameSummary | None:
    """The last line that belongs neither to us nor to NumPy."""
    frames = [
        frame
        for frame in traceback.extract_tb(trace)
        if not frame.filename.startswith((_HERE, _NUMPY)) and not frame.filename.startswith("<__array_function__")
    ]
    return frames[-1] if frames else None


def _short(path: str) -> str:
    """A path relative to the current folder, if it is below it."""
    relative = os.path.relpath(path)
    return path if relative.startswith("..") else relative


Components = Sequence[Any]
__all__ += ["Components", "Symbols"]
