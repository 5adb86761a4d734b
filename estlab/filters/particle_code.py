"""The programs of clouds, called on arrays; and the streams that they draw from."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from estlab.compiled import cache, numpy_streams, particle_programs
from estlab.compiled.model_graphs import MotionModel, SensorModel
from estlab.compiled.particle_routines import EIGHT, Entries
from estlab.filters.particle import whitening_of
from estlab.maths.space import Array
from estlab.maths.streams import Generators
from estlab.models.contract import Motion, Sensor


class ParticleCode:
    """The programs of a motion and a sensor, each made on first use. lanes: particles at once.

    estlab.compiled.particle_programs lists their arguments. Raises UntraceableError that names function, file and
    line, for models that cannot be traced.
    """

    def __init__(self, motion: Motion, sensor: Sensor, lanes: int) -> None:
        self.motion, self.sensor, self.lanes = motion, sensor, lanes
        self._programs: dict[Any, tuple[cache.MachineCode, Callable[[int], None]]] = {}
        self._whitenings: dict[int, tuple[Entries, Array]] = {}  # for readings of so many values, none missing
        self._rooms: dict[str, Array] = {}
        self._addresses: dict[str, int] = {}
        self._kept: dict[int, tuple[dict[str, Array], dict[str, int]]] = {}

    @cached_property
    def agrees(self) -> bool:
        """Whether normal numbers equal those of the installed NumPy."""
        layers, row = numpy_streams.layers(), np.zeros(1, dtype=np.int64)

        def draw(state: Array, out: Array) -> None:
            self.draw(RUNS=1, COUNT=out.size, row=row, state=state, out=out, NORMAL=1, layers=layers)

        return numpy_streams.agrees(draw)

    def draw(self, **given: Any) -> None:
        """Draw numbers from streams."""
        self._run("drawing", self._drawing, particle_programs.DRAWING, given)

    def choose(self, **given: Any) -> None:
        """Find the particles at positions."""
        self._run("choosing", self._choosing, particle_programs.CHOOSING, given)

    def normalise(self, **given: Any) -> None:
        """Turn logarithms into weights."""
        self._run("normalising", self._normalising, particle_programs.NORMALISING, given)

    def sum(self, **given: Any) -> None:
        """Compute the moments of clouds of states."""
        self._run("summing", self._summing, particle_programs.SUMMING, given)

    def move(self, factor: Entries, controls: int, /, **given: Any) -> None:
        """Move particles. factor: nonzero entries of the noise's factor; controls: components of a command."""
        motion = self.motion

        def make() -> str:
            model = MotionModel(motion.space, motion.move, motion.noise_size, controls, None, None)
            return particle_programs.moving(model, factor, self.lanes)

        self._run((factor, controls), make, particle_programs.MOVING, given)

    def weigh(self, whitening: Entries, count: int, /, **given: Any) -> None:
        """Compare particles with ``count`` readings as one. whitening: which of its entries are not zero."""
        sensor = self.sensor

        def make() -> str:
            model = SensorModel(sensor.space, sensor.state, sensor.measure, len(sensor.landmarks), None, None, count)
            return particle_programs.weighing(model, whitening, self.lanes)

        self._run(("weighing", whitening, count), make, particle_programs.WEIGHING, given)

    def whitening(self, sensor: Sensor, reading: Array) -> tuple[Entries, Array]:
        """The factor that whitens differences from a reading (m, runs), by runs; its entries."""
        partial, m = np.isnan(reading).any(), sensor.space.size
        if not partial and m in self._whitenings:
            return self._whitenings[m]
        matrix = whitening_of(sensor, reading)
        found = entries_of(matrix), by_runs(matrix)
        if not partial:
            self._whitenings[m] = found
        return found

    def room(self, name: str, size: int) -> Array:
        """Room for so many numbers, without meaning between two calls."""
        if name not in self._rooms or self._rooms[name].size < size:
            self._rooms[name] = np.empty(size)
            self._addresses[name] = self._rooms[name].ctypes.data
        return self._rooms[name][:size]

    def address(self, name: str, size: int) -> int:
        """The address of that room."""
        if name not in self._rooms or self._rooms[name].size < size:
            self.room(name, size)
        return self._addresses[name]

    def common(self, count: int, rows: int, runs: int, generators: "CompiledGenerators | None") -> dict[str, Any]:
        """The arguments common to all programs over particles. rows: the largest number of components of a vector."""
        own = generators.fields if generators else {"row": np.arange(runs), "flags": np.empty((runs, EIGHT))}
        return self._constants(count) | own | {
            "RUNS": runs, "COUNT": count, "aside": self.address("aside", EIGHT * (3 * rows + 4)),
            "sums": self.address("sums", EIGHT * (rows * (rows + 3) // 2 + 2)),
            "pair": self.address("pair", 2), "edge": self.address("edge", count + 1),
            "position": self.address("position", count + 1),
        }  # fmt: skip

    def _constants(self, count: int) -> dict[str, int]:
        """Addresses of constants that depend only on the number of particles."""
        if count not in self._kept:
            present, even = np.ones(2 * EIGHT), np.array([-np.log(count), 1.0 / count])
            present[EIGHT + count % EIGHT :] = 0.0
            arrays = {"present": present, "even": even, "layers": numpy_streams.layers()}
            self._kept[count] = arrays, {name: array.ctypes.data for name, array in arrays.items()}
        return self._kept[count][1]

    def _run(self, key: Any, make: Callable[[], str], names: Sequence[str], given: dict[str, Any]) -> None:
        if key not in self._programs:
            program = cache.program(make())
            self._programs[key] = program, program.function("run")
        words = [value if type(value) is int else _word(value) for value in map(given.__getitem__, names)]
        self._programs[key][1](np.array(words, dtype=np.int64).ctypes.data)

    def _drawing(self) -> str:
        return particle_programs.drawing(self.lanes)

    def _choosing(self) -> str:
        return particle_programs.choosing(self.lanes)

    def _normalising(self) -> str:
        return particle_programs.normalising(self.lanes)

    def _summing(self) -> str:
        return particle_programs.summing(self.motion.space, self.lanes)


class CompiledGenerators(Generators):
    """Streams of runs that compiled code continues, with the same numbers as NumPy.

    state: (R, 4), the state of the streams. flags: (R, 8), not 0 where a run left the range in which the code is
    correct. row: (runs,), which of the R belong to this batch.
    """

    def __init__(self, code: ParticleCode, state: Array, flags: Array, row: Array) -> None:
        self.code, self.state, self.flags, self.row = code, state, flags, row

    @cached_property
    def fields(self) -> dict[str, int]:
        """The addresses of all three."""
        return {"state": self.state.ctypes.data, "flags": self.flags.ctypes.data, "row": self.row.ctypes.data}

    @classmethod
    def at_start(cls, code: ParticleCode, generators: Generators) -> "CompiledGenerators":
        """Copies of the streams in their current state. Raises ValueError if code and NumPy draw different numbers."""
        state = numpy_streams.states(list(generators))
        if not code.agrees:
            raise ValueError(
                f"NumPy {np.__version__} draws different normal numbers from compiled code; set engine=numpy"
            )
        return cls(code, state, np.zeros((len(state), EIGHT)), np.arange(len(state)))

    def take(self, runs: Array | slice) -> "CompiledGenerators":
        return CompiledGenerators(self.code, self.state, self.flags, self.row[runs])

    def normals(self, shape: tuple[int, ...]) -> Array:
        return self._numbers(shape, normal=1)

    def uniforms(self, shape: tuple[int, ...]) -> Array:
        return self._numbers(shape, normal=0)

    def _numbers(self, shape: tuple[int, ...], normal: int) -> Array:
        numbers = np.empty((self.row.size, *shape))
        count = numbers[:1].size
        self.code.draw(**self.code.common(count, 0, self.row.size, self), out=numbers, NORMAL=normal)
        return np.moveaxis(numbers, 0, -1)


def _word(value: Any) -> int:
    """A field of a program: an address or a number, for a float its bits."""
    if isinstance(value, np.ndarray):
        return value.ctypes.data
    return int(np.float64(value).view(np.int64)) if isinstance(value, float) else int(value)


def flat(values: Array) -> Array:
    """Values (*shape, N, runs) in memory order, each run's side by side."""
    return np.ascontiguousarray(np.swapaxes(values, -1, -2))


def by_runs(values: Array) -> Array:
    """Values (*shape, runs or 1) with runs first."""
    axes = range(values.ndim - 1)
    return np.ascontiguousarray(values.transpose(values.ndim - 1, *axes), dtype=float)


def apart(values: Array) -> int:
    """The distance from one run's values to the next one's: zero if they share them."""
    return 0 if len(values) == 1 else values[0].size


def entries_of(matrix: Array) -> Entries:
    """Which entries of a matrix (q, q, runs or 1) are not zero in all runs; NaN counts as not zero."""
    some = (matrix != 0.0).any(axis=-1).tolist()
    return tuple((i, j) for i, row in enumerate(some) for j, entry in enumerate(row) if entry)
