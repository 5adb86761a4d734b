"""MATLAB files with arrays of structures, one element per time step, and plain variables."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from estlab.datasets.data_files import read_bytes
from estlab.datasets.mat_limits import check_declared
from estlab.datasets.promises import Column, check
from estlab.datasets.whole import write_whole
from estlab.errors import UserError
from estlab.maths.space import Array

_HDF5 = (b"MATLAB 7.3", b"\x89HDF")


@dataclass(frozen=True)
class Frames:
    """The values of each frame, and their times (N,) [s] if the file has them. name: of the variable in the file."""

    name: str
    values: list[Array]
    time: Array | None


@dataclass(frozen=True)
class MatFile:
    """The variables of one file."""

    path: Path
    variables: Mapping[str, Any]

    def frames(self, name: str | None, field: str) -> Frames:
        """A field of every element of the struct array of this name, or of the first one that has such a field.

        Raises UserError that names the file and lists its content if there is none.
        """
        structs = {key: value for key, value in self.variables.items() if _has(value, field)}
        if not structs:
            raise UserError(
                f"{self.path}: expected a struct array {f'{name} ' if name else ''}with a field '{field}'; "
                f"the file holds {self._held()}"
            )
        key = name if name in structs else next(iter(structs))
        elements = structs[str(key)].ravel()
        if not elements.size:
            raise UserError(f"{self.path}: the struct array {key} is empty")
        values = [self._numbers(f"{key}({i + 1}).{field}", e[field]) for i, e in enumerate(elements)]
        return Frames(f"{key}({{}}).{field}", values, self._times(str(key), elements))

    def vectors(self, name: str | None, field: str, columns: Sequence[Column]) -> tuple[Array, Array | None]:
        """One vector per frame, all of them (n, N), and their times, if any, from a struct array or a matrix.

        A frame with an empty vector was not measured, and is NaN.
        """
        size = len(columns)
        if not any(_has(value, field) for value in self.variables.values()):
            for key, value in self.variables.items():
                if name in (None, key) and isinstance(value, np.ndarray) and value.ndim == 2 and size in value.shape:
                    return self._matrix(key, value, columns), self._time_variable(max(value.shape))
        frames = self.frames(name, field)
        only = frames.values[0]
        if len(frames.values) == 1 and only.ndim == 2 and only.size > size and size in only.shape:
            return self._matrix(frames.name.format(1), only, columns), None
        for i, vector in enumerate(frames.values):
            if vector.size != size and not (vector.size == 0 and columns[0].missing):
                names = " ".join(column.name for column in columns)
                raise UserError(
                    f"{self.path}: {frames.name.format(i + 1)} must be {size} finite numbers [{names}]; "
                    f"it is of shape {vector.shape}"
                )
        lost = np.full(size, np.nan)
        values = np.stack([vector.ravel() if vector.size else lost for vector in frames.values], axis=1)
        check(columns, values, lambda i: f"{self.path}: {frames.name.format(i + 1)}")
        return values, frames.time

    def array(self, name: str) -> Array:
        """The plain variable of this name; all its numbers must be finite."""
        if name not in self.variables:
            raise UserError(f"{self.path}: expected a variable {name}; the file holds {self._held()}")
        array = self._numbers(name, self.variables[name])
        if not np.isfinite(array).all():
            raise UserError(
                f"{self.path}: {name} holds {array[~np.isfinite(array)][0]}; all its numbers must be finite"
            )
        return array

    def _matrix(self, key: str, value: Array, columns: Sequence[Column]) -> Array:
        values = self._numbers(key, value)
        values = values if values.shape[0] == len(columns) else values.T
        check(columns, values, lambda i: f"{self.path}: {key}, vector {i + 1}")
        return values

    def _times(self, key: str, elements: Array) -> Array | None:
        """The field t [s] of each element; None if it is missing or empty in all."""
        if "t" not in (elements.dtype.names or ()):
            return None
        times = [self._numbers(f"{key}({i + 1}).t", e["t"]) for i, e in enumerate(elements)]
        if not any(time.size for time in times):
            return None
        for i, time in enumerate(times):
            if time.size != 1 or not np.isfinite(time).all():
                raise UserError(f"{self.path}: element {i + 1} field t must be one finite number, its time [s]")
        return np.array([time.item() for time in times])

    def _time_variable(self, count: int) -> Array | None:
        if "t" not in self.variables:
            return None
        time = self.array("t").ravel()
        return time if time.size == count else None

    def _held(self) -> str:
        return ", ".join(f"{name} {v.dtype.names or v.shape}" for name, v in self.variables.items()) or "nothing"

    def _numbers(self, what: str, value: Any) -> Array:
        try:
            return np.asarray(np.asarray(value, dtype=object).tolist(), dtype=float)
        except (TypeError, ValueError) as error:
            raise UserError(f"{self.path}: {what} is not an array of numbers") from error


def load(path: Path) -> MatFile:
    """The content of a file.

    Raises UserError for a file that is not MATLAB's, or that declares more than its bytes can hold.
    """
    from scipy.io import loadmat

    content = read_bytes(path)
    if content.startswith(_HDF5):
        raise UserError(f"{path}: saved as version 7.3, which is HDF5; save it with save(..., '-v7')")
    check_declared(path, content)
    try:
        variables: dict[str, Any] = loadmat(io.BytesIO(content))
    except Exception as error:  # scipy raises many kinds of error for a file that is not MATLAB's
        raise UserError(
            f"{path}: not a readable MATLAB file; it must be complete and saved as version 7 or older"
        ) from error
    return MatFile(path, {name: value for name, value in variables.items() if not name.startswith("__")})


def write(path: Path, variables: Mapping[str, Array | Sequence[Mapping[str, Array]]]) -> Path:
    """Write plain variables, and sequences of mappings as 1 x N struct arrays with the fields of the first mapping."""
    from scipy.io import savemat

    held = {name: _struct(value) if isinstance(value, list) else value for name, value in variables.items()}
    return write_whole(path, lambda stream: savemat(stream, held, do_compression=True))


def _struct(elements: Sequence[Mapping[str, Array]]) -> Array:
    fields = list(elements[0])
    array = np.empty((1, len(elements)), dtype=[(f, object) for f in fields])
    for i, element in enumerate(elements):
        array[0, i] = tuple(element[f] for f in fields)
    return array


def _has(value: Any, field: str) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.names is not None and field in value.dtype.names
