"""The first normal numbers of many runs' streams, by compiled code: NumPy's, to the last bit."""

import logging
from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import numpy as np

from estlab.compiled import cache as machine_code
from estlab.compiled import numpy_streams
from estlab.compiled.emit import ATTRIBUTES
from estlab.compiled.flow import loop, row
from estlab.maths.space import Array
from estlab.maths.streams import Streams

log = logging.getLogger("estlab")

_MANY = 500_000  # numbers from which loading the compiler pays
_SAMPLE = 40_000  # numbers, ten of them from the tail


def normals(streams: Streams, purpose: str, runs: Sequence[int], shape: tuple[int, ...]) -> Array:
    """The result of Streams.normals: standard normal numbers (*shape, runs), each run from its own stream."""
    edges = np.arange(len(runs) + 1) * int(np.prod(shape))
    numbers = one_after_another(code() if edges[-1] >= _MANY else None, streams, purpose, runs, edges)
    return np.ascontiguousarray(np.moveaxis(numbers.reshape(len(runs), *shape), 0, -1))


def one_after_another(
    code: "Normals | None", streams: Streams, purpose: str, runs: Sequence[int], edges: Array, room: int = 0
) -> Array:
    """The first edges[i + 1] - edges[i] standard normal numbers of the i-th run, at edges[i] and up; then zeros.

    code: draws them; None for NumPy. room: the number of zeros.
    """
    found = np.empty(edges[-1] + room)
    found[edges[-1] :] = 0.0
    if code is not None:
        code(streams.seeds(purpose, runs), edges, found)
        return found
    for generator, (begin, end) in zip(streams.generators(purpose, runs), pairwise(edges), strict=True):
        generator.standard_normal(out=found[begin:end])
    return found


class Normals:
    """The code. seeds: (runs, 4) words of 64 bits, as a SeedSequence generates them for PCG64."""

    def __init__(self, lanes: int) -> None:
        self._code = machine_code.program(_text(lanes))
        self._run, self._layers = self._code.function("run"), numpy_streams.layers()

    def __call__(self, seeds: Array, edges: Array, found: Array) -> None:
        """Write each run's numbers to found[edges[i] : edges[i + 1]]."""
        arrays = (
            np.ascontiguousarray(seeds, dtype=np.uint64),
            np.ascontiguousarray(edges, dtype=np.int64),
            found,
            self._layers,
        )
        self._run(np.array([len(seeds), *(array.ctypes.data for array in arrays)], dtype=np.int64).ctypes.data)


@cache
def code() -> Normals | None:
    """The code, if there is a compiler and a sample of its numbers equals NumPy's."""
    if not machine_code.loadable():
        return None
    own, seed = Normals(machine_code.lanes()), np.random.SeedSequence(20)
    sample = np.empty(_SAMPLE)
    own(seed.generate_state(4, np.uint64)[None], np.array([0, _SAMPLE]), sample)
    if np.array_equal(sample, np.random.Generator(np.random.PCG64(seed)).standard_normal(_SAMPLE)):
        return own
    log.info("NumPy draws the normal numbers, because those of compiled code differ on this machine")
    return None


def _text(lanes: int) -> str:
    # PCG64 is seeded like NumPy's: an odd increment, and a step before and after the seed is added.
    words = [
        line
        for i, name in enumerate(("seed_hi", "seed_lo", "sequence_hi", "sequence_lo"))
        for line in (
            f"%{name}_at = getelementptr i64, ptr %own, i64 {i}",
            f"%{name}_w = load i64, ptr %{name}_at, align 8",
            f"%{name} = zext i64 %{name}_w to i128",
        )
    ]
    body = [
        *row("own", "seeds", "%i", "4", kind="i64"),
        *words,
        "%seed_up = shl i128 %seed_hi, 64",
        "%seed = or i128 %seed_up, %seed_lo",
        "%sequence_up = shl i128 %sequence_hi, 64",
        "%sequence = or i128 %sequence_up, %sequence_lo",
        "%twice = shl i128 %sequence, 1",
        "%increment = or i128 %twice, 1",
        "%added = add i128 %increment, %seed",
        f"%product = mul i128 %added, {numpy_streams.MULTIPLIER}",
        "%begun = add i128 %product, %increment",
        "store i128 %begun, ptr %state, align 8",
        "store i128 %increment, ptr %state_increment, align 8",
        *row("edge", "edges", "%i", kind="i64"),
        "%first = load i64, ptr %edge, align 8",
        "%edge_next = getelementptr i64, ptr %edge, i64 1",
        "%last = load i64, ptr %edge_next, align 8",
        "%count = sub i64 %last, %first",
        *row("numbers", "found", "%first"),
        "call void @normals(ptr %state, ptr %numbers, i64 %count, ptr %layers)",
    ]
    fields = [
        line
        for i, name in enumerate(("runs", "seeds", "edges", "found", "layers"))
        for line in (
            f"%{name}_field = getelementptr i64, ptr %fields, i64 {i}",
            f"%{name} = load {'i64' if name == 'runs' else 'ptr'}, ptr %{name}_field, align 8",
        )
    ]
    head = ["define void @run(ptr %fields) #0 {", "entry:", *fields, "%state = alloca [4 x i64], align 16"]
    head.append("%state_increment = getelementptr i64, ptr %state, i64 2")
    loops = loop("i", "0", "%runs", body)
    return "\n".join([*numpy_streams.text(lanes), *head, *loops, "ret void", "}", ATTRIBUTES, ""])
