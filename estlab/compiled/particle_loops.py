"""Loops over runs and over the particles of each, around the routines of a particle filter.

A run's particles are processed eight at a time, whatever the width of vectors. If their number is not a multiple of
eight, the last ones are copied aside, with copies of the last particle of zero weight, and the results are copied
back.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estlab.compiled import emit
from estlab.compiled.emit import ATTRIBUTES, Access
from estlab.compiled.flow import loop, row, when
from estlab.compiled.functions import Lowered
from estlab.compiled.particle_routines import EIGHT
from estlab.compiled.programs import MOST_OPERATIONS
from estlab.compiled.routines import Routine
from estlab.compiled.rules import operation
from estlab.compiled.symbols import Symbol, UntraceableError


@dataclass(frozen=True)
class ParticleColumn:
    """Numbers of a run's particles, one row for each of some components: pointer + row * stride + particle.

    fill: the value for copies of the last particle; None: its own. padded: whether there is room for a multiple of
    eight.
    """

    pointer: str
    rows: int
    stride: str
    fill: str | None = None
    padded: bool = False


Columns = Mapping[str, ParticleColumn]


def over(
    v: str, routine: Routine, columns: Columns, read: Sequence[str], written: Sequence[str], lanes: int
) -> list[str]:
    """A routine for all particles of the run. read, written: columns whose last particles are copied aside and back."""
    access = {name: Access("lanes", f"%{name}_stride") for name in columns} | _ACCESS
    lines, used = _text(routine, access, lanes)
    columns = {name: column for name, column in columns.items() if name in used}
    places, first = {}, 0
    for name, column in columns.items():
        places[name], first = first, first + EIGHT * column.rows
    read, written = ([name for name in names if name in columns] for names in (read, written))
    inward = [line for name in read for line in _copied_in(f"{v}_{name}", columns[name], places[name])]
    outward = [line for name in written for line in _copied_out(f"{v}_{name}", columns[name], places[name])]
    body = [
        f"%{v}_p = mul i64 %{v}, {EIGHT}",
        f"%{v}_last = icmp sgt i64 %{v}_p, %latest",
        f"%{v}_present = select i1 %{v}_last, ptr %present_last, ptr %present",
    ]
    strides = {}
    for name, column in columns.items():
        lines_of, strides[name] = _columns_place(f"%{v}_{name}", column, places[name], v)
        body += lines_of
    for part in range(0, EIGHT, lanes):
        given = dict(_GIVEN)
        bases = {name: f"%{v}_{name}_at" for name in columns}
        bases |= {"sums": "%sums", "flag": "%run_flags", "present": f"%{v}_present"}
        for name, base in bases.items():
            given[name] = f"%{v}{part}_{name}_at"
            body.append(f"{given[name]} = getelementptr double, ptr {base}, i64 {part}")
        given |= {f"{name}_stride": stride for name, stride in strides.items()}
        body += _inlined(lines, f"{v}{part}_", given)
    return [
        *when(f"{v}_in", "%partial", inward),
        *loop(v, "0", "%eights", body),
        *when(f"{v}_back", "%partial", outward),
    ]


def _columns_place(base: str, column: ParticleColumn, place: int, v: str) -> tuple[list[str], str]:
    """<base>_at, the address of the eight numbers: in the column, or aside for the last ones; and their stride."""
    if column.padded:
        return [f"{base}_at = getelementptr double, ptr {column.pointer}, i64 %{v}_p"], column.stride
    return [
        f"{base}_full = getelementptr double, ptr {column.pointer}, i64 %{v}_p",
        f"{base}_aside = getelementptr double, ptr %aside, i64 {place}",
        f"{base}_at = select i1 %{v}_last, ptr {base}_aside, ptr {base}_full",
        f"{base}_stride = select i1 %{v}_last, i64 {EIGHT}, i64 {column.stride}",
    ], f"{base}_stride"


def once(v: str, routine: Routine, lanes: int) -> list[str]:
    """A routine for the run, with the same numbers in all lanes."""
    lines, _ = _text(routine, {name: Access("one") for name in (*_ACCESS, *_OF_RUN)} | _FLAG, lanes)
    return _inlined(lines, f"{v}_", {**_GIVEN, "flag": "%run_flags"})


_FLAG = {"flag": Access("lanes", str(EIGHT))}
_OF_RUN = ("control", "factor", "reading", "whitening", "landmark", "mean", "cov", "size", "vanished", "whitened",
           "log_scale")  # fmt: skip
# Values that are the same for all particles of a run, and sums over them.
_ACCESS = {
    **{name: Access("one") for name in (*_OF_RUN, "noise", "top", "total")},
    **_FLAG,
    "lapse": Access("value"),
    "sums": Access("lanes", str(EIGHT)),
    "present": Access("lanes"),
}
_GIVEN = {
    **{name: f"%run_{name}" for name in _OF_RUN},
    "noise": "%noise",
    "top": "%pair",
    "total": "%pair",
    "lapse": "%dt",
    "sums": "%sums",
}


def _text(routine: Routine, access: Mapping[str, Access], lanes: int) -> tuple[list[str], set[str]]:
    """The lines of a routine, and what they load and store. Where a function is not accurate, the run is flagged."""
    graph = routine.tracer.graph
    nodes = [part.number if isinstance(part, Symbol) else graph.constant(float(part)) for _, _, part in routine.outputs]
    lowered = Lowered(graph, nodes, [symbol.number for symbol in routine.failed])
    arithmetic = lowered.graph
    outputs = [(name, index, node) for (name, index, _), node in zip(routine.outputs, lowered.outputs, strict=True)]
    if arithmetic.nodes[lowered.beyond][0] != "false":
        flag = operation(arithmetic, "select", lowered.beyond, arithmetic.constant(1.0), arithmetic.leaf("flag", 0))
        outputs.append(("flag", 0, flag))
    order = arithmetic.needed(node for _, _, node in outputs)
    if len(order) > MOST_OPERATIONS:
        raise UntraceableError(
            f"a step of {len(order)} operations, of which more than {MOST_OPERATIONS} would take seconds to compile"
        )
    used = {str(arithmetic.nodes[number][1]) for number in order if arithmetic.nodes[number][0] == "leaf"}
    used |= {name for name, _, _ in outputs}
    own = {name: how for name, how in access.items() if name in used}
    return emit.function("routine", arithmetic, outputs, own, lanes)[1:-2], used


def _inlined(lines: Sequence[str], prefix: str, given: Mapping[str, str]) -> list[str]:
    """The lines of a function in place of its call, with named parameters."""

    def renamed(match: re.Match[str]) -> str:
        return given.get(match[1]) or f"%{prefix}{match[1]}"

    return [re.sub(r"%([A-Za-z_0-9]+)", renamed, line) for line in lines]


def _copied_in(v: str, column: ParticleColumn, place: int) -> list[str]:
    """Copies the last particles of a run to their place aside, with copies of the last one."""
    body = [
        f"%{v}_i_real = icmp slt i64 %{v}_i, %rest",
        f"%{v}_i_near = select i1 %{v}_i_real, i64 %{v}_i, i64 %rest_last",
        f"%{v}_i_from = add i64 %{v}_i_near, %tail",
    ]
    for k in range(column.rows):
        x = f"%{v}_{k}"
        body += [
            f"{x}_row = mul i64 {column.stride}, {k}",
            f"{x}_index = add i64 {x}_row, %{v}_i_from",
            f"{x}_at = getelementptr double, ptr {column.pointer}, i64 {x}_index",
            f"{x}_value = load double, ptr {x}_at, align 8",
        ]
        value = f"{x}_value"
        if column.fill is not None:
            body.append(f"{x}_filled = select i1 %{v}_i_real, double {value}, double {column.fill}")
            value = f"{x}_filled"
        body += [
            f"{x}_to = add i64 %{v}_i, {place + EIGHT * k}",
            f"{x}_there = getelementptr double, ptr %aside, i64 {x}_to",
            f"store double {value}, ptr {x}_there, align 8",
        ]
    return loop(f"{v}_i", "0", str(EIGHT), body)


def _copied_out(v: str, column: ParticleColumn, place: int) -> list[str]:
    """Copies the results for the last particles from aside to their place."""
    body = [f"%{v}_o_to = add i64 %{v}_o, %tail"]
    for k in range(column.rows):
        x = f"%{v}_{k}o"
        body += [
            f"{x}_from = add i64 %{v}_o, {place + EIGHT * k}",
            f"{x}_here = getelementptr double, ptr %aside, i64 {x}_from",
            f"{x}_value = load double, ptr {x}_here, align 8",
            f"{x}_row = mul i64 {column.stride}, {k}",
            f"{x}_index = add i64 {x}_row, %{v}_o_to",
            f"{x}_at = getelementptr double, ptr {column.pointer}, i64 {x}_index",
            f"store double {x}_value, ptr {x}_at, align 8",
        ]
    return loop(f"{v}_o", "0", "%rest", body)


def zeros(v: str, count: int, value: str = "0.0") -> list[str]:
    """Resets sums to 0 or to another value."""
    body = [*row(f"{v}_at", "sums", f"%{v}_z"), f"store double {value}, ptr %{v}_at, align 8"]
    return loop(f"{v}_z", "0", str(EIGHT * count), body)


def of_run(name: str, following: str) -> list[str]:
    """%run_<name>, the address of the run's data."""
    return [
        f"%run_{name}_x = mul i64 %nth, {following}",
        f"%run_{name} = getelementptr double, ptr %{name}, i64 %run_{name}_x",
    ]


def each_run(body: Sequence[str]) -> list[str]:
    """The body for each run, %nth of those given and %number of all: its flags, and how its particles are divided."""
    return [
        f"%whole = add i64 %COUNT, {EIGHT - 1}",
        f"%eights = sdiv i64 %whole, {EIGHT}",
        f"%latest = sub i64 %COUNT, {EIGHT}",
        f"%rest = srem i64 %COUNT, {EIGHT}",
        "%rest_last = sub i64 %rest, 1",
        "%tail = sub i64 %COUNT, %rest",
        "%partial = icmp ne i64 %rest, 0",
        f"%present_last = getelementptr double, ptr %present, i64 {EIGHT}",
        *loop("nth", "0", "%RUNS", [
            *row("row_at", "row", "%nth", kind="i64"),
            "%number = load i64, ptr %row_at, align 8",
            *row("run_flags", "flags", "%number", str(EIGHT)),
            *body,
        ]),
    ]  # fmt: skip


def program(fields: Sequence[str], body: Sequence[str], lanes: int, functions: Sequence[str] = ()) -> str:
    """A whole program, @run, with named fields: numbers in capitals, otherwise addresses."""
    lines = [*emit.declarations(lanes), *functions, "define void @run(ptr %fields) #0 {", "entry:"]
    for i, name in enumerate(fields):
        lines += [
            f"%{name}_field = getelementptr i64, ptr %fields, i64 {i}",
            f"%{name} = load {'i64' if name.isupper() else 'ptr'}, ptr %{name}_field, align 8",
        ]
    return "\n".join([*lines, *body, "ret void", "}", ATTRIBUTES, ""])
