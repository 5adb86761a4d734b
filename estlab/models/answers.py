"""Checks of any answer: its kind, its shape, its numbers. Each raises AnswerError with one line."""

from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import numpy as np

from estlab.errors import AnswerError
from estlab.maths.linalg import cholesky
from estlab.maths.space import Array

_ASYMMETRY = 1e-9  # of the two standard deviations: more than rounding

quietly = np.errstate(all="ignore")


def refuse(where: str, what: str) -> NoReturn:
    """Raise AnswerError that says what is wrong with an answer."""
    raise AnswerError(f"{where}: {what}")


def named(function: Any, role: str) -> str:
    """A function by its role in the contract and its own name, if it has another."""
    own = getattr(function, "__name__", role)
    return role if own in (role, "<lambda>") else f"{role} ({own})"


def kind(value: Any) -> str:
    """What a value is, in a few words."""
    if value is None:
        return "nothing (None)"
    if isinstance(value, np.ndarray):
        return f"an array {value.shape}" + ("" if _numeric(value) else f" of {value.dtype}")
    if isinstance(value, list) or type(value) is tuple:
        return f"a {type(value).__name__} of {len(value)}"
    if isinstance(value, bool | int | float | np.number):
        return f"the number {value}"
    return _a(type(value).__name__)


def instance(where: str, what: str, value: Any, wanted: type) -> Any:
    """The value, which must be of this class. what: with its verb, such as "space is"."""
    if not isinstance(value, wanted):
        missing = "; is a return missing?" if value is None and what == "returned" else ""
        refuse(where, f"{what} {kind(value)}; must be {_a(wanted.__name__)}{missing}")
    return value


def numbers(where: str, what: str, value: Any, *shapes: tuple[int, ...], finite: bool = True) -> Array:
    """The array, which must have one of these shapes. what: with its verb, such as "noise_cov returned"."""
    wanted = " or ".join(map(str, dict.fromkeys(shapes)))
    if not isinstance(value, np.ndarray) or not _numeric(value) or value.shape not in shapes:
        refuse(where, f"{what} {kind(value)}; must be an array {wanted}")
    if finite and not np.isfinite(value).all():
        place, entry = _first(~np.isfinite(value), value)
        refuse(where, f"{what} {entry} at {place}; must be finite")
    return value


def whole(where: str, what: str, value: Any, *shapes: tuple[int, ...]) -> Array:
    """The array of whole numbers."""
    found = numbers(where, what, value, *shapes)
    if found.dtype.kind not in "iu":
        refuse(where, f"{what} an array of {found.dtype}; must hold integers: use astype(int)")
    return found


def covariance(where: str, what: str, value: Any, *shapes: tuple[int, ...]) -> Array:
    """The covariance, symmetric and positive semidefinite in each member of its batch."""
    found = numbers(where, what, value, *shapes)
    size = np.sqrt(np.abs(found[range(len(found)), range(len(found))]))
    off = np.abs(found - found.swapaxes(0, 1)) > _ASYMMETRY * size[:, None] * size
    if off.any():
        (i, j, *rest), entry = _first(off, found)
        other = found[(j, i, *rest)]
        refuse(where, f"{what} {entry} at {[i, j]} and {other:g} at {[j, i]}; must be symmetric")
    broken = np.isnan(np.moveaxis(cholesky(found), (0, 1), (-2, -1))).any(axis=(-2, -1))
    if broken.any():
        member = np.moveaxis(found, (0, 1), (-2, -1))[broken][0]
        lowest = np.linalg.eigvalsh(member)[0]
        least = np.diag(member).min()
        why = f"variance {least:g}" if least < 0.0 else f"eigenvalue {lowest:.3g}"
        refuse(where, f"{what} a matrix with the {why}; a covariance must be positive semidefinite")
    return found


def components(where: str, what: str, value: Any, names: Sequence[str], batch: tuple[int, ...]) -> Array:
    """Components, each a number or an array of the batch's shape, as one array (n, *batch)."""
    n, listed = len(names), ", ".join(names)
    few = f"must be a tuple of {n} component{'s' * (n != 1)} ({_short(listed)})"
    if not _listed(value):
        comma = "; write (value,), with the comma" if n == 1 and value is not None else ""
        missing = "; is a return missing?" if value is None else ""
        refuse(where, f"{what} {kind(value)}; {few}{comma}{missing}")
    if len(value) != n:
        refuse(where, f"{what} {len(value)} component{'s' * (len(value) != 1)}; {few}")
    found = np.empty((n, *batch))
    for i, (name, component) in enumerate(zip(names, value, strict=True)):
        found[i] = entry(where, f"{what} for {name}", component, batch)
    return found


def entry(where: str, what: str, value: Any, batch: tuple[int, ...]) -> Any:
    """A number, or an array of no other shape than the batch's."""
    try:
        array = np.asarray(value)
    except ValueError:
        array = np.asarray(None)
    if not _numeric(array):
        refuse(where, f"{what} {kind(value)}; must be a number or an array")
    try:
        fits = np.broadcast_shapes(array.shape, batch) == batch
    except ValueError:
        fits = False
    if not fits:
        refuse(where, f"{what} {kind(array)} where its arguments have {batch}; must have that shape")
    return array


def rows(where: str, what: str, value: Any, m: int, n: int, batch: tuple[int, ...]) -> Array:
    """Rows of components as one array (m, n, *batch)."""
    shape = f"must be {m} row{'s' * (m != 1)} of {n}"
    if not _listed(value):
        refuse(where, f"{what} {kind(value)}; {shape}")
    if len(value) != m:
        refuse(where, f"{what} {len(value)} row{'s' * (len(value) != 1)}; {shape}")
    found = np.empty((m, n, *batch))
    for i, row in enumerate(value):
        if not _listed(row):
            refuse(where, f"{what} {kind(row)} as row {i}; {shape}")
        if len(row) != n:
            refuse(where, f"{what} {len(row)} entries in row {i}; {shape}")
        for j, value_ in enumerate(row):
            found[i, j] = entry(where, f"{what} for {[i, j]}", value_, batch)
    return found


def unchanged(where: str, what: str, call: Callable[..., Any], *arguments: Any) -> Any:
    """The result of a call, which must not write into its arguments."""
    before = [np.copy(a) if isinstance(a, np.ndarray) else a for a in arguments]
    value = call(*arguments)
    for old, new in zip(before, arguments, strict=True):
        if isinstance(old, np.ndarray) and not np.array_equal(old, new, equal_nan=True):
            refuse(where, f"{what} changed its arguments in place; leave them as they are, and return new values")
    return value


def _short(listed: str) -> str:
    return listed if len(listed) < 60 else f"{listed[:50]}, ..."


def _listed(value: Any) -> bool:
    return isinstance(value, tuple | list) or (isinstance(value, np.ndarray) and value.ndim > 0)


def _numeric(array: Array) -> bool:
    return array.dtype.kind in "biuf"


def _first(where: Array, values: Array) -> tuple[list[int], str]:
    """The first marked position, and the number there."""
    place = [int(i) for i in np.argwhere(where)[0]]
    return place, f"{values[tuple(place)]:g}"


def _a(name: str) -> str:
    """A name with its article."""
    return f"{'an' if name[0] in 'aeiouAEIOU' else 'a'} {name}"
