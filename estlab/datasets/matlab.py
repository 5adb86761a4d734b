"""MATLAB files that hold an array of structures, one element a time step."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from estlab.datasets.whole import write_whole
from estlab.errors import UserError
from estlab.maths.space import Array


def read_struct(path: Path, required: str, name: str | None = None) -> list[dict[str, Array]]:
    """The elements of the struct array ``name``, or of the first one that has the field ``required``.

    Raises UserError, naming the file and what it does hold, where there is none.
    """
    from scipy.io import loadmat

    wanted = f"a struct array {name or '(i)'} with a field '{required}'"
    if not path.is_file():
        raise UserError(
            f"{path}: no such file; data.path must be the folder that holds it, data.prefix what its name begins with"
        )
    try:
        variables = loadmat(path)
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from error
    except Exception as error:  # scipy raises many kinds for a file that is not MATLAB's
        raise UserError(
            f"{path}: not a MATLAB file that can be read; expected {wanted}, saved as version 7 or older"
        ) from error
    for key, value in variables.items():
        if name in (None, key) and _is_struct(value) and required in value.dtype.names:
            elements = [{f: np.asarray(e[f], dtype=object) for f in value.dtype.names} for e in value.ravel()]
            if not elements:
                raise UserError(f"{path}: the struct array {key} is empty")
            return [{f: _numbers(path, f"{key}({i + 1}).{f}", v) for f, v in e.items()} for i, e in enumerate(elements)]
    held = ", ".join(f"{k} {v.dtype.names or v.shape}" for k, v in variables.items() if not k.startswith("__"))
    raise UserError(f"{path}: expected {wanted}; the file holds {held or 'nothing'}")


def write_struct(path: Path, name: str, elements: Sequence[Mapping[str, Array]]) -> Path:
    """Write a 1 x N struct array whose elements have the fields of the first."""
    from scipy.io import savemat

    fields = list(elements[0])
    array = np.empty((1, len(elements)), dtype=[(f, object) for f in fields])
    for i, element in enumerate(elements):
        array[0, i] = tuple(element[f] for f in fields)
    return write_whole(path, lambda stream: savemat(stream, {name: array}, do_compression=True))


def _is_struct(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.names is not None


def _numbers(path: Path, what: str, value: Array) -> Array:
    try:
        return np.asarray(value.tolist(), dtype=float)
    except (TypeError, ValueError) as error:
        raise UserError(f"{path}: {what} is not an array of numbers") from error
