"""A component that is not a number yet: NumPy's functions of it become nodes of a graph.

NumPy hands its functions over to their arguments (``__array_ufunc__``, ``__array_function__``), so a model is called as
it stands. What cannot be said without the number itself is refused.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from estlab.compiled.ufuncs import METHODS, UFUNCS
from estlab.compiled.graph import Graph


class Refused(Exception):
    """A model cannot be traced; why."""


class Expressions(Graph):
    """A graph that remembers what was refused, should the model go on all the same."""

    refusal: str | None = None

    def refuse(self, why: str) -> Refused:
        """What is to be raised."""
        self.refusal = self.refusal or why
        return Refused(why)


class Symbol:
    """A number (or truth) of each run, known only later. What works in place changes it, as it would an array."""

    __slots__ = ("graph", "number")
    shape: tuple[int, ...] = ()
    ndim, size = 0, 1
    dtype = np.dtype(float)

    def __init__(self, graph: Expressions, number: int) -> None:
        self.graph, self.number = graph, number

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *given: Any, **options: Any) -> Any:
        return applied(self.graph, ufunc, method, given, options)

    def __array_function__(self, function: Callable[..., Any], types: Any, given: Any, options: Any) -> Any:
        return called(self.graph, function, given, options)

    def __getattr__(self, name: str) -> Any:
        # NumPy calls the method of this name for each entry of an array of objects.
        if name in METHODS:
            return lambda *others: _ufunc(self.graph, name, (self, *others))
        raise AttributeError(f"a component has no {name}")

    def _refused(self, *_: Any, **__: Any) -> Any:
        raise self.graph.refuse("it turns a component into a plain number")

    __float__ = __int__ = __index__ = __complex__ = __round__ = __floor__ = __ceil__ = __trunc__ = _refused

    def __bool__(self) -> bool:
        raise self.graph.refuse("it branches on a value: take np.where")

    def __hash__(self) -> int:
        raise self.graph.refuse("it looks a component up")

    def copy(self) -> "Symbol":
        """Another of the same value."""
        return Symbol(self.graph, self.number)

    def clip(self, *given: Any, **options: Any) -> Any:
        """As NumPy's."""
        return called(self.graph, np.clip, (self, *given), options)

    def cos_sin(self) -> "tuple[Symbol, Symbol]":
        """Cosine and sine; see estlab.maths.space.cos_sin."""
        return _ufunc(self.graph, "cos", (self,)), _ufunc(self.graph, "sin", (self,))


def _binary(name: str, turned: bool) -> Callable[[Symbol, Any], Any]:
    def operator(one: Symbol, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return NotImplemented if type(other) is Symbols else applied(
                one.graph, getattr(np, name), "__call__", (other, one) if turned else (one, other), {}
            )
        return _ufunc(one.graph, name, (other, one) if turned else (one, other))

    return operator


def _in_place(name: str) -> Callable[[Symbol, Any], Any]:
    def operator(one: Symbol, other: Any) -> Any:
        found = _ufunc(one.graph, name, (one, other))
        one.number = found.number
        return one

    return operator


def _unary(name: str) -> Callable[[Symbol], Any]:
    return lambda one: _ufunc(one.graph, name, (one,))


for _name, _operator in {
    "add": "add", "sub": "subtract", "mul": "multiply", "truediv": "divide", "pow": "power", "mod": "remainder",
    "floordiv": "floor_divide", "and": "logical_and", "or": "logical_or", "xor": "logical_xor",
}.items():  # fmt: skip
    setattr(Symbol, f"__{_name}__", _binary(_operator, False))
    setattr(Symbol, f"__r{_name}__", _binary(_operator, True))
    setattr(Symbol, f"__i{_name}__", _in_place(_operator))
for _name, _operator in {
    "lt": "less", "le": "less_equal", "gt": "greater", "ge": "greater_equal", "eq": "equal", "ne": "not_equal",
}.items():  # fmt: skip
    setattr(Symbol, f"__{_name}__", _binary(_operator, False))
for _name, _operator in {"neg": "negative", "pos": "positive", "abs": "absolute", "invert": "logical_not"}.items():
    setattr(Symbol, f"__{_name}__", _unary(_operator))


class Symbols(np.ndarray[Any, np.dtype[Any]]):
    """An array of components: NumPy's functions go by its entries."""

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *given: Any, **options: Any) -> Any:  # type: ignore[override]
        return applied(_graph(given, options), ufunc, method, given, options)

    def __array_function__(self, function: Callable[..., Any], types: Any, given: Any, options: Any) -> Any:
        return called(_graph(given, options), function, given, options)


def symbols(entries: Sequence[Any], shape: tuple[int, ...] | None = None) -> Symbols:
    """An array of these entries."""
    array = np.empty(len(entries), object)
    for i, entry in enumerate(entries):
        array[i] = entry
    return array.reshape(shape or (len(entries),)).view(Symbols)


# What only puts entries in another place, or adds and multiplies them; NumPy does it with entries of any kind.
_STRUCTURAL = {
    getattr(np, name)
    for name in (
        "stack", "concatenate", "hstack", "vstack", "column_stack", "atleast_1d", "atleast_2d", "reshape", "ravel",
        "transpose", "moveaxis", "swapaxes", "squeeze", "expand_dims", "broadcast_to", "broadcast_arrays", "take", "tile",
        "repeat", "roll", "flip", "diag", "diagonal", "sum", "prod", "dot", "inner", "outer", "kron", "trace", "cross",
        "tensordot", "copy", "split", "array_split", "append", "delete", "block", "shape", "ndim", "size", "tril", "triu",
        "cumsum", "min", "max", "amin", "amax",
    )
}  # fmt: skip


def called(graph: Expressions, function: Callable[..., Any], given: Any, options: Any) -> Any:
    """A function of NumPy that is no ufunc."""
    if function is np.where and len(given) == 3 and not options:
        return _each(graph, _chosen, given)
    if function is np.clip:
        return _clipped(graph, *given, **options)
    if function in (np.zeros_like, np.ones_like, np.full_like):
        return _filled(function, *given, **options)
    if function is np.round and len(given) == 1 and not options.get("decimals"):
        return _each(graph, lambda g, a: _ufunc(g, "rint", (a,)), given)
    if function is np.mean:
        total = called(graph, np.sum, given, options)
        return total / (np.size(given[0]) / max(np.size(total), 1))
    if function not in _STRUCTURAL:
        raise graph.refuse(f"np.{getattr(function, '__name__', function)} is not known to the tracer")
    plain = [_boxed(part) for part in given]
    found = function.__wrapped__(*plain, **options)  # type: ignore[attr-defined]
    return _viewed(found)


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
    return _put(out, _each(graph, lambda g, *parts: _ufunc(g, ufunc.__name__, parts), given))


def _usual(key: str, value: Any) -> bool:
    """Whether an option says nothing."""
    return value is None or (key == "where" and value is True) or (key == "keepdims" and value is False) or (
        key == "initial" and value is np._NoValue  # type: ignore[attr-defined]
    )


def _ufunc(graph: Expressions, name: str, given: tuple[Any, ...]) -> Any:
    known = UFUNCS.get(name)
    if known is None:
        raise graph.refuse(f"np.{name} is not known to the tracer")
    found = known(graph, *[node(graph, part) for part in given])
    if isinstance(found, str):
        raise graph.refuse(found)
    return Symbol(graph, found)


def node(graph: Expressions, part: Any) -> int:
    """The number of a component or of a constant."""
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


def _each(graph: Expressions, function: Callable[..., Any], given: Sequence[Any]) -> Any:
    """A function entry by entry, after broadcasting; of single components a single one."""
    if not any(isinstance(part, np.ndarray | list | tuple) for part in given):
        return function(graph, *given)
    arrays = np.broadcast_arrays(*[np.asarray(_boxed(part)) for part in given])
    entries = [function(graph, *parts) for parts in zip(*[array.ravel() for array in arrays], strict=True)]
    return symbols(entries, arrays[0].shape)[()]


def _boxed(part: Any) -> Any:
    """A component as an array of none axes, so that NumPy takes it for one; lists and tuples likewise."""
    if type(part) is Symbol:
        box = np.empty((), object)
        box[()] = part
        return box
    if isinstance(part, Symbols):
        return part.view(np.ndarray)
    if isinstance(part, list | tuple) and any(isinstance(entry, Symbol | np.ndarray | list | tuple) for entry in part):
        return [_boxed(entry) for entry in part]
    return part


def _viewed(found: Any) -> Any:
    if isinstance(found, list | tuple):
        return type(found)(map(_viewed, found))
    if isinstance(found, np.ndarray) and found.dtype == object:
        return found.view(Symbols)[()]
    return found


def _chosen(graph: Expressions, condition: Any, yes: Any, no: Any) -> Symbol:
    parts = [node(graph, part) for part in (condition, yes, no)]
    return Symbol(graph, UFUNCS["where"](graph, *parts))  # type: ignore[arg-type]


def _clipped(graph: Expressions, a: Any, *bounds: Any, **options: Any) -> Any:
    names = dict(zip(("a_min", "a_max"), bounds, strict=False)) | options
    low, high = names.pop("a_min", names.pop("min", None)), names.pop("a_max", names.pop("max", None))
    if any(value is not None and value is not np._NoValue for value in names.values()):  # type: ignore[attr-defined]
        raise graph.refuse(f"np.clip with {', '.join(names)} is not known to the tracer")
    for name, bound in (("maximum", low), ("minimum", high)):
        if bound is not None and bound is not np._NoValue:  # type: ignore[attr-defined]
            a = _each(graph, lambda g, *parts, name=name: _ufunc(g, name, parts), (a, bound))
    return a


def _filled(function: Callable[..., Any], like: Any, *value: Any, **options: Any) -> Any:
    shape = np.shape(_boxed(like))
    fill = {np.zeros_like: 0.0, np.ones_like: 1.0}.get(function, *value) if not value else value[0]
    return fill if shape == () else symbols([fill] * int(np.prod(shape)), shape)


def _product(a: Any, b: Any) -> Any:
    return _viewed(np.matmul(np.asarray(_boxed(a), object), np.asarray(_boxed(b), object)))


def _reduced(graph: Expressions, ufunc: np.ufunc, array: Any, axis: Any, keepdims: bool) -> Any:
    """Entries put together one after another; truths that are added are counted."""
    entries = np.asarray(_boxed(array))
    if axis is None:
        entries, axis = entries.reshape(-1), 0
    if not isinstance(axis, int) or keepdims:
        raise graph.refuse(f"np.{ufunc.__name__}.reduce over several axes is not known to the tracer")
    rows = list(np.moveaxis(entries, axis, 0))
    if not rows:
        raise graph.refuse(f"np.{ufunc.__name__} of nothing is not known to the tracer")
    if ufunc in (np.add, np.multiply):
        rows[0] = _each(graph, lambda g, a: _ufunc(g, "counted", (a,)), (rows[0],))
    total = rows[0]
    for row in rows[1:]:
        total = _each(graph, lambda g, *parts: _ufunc(g, ufunc.__name__, parts), (total, row))
    return _viewed(total) if isinstance(total, np.ndarray) else total


def _put(out: Any, found: Any) -> Any:
    """What was found, also in the place that it was wanted in."""
    place = out[0] if isinstance(out, tuple) else out
    if place is None:
        return found
    if type(place) is Symbol:
        place.number = found.number
        return place
    place[...] = found  # an array of plain numbers takes no component: it is asked for its number, and refuses
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


__all__ = ["Expressions", "Refused", "Symbol", "Symbols", "node", "symbols"]
