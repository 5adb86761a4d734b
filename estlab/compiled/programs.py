"""Whole programs: loops over groups of runs, steps and readings around the routines of a filter.

A group of runs completes one step before the next, so that its beliefs stay in the nearest cache and rows of the
histories are written in stretches. If the runs do not fill the last vector, it begins earlier and computes some runs
twice, with the same results.
"""

from collections.abc import Mapping

from estlab.compiled import emit
from estlab.compiled.emit import Access
from estlab.compiled.flow import filled, loop, row, when
from estlab.compiled.functions import Lowered
from estlab.compiled.routines import Routine, slots
from estlab.compiled.rules import operation
from estlab.compiled.symbols import Symbol, UntraceableError

# Numbers of a group's beliefs: they stay in the nearest cache if it holds so many vectors, else in the next, since of
# fewer the rows of a history are written in stretches too short.
_NEAREST, _NEXT = 2048, 16384
_VECTORS = 16
MOST_OPERATIONS = 25_000

# The arguments of a program, in this order, as 64 bits each: addresses and numbers.
FIELDS = (
    "runs", "first", "last", "steps", "readings", "reading_stride",
    "controls", "control_stride", "noises",  # columns of the first and the last: runs, or 1
    "parameter", "lapse", "control", "noise", "which", "noise_rows", "bounds", "value", "landmark_number",
    "landmark", "landmarks", "pause", "at_rest", "belief", "room", "mean", "cov", "whitened", "log_scale", "gated",
    "smooth_mean", "smooth_cov",
)  # fmt: skip
_POINTERS = frozenset(FIELDS) - {
    "runs", "first", "last", "steps", "readings", "reading_stride", "controls", "control_stride", "noises",
    "noise_rows", "landmarks", "pause",
}  # fmt: skip


def accesses(
    lanes: int, each_control: bool, each_noise: bool, each_landmark: bool, coordinates: int, streamed: bool
) -> dict[str, Access]:
    """The memory layout of everything that routines load and store."""
    return {
        "belief": Access("lanes", str(lanes)),
        "parameter": Access("one"),
        "lapse": Access("value"),
        "control": Access("lanes" if each_control else "one", "%control_stride"),
        "noise": Access("lanes" if each_noise else "one", "%noise_stride"),
        "value": Access("lanes", "%reading_stride"),
        "landmark": Access("landmark" if each_landmark else "same_landmark", "%landmark_stride", max(coordinates, 1)),
        "mean": Access("lanes", "%history_stride", streamed=streamed),
        "cov": Access("lanes", "%history_stride", streamed=streamed),
        "whitened": Access("lanes", "%value_stride", streamed=streamed),
        "log_scale": Access("lanes", "%value_stride", streamed=streamed),
        "gated": Access("lanes"),
        "before_mean": Access("lanes", "%history_stride"),
        "before_cov": Access("lanes", "%history_stride"),
    }


def routine_of(name: str, routine: Routine, access: Mapping[str, Access], lanes: int) -> tuple[list[str], int, str]:
    """A routine as a function, its number of nodes, and the text of its call with named parameters."""
    graph = routine.tracer.graph
    nodes = [part.number if isinstance(part, Symbol) else graph.constant(float(part)) for _, _, part in routine.outputs]
    lowered = Lowered(graph, nodes, [symbol.number for symbol in routine.failed])
    arithmetic = lowered.graph
    outputs = [(kind, index, node) for (kind, index, _), node in zip(routine.outputs, lowered.outputs, strict=True)]
    if outputs and arithmetic.nodes[lowered.beyond][0] != "false":
        slot = slots(routine.n) - 2
        known = arithmetic.leaf("belief", slot)
        outputs.append(
            ("belief", slot, operation(arithmetic, "select", lowered.beyond, arithmetic.constant(1.0), known))
        )
    order = arithmetic.needed(node for _, _, node in outputs)
    used = {str(arithmetic.nodes[number][1]) for number in order if arithmetic.nodes[number][0] == "leaf"}
    used |= {kind for kind, _, _ in outputs}
    own = {kind: how for kind, how in access.items() if kind in used}
    return emit.function(name, arithmetic, outputs, own, lanes), len(order), _call(name, own)


def _call(name: str, own: dict[str, Access]) -> str:
    return f"call void @{name}({emit.parameters(own)})"


def filtering(routines: Mapping[str, Routine], access: Mapping[str, Access], n: int, lanes: int) -> str:
    """The program of a filter: routines predict, pause (if needed), update and record."""
    functions, calls = _functions(routines, access, lanes)
    body = [
        *loop("v0", "%begin", "%end", [*_at("v0", n, lanes), *_moved("v0", n, lanes, "load")]),
        *loop(
            "k",
            "%first",
            "%last",
            [
                *row("lapse_at", "lapse", "%k"),
                "%dt = load double, ptr %lapse_at, align 8",
                "%passes = fcmp ogt double %dt, 0.0",
                *when("going", "%passes", _predicting("v1", "%k", "%dt", calls["predict"], n, lanes, access)),
                *_bounds(),
                *loop("i", "%i_first", "%i_last", _reading(calls, n, lanes, access)),
                *loop("v3", "%begin", "%end", [*_at("v3", n, lanes), *_recorded("v3", "%k", calls["record"])]),
            ],
        ),
        *loop("v4", "%begin", "%end", [*_at("v4", n, lanes), *_moved("v4", n, lanes, "store")]),
    ]
    return _program(functions, body, n, lanes)


def smoothing(routines: Mapping[str, Routine], access: Mapping[str, Access], n: int, lanes: int) -> str:
    """The program of a smoother: routines smooth and record, from the last step to the first."""
    functions, calls = _functions(routines, access, lanes)
    back = [
        "%k1 = sub i64 %last, %kk",
        "%k = sub i64 %k1, 1",
        "%before = sub i64 %k, 1",
        *row("lapse_at", "lapse", "%k"),
        "%dt = load double, ptr %lapse_at, align 8",
        "%passes = fcmp ogt double %dt, 0.0",
        *when("going", "%passes", _predicting("v1", "%k", "%dt", calls["smooth"], n, lanes, access, "%before")),
        *loop("v3", "%begin", "%end", [*_at("v3", n, lanes), *_recorded("v3", "%before", calls["record"], "smooth_")]),
    ]
    body = [
        *loop("v0", "%begin", "%end", [*_at("v0", n, lanes), *_moved("v0", n, lanes, "load")]),
        "%count = sub i64 %last, 1",
        *loop("kk", "0", "%count", back),
        *loop("v4", "%begin", "%end", [*_at("v4", n, lanes), *_moved("v4", n, lanes, "store")]),
    ]
    return _program(functions, body, n, lanes)


def _functions(
    routines: Mapping[str, Routine], access: Mapping[str, Access], lanes: int
) -> tuple[list[str], dict[str, str]]:
    lines: list[str] = []
    calls: dict[str, str] = {}
    operations = 0
    for name, routine in routines.items():
        text, count, calls[name] = routine_of(name, routine, access, lanes)
        lines += text
        operations += count
    if operations > MOST_OPERATIONS:
        raise UntraceableError(
            f"a step of {operations} operations, of which more than {MOST_OPERATIONS} would take seconds to compile"
        )
    return lines, calls


def _program(functions: list[str], body: list[str], n: int, lanes: int) -> str:
    together = _together(n, lanes)
    lines = [*emit.declarations(lanes), *functions, "define void @run(ptr %fields) #0 {", "entry:"]
    for i, name in enumerate(FIELDS):
        kind = "ptr" if name in _POINTERS else "i64"
        lines += [
            f"%{name}_field = getelementptr i64, ptr %fields, i64 {i}",
            f"%{name} = load {kind}, ptr %{name}_field, align 8",
        ]
    lines += [
        "%pause_time = bitcast i64 %pause to double",
        "%history_stride = mul i64 %steps, %runs",
        "%value_stride = mul i64 %readings, %runs",
        "%noise_stride = mul i64 %noise_rows, %noises",
        "%landmark_stride = add i64 %landmarks, 0",
        f"%whole = add i64 %runs, {lanes - 1}",
        f"%vectors = sdiv i64 %whole, {lanes}",
        f"%more = add i64 %vectors, {together - 1}",
        f"%groups = sdiv i64 %more, {together}",
        f"%latest = sub i64 %runs, {lanes}",
    ]
    group = [
        f"%begin = mul i64 %g, {together}",
        f"%full = add i64 %begin, {together}",
        "%short = icmp slt i64 %vectors, %full",
        "%end = select i1 %short, i64 %vectors, i64 %full",
        *body,
    ]
    return "\n".join([*lines, *loop("g", "0", "%groups", group), "fence seq_cst", "ret void", "}", emit.ATTRIBUTES, ""])


def _at(v: str, n: int, lanes: int) -> list[str]:
    """%<v>_r, the first run of a vector, and %<v>_s, where its belief is."""
    return [
        f"%{v}_m = mul i64 %{v}, {lanes}",
        f"%{v}_c = icmp slt i64 %latest, %{v}_m",
        f"%{v}_r = select i1 %{v}_c, i64 %latest, i64 %{v}_m",
        f"%{v}_d = sub i64 %{v}, %begin",
        f"%{v}_e = mul i64 %{v}_d, {slots(n) * lanes}",
        f"%{v}_s = getelementptr double, ptr %room, i64 %{v}_e",
    ]


def _moved(v: str, n: int, lanes: int, way: str) -> list[str]:
    """Moves beliefs from between two calls into the group's memory, or back."""
    kind, lines = f"<{lanes} x double>", []
    for slot in range(slots(n)):
        x = f"%{v}_{slot}"
        lines += [
            f"{x}_a = mul i64 %runs, {slot}",
            f"{x}_b = add i64 {x}_a, %{v}_r",
            f"{x}_o = getelementptr double, ptr %belief, i64 {x}_b",
            f"{x}_i = getelementptr double, ptr %{v}_s, i64 {slot * lanes}",
        ]
        there, back = (f"{x}_o", f"{x}_i") if way == "load" else (f"{x}_i", f"{x}_o")
        lines += [f"{x}_v = load {kind}, ptr {there}, align 8", f"store {kind} {x}_v, ptr {back}, align 8"]
    return lines


def _predicting(
    v: str, k: str, dt: str, call: str, n: int, lanes: int, access: Mapping[str, Access], before: str = "0"
) -> list[str]:
    """A routine that performs a step for all vectors of the group."""
    control = f"%{v}_r" if access["control"].kind == "lanes" else "0"
    noise = f"%{v}_r" if access["noise"].kind == "lanes" else "0"
    body = [
        *_at(v, n, lanes),
        *row(f"{v}_control", "control", k, "%controls", control),
        *row(f"{v}_which", "which", k, kind="i64"),
        f"%{v}_number = load i64, ptr %{v}_which, align 8",
        *row(f"{v}_noise", "noise", f"%{v}_number", "%noises", noise),
        *row(f"{v}_mean", "mean", before, "%runs", f"%{v}_r"),
        *row(f"{v}_cov", "cov", before, "%runs", f"%{v}_r"),
    ]
    given = {
        "%belief": f"%{v}_s", "%control": f"%{v}_control", "%noise": f"%{v}_noise", "%lapse": dt,
        "%before_mean": f"%{v}_mean", "%before_cov": f"%{v}_cov",
    }  # fmt: skip
    return loop(v, "%begin", "%end", [*body, filled(call, given)])


def _bounds() -> list[str]:
    return [
        *row("bound", "bounds", "%k", kind="i64"),
        "%i_first = load i64, ptr %bound, align 8",
        "%bound_next = getelementptr i64, ptr %bound, i64 1",
        "%i_last = load i64, ptr %bound_next, align 8",
    ]


def _reading(calls: Mapping[str, str], n: int, lanes: int, access: Mapping[str, Access]) -> list[str]:
    """Updates all vectors of the group with reading %i."""
    body = [
        *_at("v2", n, lanes),
        *row("v2_value", "value", "%i", "%runs", "%v2_r"),
        *row("v2_number", "landmark_number", "%i", "%runs", "%v2_r", "i64"),
        *row("v2_whitened", "whitened", "%i", "%runs", "%v2_r"),
        *row("v2_log_scale", "log_scale", "%i", "%runs", "%v2_r"),
    ]
    given = {
        "%belief": "%v2_s", "%value": "%v2_value", "%landmark_number": "%v2_number",
        "%whitened": "%v2_whitened", "%log_scale": "%v2_log_scale",
    }  # fmt: skip
    if "pause" in calls:
        noise = "%v2_r" if access["noise"].kind == "lanes" else "0"
        resting = given | {
            "%control": "%at_rest", "%control_stride": "0", "%noise": "%v2_noise", "%lapse": "%pause_time",
        }  # fmt: skip
        body += [
            "%last_row = sub i64 %noise_rows, 1",
            *row("v2_noise", "noise", "%last_row", "%noises", noise),
            "%further = icmp sgt i64 %i, %i_first",
            *when("resting", "%further", [filled(calls["pause"], resting)]),
        ]
    return loop("v2", "%begin", "%end", [*body, filled(calls["update"], given)])


def _recorded(v: str, k: str, call: str, array: str = "") -> list[str]:
    given = {"%belief": f"%{v}_s", "%mean": f"%{v}_mean", "%cov": f"%{v}_cov", "%gated": f"%{v}_gated"}
    return [
        *row(f"{v}_mean", f"{array}mean", k, "%runs", f"%{v}_r"),
        *row(f"{v}_cov", f"{array}cov", k, "%runs", f"%{v}_r"),
        *row(f"{v}_gated", "gated", k, "%runs", f"%{v}_r"),
        filled(call, given),
    ]


def room(n: int, lanes: int) -> int:
    """How many numbers the beliefs of a group need."""
    return _together(n, lanes) * slots(n) * lanes


def _together(n: int, lanes: int) -> int:
    """How many vectors a group has."""
    near, further = (numbers // (slots(n) * lanes) for numbers in (_NEAREST, _NEXT))
    return near if near >= _VECTORS else max(1, further)
