"""A function of components as compiled code over rows of numbers, for tests of the tracer and the compiler."""

import numpy as np

from estlab.compiled import cache, emit, flow
from estlab.compiled.emit import Access
from estlab.compiled.functions import Lowered
from estlab.compiled.interpret import Interpreted
from estlab.compiled.rules import operation
from estlab.compiled.symbols import Symbol
from estlab.compiled.trace import Tracer

WIDE = 'attributes #0 = { nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" }'


def traced(function, size, answers=1):
    """The trace of a function of a vector, and the nodes of its answers."""
    tracer = Tracer()
    found = tracer.call(function, tracer.leaves("x", size), shape=(answers,))
    return tracer.graph, [part.number if isinstance(part, Symbol) else tracer.graph.constant(part) for part in found]


def interpreted(function, size, answers=1):
    """The same as :func:`compiled` by NumPy going through the graph of arithmetic, which takes no compiling."""
    lowered = Lowered(*traced(function, size, answers))
    code = Interpreted(lowered.graph, [*lowered.outputs, lowered.beyond])

    def over(x):
        with np.errstate(all="ignore"):
            *found, beyond = code({("x", i): row for i, row in enumerate(x)})
        shape = x.shape[1:]
        return np.stack([np.broadcast_to(part, shape) for part in found]), np.broadcast_to(beyond, shape)

    return over


def compiled(function, size, answers=1, lanes=2):
    """The function over (size, N): what it answers (answers, N), and whether it is beyond what it is right for (N,)."""
    graph, nodes = traced(function, size, answers)
    lowered = Lowered(graph, nodes)
    one, zero = lowered.graph.constant(1.0), lowered.graph.constant(0.0)
    nodes = [*lowered.outputs, operation(lowered.graph, "select", lowered.beyond, one, zero)]
    access = {name: Access("lanes", "%count") for name in ("x", "y")}
    body = emit.function("body", lowered.graph, [("y", i, node) for i, node in enumerate(nodes)], access, lanes)
    fields = [
        "%x = load ptr, ptr %f",
        "%fy = getelementptr i64, ptr %f, i64 1",
        "%y = load ptr, ptr %fy",
        "%fn = getelementptr i64, ptr %f, i64 2",
        "%count = load i64, ptr %fn",
        f"%n = sdiv i64 %count, {lanes}",
    ]
    each = [f"%k = mul i64 %i, {lanes}", "%xk = getelementptr double, ptr %x, i64 %k",
            "%yk = getelementptr double, ptr %y, i64 %k"]  # fmt: skip
    call = f"call void @body({emit.parameters(access)})"
    each.append(flow.filled(call, {"%x": "%xk", "%y": "%yk"}))
    run = ["define void @run(ptr %f) #0 {", "entry:", *fields, *flow.loop("i", "0", "%n", each), "ret void", "}", WIDE]
    program = cache.program("\n".join([*emit.declarations(lanes), *body, *run]))

    def over(x):
        x = np.ascontiguousarray(x, dtype=float)
        count = -(-x.shape[1] // lanes) * lanes
        x_whole, y = np.pad(x, ((0, 0), (0, count - x.shape[1]))), np.empty((answers + 1, count))
        fields = np.array([x_whole.ctypes.data, y.ctypes.data, count], dtype=np.int64)
        program.function("run")(fields.ctypes.data)
        return y[:-1, : x.shape[1]], y[-1, : x.shape[1]] != 0.0

    return over
