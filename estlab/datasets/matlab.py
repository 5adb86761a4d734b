"""MATLAB files that hold arrays of structures, one element a time step, and plain variables."""

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
    wanted = f"a struct array {name or '(i)'} with a field '{required}'"
    variables = _load(path, wanted)
    for key, value in variables.items():
        if name in (None, key) and _is_struct(value) and required in value.dtype.names:
            elements = [{f: np.asarray(e[f], dtype=object) for f in value.dtype.names} for e in value.ravel()]
            if not elements:
                raise UserError(f"{path}: the struct array {key} is empty")
            return [{f: _numbers(path, f"{key}({i + 1}).{f}", v) for f, v in e.items()} for i, e in enumerate(elements)]
    raise UserError(f"{path}: expected {wanted}; the file holds {_held(variables)}")


def read_vectors(path: Path, name: str | None, field: str, components: Sequence[str]) -> Array:
    """The field of every element of a struct array as one array (n, elements), each of n finite numbers."""
    vectors = []
    for i, element in enumerate(read_struct(path, field, name)):
        vector = element[field]
        if vector.size != len(components) or not np.isfinite(vector).all():
            what = f"{name}({i + 1}).{field}" if name else f"element {i + 1} field {field}"
            held = f"of shape {vector.shape}" if vector.size != len(components) else str(vector.ravel().tolist())
            raise UserError(
                f"{path}: {what} must be {len(components)} finite numbers [{' '.join(components)}]; it is {held}"
            )
        vectors.append(vector.ravel())
    return np.stack(vectors, axis=1)


def read_times(path: Path, beside: str, otherwise: Array) -> Array:
    """The field t [s] of each element of the struct array with the field ``beside``, or ``otherwise`` without it."""
    elements = read_struct(path, beside)
    if "t" not in elements[0]:
        return otherwise
    for i, element in enumerate(elements):
        if element["t"].size != 1 or not np.isfinite(element["t"]).all():
            raise UserError(f"{path}: element {i + 1} field t must be one finite number, its time [s]")
    time = np.array([element["t"].item() for element in elements])
    if not (np.diff(time) > 0.0).all():
        late = int(np.argmin(np.diff(time) > 0.0)) + 2
        raise UserError(f"{path}: element {late} field t does not come after that of the one before; sort the elements")
    return time


def read_array(path: Path, name: str) -> Array:
    """The plain variable of this name, all of it finite numbers."""
    variables = _load(path, f"a variable {name}")
    if name not in variables:
        raise UserError(f"{path}: expected a variable {name}; the file holds {_held(variables)}")
    array = _numbers(path, name, variables[name])
    if not np.isfinite(array).all():
        raise UserError(f"{path}: {name} holds {array[~np.isfinite(array)][0]}; all its numbers must be finite")
    return array


def write(path: Path, variables: Mapping[str, Array | Sequence[Mapping[str, Array]]]) -> Path:
    """Write plain variables, and sequences of mappings as 1 x N struct arrays with the fields of their first."""
    from scipy.io import savemat

    held = {name: _struct(value) if isinstance(value, list) else value for name, value in variables.items()}
    return write_whole(path, lambda stream: savemat(stream, held, do_compression=True))


def _struct(elements: Sequence[Mapping[str, Array]]) -> Array:
    fields = list(elements[0])
    array = np.empty((1, len(elements)), dtype=[(f, object) for f in fields])
    for i, element in enumerate(elements):
        array[0, i] = tuple(element[f] for f in fields)
    return array


def _load(path: Path, wanted: str) -> dict[str, Any]:
    from scipy.io import loadmat

    if not path.is_file():
        raise UserError(
            f"{path}: no such file; data.path must be the folder that holds it, data.prefix what its name begins with"
        )
    try:
        variables: dict[str, Any] = loadmat(path)
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from error
    except Exception as error:  # scipy raises many kinds for a file that is not MATLAB's
        raise UserError(
            f"{path}: not a MATLAB file that can be read; expected {wanted}, saved as version 7 or older"
        ) from error
    return {name: value for name, value in variables.items() if not name.startswith("__")}


def _held(variables: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value.dtype.names or value.shape}" for name, value in variables.items()) or "nothing"


def _is_struct(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.names is not None


def _numbers(path: Path, what: str, value: Array) -> Array:
    try:
        return np.asarray(value.tolist(), dtype=float)
    except (TypeError, ValueError) as error:
        raise UserError(f"{path}: {what} is not an array of numbers") from error
