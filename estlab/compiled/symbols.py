"""A component whose number is not known yet: NumPy's functions of it become nodes of a graph.

NumPy passes its functions to their arguments (``__array_ufunc__``, ``__array_function__``), so a model is called
unchanged. An operation that needs the number itself is refused.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from estlab.compiled.graph import Graph
from estlab.compiled.ufuncs import METHODS, UFUNCS

_MOST_NODES = 40_000


class UntraceableError(Exception):
    """A model cannot be traced, and why."""


class Expressions(Graph):
    """A graph that remembers refusals, in case the model continues regardless, and that cannot grow forever."""

    refusal: str | None = None

    def node(self, operation: str, *arguments: object) -> int:
        if len(self.nodes) > _MOST_NODES:
            raise self.refuse(f"a step of more than {_MOST_NODES} operations would take long to compile")
        return super().node(operation, *arguments)

    def refuse(self, why: str) -> UntraceableError:
        """The error to raise."""
        self.refusal = self.refusal or why
        return UntraceableError(why)


Operator = Callable[["Symbol", Any], Any]


def _binary(name: str, turned: bool = False) -> Operator:
    """An operator between a component and anything; reversed if turned."""

    def operator(one: "Symbol", other: Any) -> Any:
        if type(other) is Symbols:
            return NotImplemented
        given = (other, one) if turned else (one, other)
        if isinstance(other, np.ndarray):
            return applied(one.graph, getattr(np, name), "__call__", given, {})
        return made(one.graph, name, given)

    return operator


def _in_place(name: str) -> Operator:
    def operator(one: "Symbol", other: Any) -> Any:
        one.number = made(one.graph, name, (one, other)).number
        return one

    return operator


def _unary(name: str) -> Callable[["Symbol"], Any]:
    return lambda one: made(one.graph, name, (one,))


def _three(name: str) -> tuple[Operator, Operator, Operator]:
    return _binary(name), _binary(name, turned=True), _in_place(name)


class Symbol:
    """A number (or truth value) of each run, known only later. In-place operations change it, like an array."""

    __slots__ = ("graph", "number")
    shape: tuple[int, ...] = ()
    ndim, size = 0, 1
    dtype = np.dtype(float)

    def __init__(self, graph: Expressions, number: int) -> None:
        self.graph, self.number = graph, number

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *given: Any, **options: Any) -> Any:
        return applied(self.graph, ufunc, method, given, options)

    def __array_function__(self, function: Callable[..., Any], types: Any, given: Any, options: Any) -> Any:
        from estlab.compiled.arrays import called

        return called(self.graph, function, given, options)

    def __getattr__(self, name: str) -> Any:
        # NumPy calls the method of this name for each entry of an array of objects.
        if name in METHODS:
            return lambda *others: made(self.graph, name, (self, *others))
        raise AttributeError(f"a component has no {name}")

    __add__, __radd__, __iadd__ = _three("add")
    __sub__, __rsub__, __isub__ = _three("subtract")
    __mul__, __rmul__, __imul__ = _three("multiply")
    __truediv__, __rtruediv__, __itruediv__ = _three("divide")
    __floordiv__, __rfloordiv__, __ifloordiv__ = _three("floor_divide")
    __mod__, __rmod__, __imod__ = _three("remainder")
    __pow__, __rpow__, __ipow__ = _three("power")
    __and__, __rand__, __iand__ = _three("bitwise_and")
    __or__, __ror__, __ior__ = _three("bitwise_or")
    __xor__, __rxor__, __ixor__ = _three("bitwise_xor")
    __lt__, __le__, __gt__, __ge__ = map(_binary, ("less", "less_equal", "greater", "greater_equal"))
    __eq__: Operator = _binary("equal")
    __ne__: Operator = _binary("not_equal")
    __neg__, __pos__, __abs__, __invert__ = map(_unary, ("negative", "positive", "absolute", "invert"))

    def _refused(self, *_: Any, **__: Any) -> Any:
        raise self.graph.refuse("it turns a component into a plain number")

    __float__ = __int__ = __index__ = __complex__ = __round__ = __floor__ = __ceil__ = __trunc__ = _refused

    def __bool__(self) -> bool:
        raise self.graph.refuse("it branches on a value: take np.where")

    def __hash__(self) -> int:
        raise self.graph.refuse("it looks a component up")

    def copy(self) -> "Symbol":
        """A copy with the same value."""
        return Symbol(self.graph, self.number)

    def clip(self, *given: Any, **options: Any) -> Any:
        """Like NumPy's."""
        from estlab.compiled.arrays import called

        return called(self.graph, np.clip, (self, *given), options)

    def cos_sin(self) -> "tuple[Symbol, Symbol]":
        """Cosine and sine; see estlab.maths.space.cos_sin."""
        return made(self.graph, "cos", (self,)), made(self.graph, "sin", (self,))


class Symbols(np.ndarray[Any, np.dtype[Any]]):
    """An array of components: NumPy's functions apply to its entries."""

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *given: Any, **options: Any) -> Any:
        return applied(_graph(given, options), ufunc, method, given, options)

    def __array_function__(self, function: Callable[..., Any], types: Any, given: Any, options: Any) -> Any:
        from estlab.compiled.arrays import called

        return called(_graph(given, options), function, given, options)


def symbols(entries: Sequence[Any], shape: tuple[int, ...] | None = None) -> Symbols:
    """An array of these entries."""
    array = np.empty(len(entries), object)
    for i, entry in enumerate(entries):
        array[i] = entry
    return array.reshape((len(entries),) if shape is None else shape).view(Symbols)


def applied(graph: Expressions, ufunc: np.ufunc, method: str, given: Any, options: Any) -> Any:
    """A ufunc of NumPy."""
    out = options.pop("out", None)
    axis = options.pop("axis", 0) if method in ("reduce", "accumulate") else 0
    options = {key: value for key, value in options.items() if not _usual(key, value)}
    if ufunc is np.matmul and method == "__call__" and not options and out is None:
        return _product(*given)
    if method == "reduce" and set(options) <= {"keepdims"}:
        return _put(out, _reduced(graph, ufunc, given[0], axis, options.get("keepdims", False)))
    if method != "__call__" or options:
        raise graph.refuse(f"np.{ufunc.__name__} with {', '.join(options) or method} is not known to the tracer")
    return _put(out, each(graph, lambda g, *parts: made(g, ufunc.__name__, parts), given))


def _usual(key: str, value: Any) -> bool:
    """Whether an option has its default."""
    return (
        value is None
        or (key == "where" and value is True)
        or (key == "keepdims" and value is False)
        or (key == "initial" and value is np._NoValue)
    )


def made(graph: Expressions, name: str, given: tuple[Any, ...]) -> Any:
    known = UFUNCS.get(name)
    if known is None:
        raise graph.refuse(f"np.{name} is not known to the tracer")
    found = known(graph, *[node(graph, part) for part in given])
    if isinstance(found, str):
        raise graph.refuse(found)
    return Symbol(graph, found)


def node(graph: Expressions, part: Any) -> int:
    """The node number of a component or of a constant."""
    if type(part) is Symbol:
        if part.graph is not graph:
            raise graph.refuse("it keeps a component from another call")
        return part.number
    if isinstance(part, bool | np.bool_):
        return graph.truth(bool(part))
    if isinstance(part, int | float | np.integer | np.floating):
        return graph.constant(float(part))
    if isinstance(part, np.ndarray) and part.ndim == 0:
        return node(graph, part[()])
    raise graph.refuse(f"it computes with a {type(part).__name__}")


def each(graph: Expressions, function: Callable[..., Any], given: Sequence[Any]) -> Any:
    """A function entry by entry, after broadcasting; of single components a single one."""
    if not any(isinstance(part, np.ndarray | list | tuple) for part in given):
        return function(graph, *given)
    arrays = np.broadcast_arrays(*[np.asarray(boxed(part)) for part in given])
    entries = [function(graph, *parts) for parts in zip(*[array.ravel() for array in arrays], strict=True)]
    return symbols(entries, arrays[0].shape)[()]


def boxed(part: Any) -> Any:
    """A component as an array without axes, so that NumPy treats it as one; lists and tuples likewise."""
    if type(part) is Symbol:
        box = np.empty((), object)
        box[()] = part
        return box
    if isinstance(part, Symbols):
        return part.view(np.ndarray)
    if isinstance(part, list | tuple) and any(isinstance(entry, Symbol | np.ndarray | list | tuple) for entry in part):
        return [boxed(entry) for entry in part]
    return part


def viewed(found: Any) -> Any:
    if isinstance(found, list | tuple):
        return type(found)(map(viewed, found))
    if isinstance(found, np.ndarray) and found.dtype == object:
        return found.view(Symbols)[()]
    return found


def _product(a: Any, b: Any) -> Any:
    return viewed(np.matmul(np.asarray(boxed(a), object), np.asarray(boxed(b), object)))


def _reduced(graph: Expressions, ufunc: np.ufunc, array: Any, axis: Any, keepdims: bool) -> Any:
    """Entries combined one after another; truth values that are added are counted."""
    entries = np.asarray(boxed(array))
    if axis is None:
        entries, axis = entries.reshape(-1), 0
    if not isinstance(axis, int) or keepdims:
        raise graph.refuse(f"np.{ufunc.__name__}.reduce over several axes is not known to the tracer")
    rows = list(np.moveaxis(entries, axis, 0))
    if not rows:
        raise graph.refuse(f"np.{ufunc.__name__} of nothing is not known to the tracer")
    if ufunc in (np.add, np.multiply):
        rows[0] = each(graph, lambda g, a: made(g, "counted", (a,)), (rows[0],))
    total = rows[0]
    for row in rows[1:]:
        total = each(graph, lambda g, *parts: made(g, ufunc.__name__, parts), (total, row))
    return viewed(total) if isinstance(total, np.ndarray) else total


def _put(out: Any, found: Any) -> Any:
    """The result, stored in the requested output as well."""
    place = out[0] if isinstance(out, tuple) else out
    if place is None:
        return found
    if type(place) is Symbol:
        place.number = found.number
        return place
    place[...] = found  # an array of plain numbers cannot hold a component: it asks for its number, which is refused
    return place


def _graph(*given: Any) -> Expressions:
    for symbol in _found(given):
        return symbol.graph
    raise TypeError("an array of components without one")


def _found(part: Any) -> Iterator[Symbol]:
    if type(part) is Symbol:
        yield part
    elif isinstance(part, dict):
        yield from _found(list(part.values()))
    elif isinstance(part, list | tuple):
        for entry in part:
            yield from _found(entry)
    elif isinstance(part, np.ndarray) and part.dtype == object:
        yield from _found(part.ravel().view(np.ndarray).tolist())


__all__ = ["Expressions", "Symbol", "Symbols", "UntraceableError", "node", "symbols"]
