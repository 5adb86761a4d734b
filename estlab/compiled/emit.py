"""A graph as a function in LLVM's language, on vectors of runs.

Every operation is one of IEEE 754 on each lane, in the order of the graph, never fused or reordered. So results do
not depend on the number of lanes, on the processor, or on the content of the other lanes.
"""

import struct
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from estlab.compiled.graph import Graph

_ARITHMETIC = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_BITS = {"iadd": "add", "isub": "sub", "iand": "and", "ixor": "xor", "ishl": "shl", "iashr": "ashr"}
_LOGIC = {"and": "and", "or": "or", "bxor": "xor"}
_COMPARISONS = {"lt": "olt", "le": "ole", "gt": "ogt", "ge": "oge", "eq": "oeq", "ne": "une"}
ATTRIBUTES = 'attributes #0 = { nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" }\n!0 = !{i32 1}'
_INTRINSICS = {"sqrt": "sqrt", "floor": "floor", "rint": "rint", "abs": "fabs"}


class Access(NamedTuple):
    """How a leaf or an output of this name lies in memory: its entry ``index`` at pointer + index * stride numbers.

    kind: "lanes", one run beside the other; "one", the same for all (an output is that of the first lane); "value", the
    parameter itself; "landmark", at the pointer + index * stride + the number that each lane has in %landmark_number,
    whose next row, %value_stride further, is for the next ``columns`` indices; "same_landmark" likewise, by the number
    that stands for the first lane.
    streamed: whether what is stored goes past the caches; vectors then lie at whole multiples of their size.
    """

    kind: str
    stride: str = "1"
    columns: int = 1
    streamed: bool = False


class Types:
    """The type names for so many lanes."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        self.d, self.b, self.i = f"<{lanes} x double>", f"<{lanes} x i1>", f"<{lanes} x i64>"
        self.suffix = f"v{lanes}"

    def constant(self, value: float) -> str:
        """The same double in all lanes."""
        return self.splat(f"double 0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}")

    def splat(self, entry: str) -> str:
        """The same constant in all lanes."""
        return "<" + ", ".join([entry] * self.lanes) + ">"


def declarations(lanes: int) -> list[str]:
    """The declarations of the functions that the code calls."""
    t = Types(lanes)
    lines = [f"declare {t.d} @llvm.{name}.{t.suffix}f64({t.d})" for name in _INTRINSICS.values()]
    return [*lines, f"declare {t.d} @llvm.copysign.{t.suffix}f64({t.d}, {t.d})"]


def function(
    name: str,
    graph: Graph,
    outputs: Sequence[tuple[str, int, int]],
    access: dict[str, Access],
    lanes: int,
) -> list[str]:
    """A function that loads leaves, computes, and stores outputs: (name of access, index, node).

    Its parameters are a pointer for each access in order, and an i64 named after each stride that is not a number;
    "value" is a double.
    """
    t = Types(lanes)
    lines: list[str] = []
    names: dict[int, str] = {}
    for number in graph.needed(node for _, _, node in outputs):
        lines += _line(graph, number, names, access, t)
    for kind, index, node in outputs:
        pointer = f"%out_{kind}_{index}"
        lines += _pointer(pointer, kind, index, access[kind])
        if access[kind].kind == "one":
            lines.append(f"{pointer}_s = extractelement {t.d} {names[node]}, i32 0")
            lines.append(f"store double {pointer}_s, ptr {pointer}, align 8")
        else:
            how = f"align {8 * lanes}, !nontemporal !0" if access[kind].streamed else "align 8"
            lines.append(f"store {t.d} {names[node]}, ptr {pointer}, {how}")
    return [f"define internal void @{name}({parameters(access)}) #0 {{", *lines, "ret void", "}"]


def parameters(access: dict[str, Access]) -> str:
    """The parameters of a function with these accesses."""
    return ", ".join(f"{kind} {name}" for kind, name in _parameters(access))


def arguments(access: dict[str, Access], given: dict[str, str]) -> str:
    """The arguments of a call, named like the parameters."""
    return ", ".join(f"{kind} {given[name]}" for kind, name in _parameters(access))


def _parameters(access: dict[str, Access]) -> Iterator[tuple[str, str]]:
    strides: list[str] = []
    for name, how in access.items():
        yield ("double" if how.kind == "value" else "ptr"), f"%{name}"
        if how.kind.endswith("landmark"):
            yield "ptr", "%landmark_number"
        if how.stride.startswith("%") and how.stride not in strides:
            strides.append(how.stride)
    for stride in strides:
        yield "i64", stride


def _pointer(found: str, name: str, index: int, how: Access) -> list[str]:
    if not how.stride.startswith("%"):
        return [f"{found} = getelementptr double, ptr %{name}, i64 {index * int(how.stride)}"]
    offset = f"{found}_o"
    return [f"{offset} = mul i64 {how.stride}, {index}", f"{found} = getelementptr double, ptr %{name}, i64 {offset}"]


def _leaf(found: str, name: str, index: int, how: Access, t: Types) -> list[str]:
    if how.kind == "value":
        return _spread(found, f"%{name}", t)
    pointer = f"{found}_p"
    lines = _pointer(pointer, name, index % how.columns if how.kind.endswith("landmark") else index, how)
    if how.kind == "lanes":
        return [*lines, f"{found} = load {t.d}, ptr {pointer}, align 8"]
    if how.kind == "one":
        return [*lines, f"{found}_s = load double, ptr {pointer}, align 8", *_spread(found, f"{found}_s", t)]
    lines.append(f"{found}_r = mul i64 %value_stride, {index // how.columns}")
    lines.append(f"{found}_w = getelementptr i64, ptr %landmark_number, i64 {found}_r")
    if how.kind == "same_landmark":
        return [
            *lines,
            f"{found}_t = load i64, ptr {found}_w, align 8",
            f"{found}_q = getelementptr double, ptr {pointer}, i64 {found}_t",
            f"{found}_s = load double, ptr {found}_q, align 8",
            *_spread(found, f"{found}_s", t),
        ]
    vector = "poison"
    for lane in range(t.lanes):
        at = f"{found}_{lane}"
        lines += [
            f"{at}_n = getelementptr i64, ptr {found}_w, i64 {lane}",
            f"{at}_t = load i64, ptr {at}_n, align 8",
            f"{at}_p = getelementptr double, ptr {pointer}, i64 {at}_t",
            f"{at}_v = load double, ptr {at}_p, align 8",
            f"{found if lane == t.lanes - 1 else at} = insertelement {t.d} {vector}, double {at}_v, i32 {lane}",
        ]
        vector = at
    return lines


def _spread(found: str, scalar: str, t: Types) -> list[str]:
    first = f"{found}_f"
    return [
        f"{first} = insertelement {t.d} poison, double {scalar}, i32 0",
        f"{found} = shufflevector {t.d} {first}, {t.d} poison, <{t.lanes} x i32> zeroinitializer",
    ]


def _line(graph: Graph, number: int, names: dict[int, str], access: dict[str, Access], t: Types) -> list[str]:
    """The lines that compute a node, whose name is recorded."""
    operation, *rest = graph.nodes[number]
    name = str(operation)
    if name == "const":
        names[number] = t.constant(graph.values[number])
        return []
    if name == "iconst":
        names[number] = t.splat(f"i64 {rest[0]}")
        return []
    if name in ("true", "false"):
        names[number] = t.splat(f"i1 {name}")
        return []
    found = names[number] = f"%v{number}"
    if name == "leaf":
        leaf, index = str(rest[0]), int(rest[1])  # type: ignore[call-overload]
        return _leaf(found, leaf, index, access[leaf], t)
    given = [names[a] for a in graph.arguments(number)]
    if name in _ARITHMETIC:
        return [f"{found} = {_ARITHMETIC[name]} {t.d} {given[0]}, {given[1]}"]
    if name in _BITS:
        return [f"{found} = {_BITS[name]} {t.i} {given[0]}, {given[1]}"]
    if name in _LOGIC:
        return [f"{found} = {_LOGIC[name]} {t.b} {given[0]}, {given[1]}"]
    if name in _COMPARISONS:
        return [f"{found} = fcmp {_COMPARISONS[name]} {t.d} {given[0]}, {given[1]}"]
    if name in _INTRINSICS:
        return [f"{found} = call {t.d} @llvm.{_INTRINSICS[name]}.{t.suffix}f64({t.d} {given[0]})"]
    return _further(name, found, given, t)


def _further(name: str, found: str, given: Sequence[str], t: Types) -> list[str]:
    if name == "neg":
        return [f"{found} = fneg {t.d} {given[0]}"]
    if name == "select":
        return [f"{found} = select {t.b} {given[0]}, {t.d} {given[1]}, {t.d} {given[2]}"]
    if name == "not":
        return [f"{found} = xor {t.b} {given[0]}, {t.splat('i1 true')}"]
    if name == "bits":
        return [f"{found} = bitcast {t.d} {given[0]} to {t.i}"]
    if name == "from_bits":
        return [f"{found} = bitcast {t.i} {given[0]} to {t.d}"]
    if name == "negative_bits":
        return [f"{found} = icmp slt {t.i} {given[0]}, zeroinitializer"]
    if name == "ine":
        return [f"{found} = icmp ne {t.i} {given[0]}, {given[1]}"]
    if name == "copysign":
        return [f"{found} = call {t.d} @llvm.copysign.{t.suffix}f64({t.d} {given[0]}, {t.d} {given[1]})"]
    if name in ("min", "max"):
        # NaN if either is NaN, as in NumPy. A comparison and its choice are one instruction on x86.
        return [
            f"{found}_c = fcmp {'olt' if name == 'min' else 'ogt'} {t.d} {given[0]}, {given[1]}",
            f"{found}_m = select {t.b} {found}_c, {t.d} {given[0]}, {t.d} {given[1]}",
            f"{found}_n = fcmp uno {t.d} {given[0]}, {given[0]}",
            f"{found} = select {t.b} {found}_n, {t.d} {given[0]}, {t.d} {found}_m",
        ]
    raise ValueError(f"{name} cannot be compiled")
