"""A function applied repeatedly to a state, such as a scan of one ray after another, compiled.

Members are independent, like runs: a vector of them processes its numbers at once, and the result for one depends on
no other.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from estlab.compiled import cache, emit
from estlab.compiled.emit import Access
from estlab.compiled.flow import filled, loop, row
from estlab.compiled.functions import Lowered
from estlab.compiled.rules import operation
from estlab.compiled.symbols import Symbol
from estlab.compiled.trace import Tracer
from estlab.maths.space import Array

_FIELDS = ("members", "vectors", "most", "given", "table", "landmark_number", "kept", "parameter")
_NUMBERS = ("members", "vectors")


class Fold:
    """``function(number, given, looked_up, kept, parameters)`` returns the state kept after one more number.

    given, looked_up, kept, parameters: their numbers of components. The function works on components, as models do.
    Raises UntraceableError that names function, file and line, if it cannot be traced, OSError and ImportError if
    nothing can be compiled.
    """

    def __init__(
        self, function: Callable[..., Any], given: int, looked_up: int, kept: int, parameters: int, lanes: int = 0
    ) -> None:
        self.lanes, self._kept = lanes or cache.lanes(), kept
        tracer = Tracer()
        sizes = {"given": given, "table": looked_up, "kept": kept, "parameter": parameters}
        leaves = (tracer.leaves(name, size) for name, size in sizes.items())
        answer = tracer.call(function, tracer.leaf("number"), *leaves, shape=(kept,))
        graph = tracer.graph
        nodes = [part.number if isinstance(part, Symbol) else graph.constant(part) for part in answer]
        self._program = cache.program(_text(Lowered(graph, nodes), kept, self.lanes))
        self._run = self._program.function("run")

    def __call__(
        self, count: Array, given: Array, table: Array, first: Array, kept: Sequence[float], parameters: Sequence[float]
    ) -> tuple[Array, Array]:
        """The state (k, N) after the numbers 0 to count - 1 of each of N members; and for which (N,) it is correct.

        given: (n, N). table, first: component i that a member looks up for a number is table[first[i] + number],
        where first is (l, N). All members continue as far as the longest, to numbers that the function must ignore,
        so the table ends with as many extra numbers. kept: the initial state.
        """
        members, lanes = count.size, self.lanes
        vectors = -(-members // lanes)
        whole = vectors * lanes
        most = np.zeros(whole, dtype=np.int64)
        most[:members] = count
        state = np.empty((self._kept + 1, whole))
        state[:-1] = np.asarray(kept)[:, None]
        state[-1] = 0.0
        arrays = {
            "most": most.reshape(vectors, lanes).max(axis=1, initial=0),
            "given": _padded(given, whole),
            "table": table,
            "landmark_number": _padded(first, whole),
            "kept": state,
            "parameter": np.array([*parameters, 0.0]),
        }
        numbers = {"members": whole, "vectors": vectors}
        fields = [numbers[name] if name in numbers else arrays[name].ctypes.data for name in _FIELDS]
        self._run(np.array(fields, dtype=np.int64).ctypes.data)
        return state[:-1, :members], state[-1, :members] == 0.0


def _padded(array: Array, size: int) -> Array:
    if array.shape[1] == size:
        return np.ascontiguousarray(array)
    whole = np.zeros((array.shape[0], size), dtype=array.dtype)
    whole[:, : array.shape[1]] = array
    return whole


def _text(lowered: Lowered, kept: int, lanes: int) -> str:
    graph = lowered.graph
    outputs = [("kept", i, node) for i, node in enumerate(lowered.outputs)]
    beyond = operation(graph, "select", lowered.beyond, graph.constant(1.0), graph.leaf("kept", kept))
    access = {
        "given": Access("lanes", "%value_stride"),
        "kept": Access("lanes", "%value_stride"),
        "table": Access("landmark"),
        "parameter": Access("one"),
        "number": Access("value"),
    }
    function = emit.function("step", graph, [*outputs, ("kept", kept, beyond)], access, lanes)
    own = {"%given": "%given_at", "%kept": "%kept_at", "%table": "%table_at", "%landmark_number": "%first_at"}
    call = filled(f"call void @step({emit.parameters(access)})", own)
    numbers = [
        *row("table_at", "table", "%j"),
        "%number = sitofp i64 %j to double",
        call,
    ]
    members = [
        f"%r = mul i64 %v, {lanes}",
        *row("given_at", "given", "%r"),
        *row("kept_at", "kept", "%r"),
        *row("first_at", "landmark_number", "%r", kind="i64"),
        *row("most_at", "most", "%v", kind="i64"),
        "%last = load i64, ptr %most_at, align 8",
        *loop("j", "0", "%last", numbers),
    ]
    lines = [*emit.declarations(lanes), *function, "define void @run(ptr %fields) #0 {", "entry:"]
    for i, name in enumerate(_FIELDS):
        lines.append(f"%{name}_field = getelementptr i64, ptr %fields, i64 {i}")
        lines.append(f"%{name} = load {'i64' if name in _NUMBERS else 'ptr'}, ptr %{name}_field, align 8")
    lines.append("%value_stride = add i64 %members, 0")
    return "\n".join([*lines, *loop("v", "0", "%vectors", members), "ret void", "}", emit.ATTRIBUTES, ""])
