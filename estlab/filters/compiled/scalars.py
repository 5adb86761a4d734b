"""NumPy as a model compiled for single numbers sees it, and how all that the loop calls is compiled."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np

F = TypeVar("F", bound=Callable[..., Any])

NJIT: Any = numba.njit  # which knows options that its types do not


def jit(function: F) -> F:
    """The function, to become a part of the one that calls it, where it is compiled.

    A division by zero is infinite or not a number, as in NumPy. Calls would cost more than half of the time.
    """
    return cast(
        F, NJIT(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True, forceinline=True)(function)
    )


@jit
def where(condition: bool, yes: float, no: float) -> float:
    """One number or the other; Numba's own makes an array of them."""
    return yes if condition else no


def __getattr__(name: str) -> Any:
    """Everything else is NumPy's."""
    return getattr(np, name)
