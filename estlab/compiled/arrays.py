"""NumPy's array functions for arrays of components: those that rearrange entries, and a few that select."""

from collections.abc import Callable
from typing import Any

import numpy as np

from estlab.compiled.symbols import Expressions, Symbol, boxed, each, made, node, symbols, viewed
from estlab.compiled.ufuncs import UFUNCS

# Functions that only rearrange entries, or add and multiply them; NumPy applies them to entries of any kind.
_STRUCTURAL = {
    getattr(np, name)
    for name in (
        "stack", "concatenate", "hstack", "vstack", "column_stack", "atleast_1d", "atleast_2d", "reshape", "ravel",
        "transpose", "moveaxis", "swapaxes", "squeeze", "expand_dims", "broadcast_to", "broadcast_arrays", "take",
        "tile",
        "repeat", "roll", "flip", "diag", "diagonal", "dot", "inner", "outer", "kron", "trace", "cross",
        "tensordot", "copy", "split", "array_split", "append", "delete", "block", "shape", "ndim", "size", "tril",
        "triu",
    )
}  # fmt: skip


_REDUCED: dict[Any, np.ufunc] = {
    np.sum: np.add, np.prod: np.multiply, np.min: np.minimum, np.max: np.maximum,
    np.any: np.logical_or, np.all: np.logical_and,
}  # fmt: skip


def called(graph: Expressions, function: Callable[..., Any], given: Any, options: Any) -> Any:
    """A NumPy function that is not a ufunc."""
    if function is np.where and len(given) == 3 and not options:
        return each(graph, _chosen, given)
    if function is np.clip:
        return _clipped(graph, *given, **options)
    if function in (np.zeros_like, np.ones_like, np.full_like):
        return _filled(function, *given, **options)
    if function is np.round and len(given) == 1 and not options.get("decimals"):
        return each(graph, lambda g, a: made(g, "rint", (a,)), given)
    if function in _REDUCED:
        array, *axis = given
        options = {"axis": axis[0] if axis else None} | options
        return _REDUCED[function].reduce(viewed(np.asarray(boxed(array), object)), **options)
    if function is np.mean:
        total = called(graph, np.sum, given, options)
        return total / (np.size(given[0]) / max(np.size(total), 1))
    if function not in _STRUCTURAL:
        raise graph.refuse(f"np.{getattr(function, '__name__', function)} is not known to the tracer")
    plain = [boxed(part) for part in given]
    found = function.__wrapped__(*plain, **options)  # type: ignore[attr-defined]
    return viewed(found)


def _chosen(graph: Expressions, condition: Any, yes: Any, no: Any) -> Symbol:
    parts = [node(graph, part) for part in (condition, yes, no)]
    return Symbol(graph, UFUNCS["where"](graph, *parts))  # type: ignore[arg-type]


def _clipped(graph: Expressions, a: Any, *bounds: Any, **options: Any) -> Any:
    names = dict(zip(("a_min", "a_max"), bounds, strict=False)) | options
    low, high = names.pop("a_min", names.pop("min", None)), names.pop("a_max", names.pop("max", None))
    if any(value is not None and value is not np._NoValue for value in names.values()):
        raise graph.refuse(f"np.clip with {', '.join(names)} is not known to the tracer")
    for name, bound in (("maximum", low), ("minimum", high)):
        if bound is not None and bound is not np._NoValue:
            a = each(graph, lambda g, *parts, name=name: made(g, name, parts), (a, bound))
    return a


def _filled(function: Callable[..., Any], like: Any, *value: Any, **options: Any) -> Any:
    shape = np.shape(boxed(like))
    fill = {np.zeros_like: 0.0, np.ones_like: 1.0}.get(function, *value) if not value else value[0]
    return fill if shape == () else symbols([fill] * int(np.prod(shape)), shape)
