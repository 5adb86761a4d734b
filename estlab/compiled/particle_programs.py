"""Programs of a particle filter: loops over runs and over the particles of each, around its pieces.

A run's particles are gone through eight at a time, whatever the width of vectors. Where their number is no multiple of
eight, the last ones are copied aside with twins of the last particle, of no weight, and what is found is copied back.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estlab.compiled import emit, numpy_streams, particle_pieces
from estlab.compiled.emit import Access
from estlab.compiled.flow import loop, row, when
from estlab.compiled.functions import Lowered
from estlab.compiled.model_graphs import MotionModel, SensorModel
from estlab.compiled.particle_pieces import EIGHT, Entries
from estlab.compiled.pieces import Piece
from estlab.compiled.programs import ATTRIBUTES, MOST_OPERATIONS
from estlab.compiled.rules import operation
from estlab.compiled.symbols import Symbol, UntraceableError
from estlab.maths.space import Space

# What each program is given, in this order, as 64 bits each: addresses, and numbers (in capitals). A name with _NEXT is
# how many numbers lie from one run to the next, 0 if runs share them; with _STRIDE, from one component to the next.
COMMON = ("RUNS", "COUNT", "row", "flags", "aside", "sums", "present")
MOVING = (*COMMON, "DRAWN", "state", "layers", "z", "Z_NEXT", "before", "after", "CLOUD_STRIDE", "lapse", "control",
          "CONTROL_NEXT", "factor", "FACTOR_NEXT")  # fmt: skip
NORMALISING = (*COMMON, "log", "linear", "size", "vanished", "few")
WEIGHING = (*NORMALISING, "NORMALISED", "point", "CLOUD_STRIDE", "log_before", "weight", "reading", "whitening",
            "WHITENING_NEXT", "place", "PLACE_NEXT", "expected", "EXPECTED_STRIDE", "mean", "cov")  # fmt: skip
SUMMING = (*COMMON, "vector", "CLOUD_STRIDE", "weight", "mean", "cov")
CHOOSING = ("RUNS", "COUNT", "weight", "position", "edge", "chosen")
DRAWING = ("RUNS", "COUNT", "row", "state", "layers", "out", "NORMAL")

_INFINITE = "0x7FF0000000000000"
_LESS_THAN_ALL = "0xFFF0000000000000"


@dataclass(frozen=True)
class Column:
    """Numbers of a run's particles, one row for each of some components: pointer + row * stride + particle.

    fill: what twins of the last particle have; None: what it has. padded: whether there is room for whole eights.
    """

    pointer: str
    rows: int
    stride: str
    fill: str | None = None
    padded: bool = False


Columns = Mapping[str, Column]


def moving(motion: MotionModel, factor: Entries, lanes: int) -> str:
    """The program that draws the noise of particles, and moves them."""
    n, q = motion.space.size, motion.noises
    columns = {
        "z": Column("%run_z", q, "%COUNT"),
        "before": Column("%run_before", n, "%CLOUD_STRIDE"),
        "after": Column("%run_after", n, "%CLOUD_STRIDE"),
    }
    body = [
        *_of_run("z", "%Z_NEXT"),
        *_of_run("before", "%COUNT"),
        *_of_run("after", "%COUNT"),
        *_of_run("control", "%CONTROL_NEXT"),
        *_of_run("factor", "%FACTOR_NEXT"),
        "%dt = load double, ptr %lapse, align 8",
        "%drawn = icmp ne i64 %DRAWN, 0",
        *when("drawing", "%drawn", [
            *row("run_state", "state", "%number", "4"),
            f"%normals = mul i64 %COUNT, {q}",
            "call void @normals(ptr %run_state, ptr %run_z, i64 %normals, ptr %layers)",
        ]),
        *over("m", particle_pieces.move(motion, factor), columns, ("before", "z"), ("after",), lanes),
    ]  # fmt: skip
    return _program(MOVING, _each_run(body), lanes, numpy_streams.text(lanes))


def weighing(sensor: SensorModel, whitening: Entries, lanes: int) -> str:
    """The program that holds particles against a reading, and makes weights of what it finds."""
    n, m, space = sensor.state.size, sensor.space.size, sensor.space
    columns = {
        "point": Column("%run_point", n, "%CLOUD_STRIDE"),
        "log_before": Column("%run_log_before", 1, "0"),
        "weight": Column("%run_weight", 1, "0", fill="0.0"),
        "log": Column("%run_log", 1, "0"),
        "expected": Column("%expected", m, "%EXPECTED_STRIDE", padded=True),
        "vector": Column("%expected", m, "%EXPECTED_STRIDE", padded=True),
    }
    body = [
        *_of_run("point", "%COUNT"),
        *_of_run("log_before", "%COUNT"),
        *_of_run("weight", "%COUNT"),
        *_of_run("log", "%COUNT"),
        *_of_run("reading", str(m)),
        *_of_run("whitening", "%WHITENING_NEXT"),
        *_of_run("place", "%PLACE_NEXT"),
        *_of_run("mean", str(m)),
        *_of_run("cov", str(m * m)),
        *_zeros("a", m + len(space.angles)),
        *over("b", particle_pieces.look(sensor, whitening), columns, ("point", "log_before", "weight"),
              ("log",), lanes),
        *once("c", particle_pieces.mean(space), lanes),
        *_zeros("d", m * (m + 1) // 2),
        *over("e", particle_pieces.spread(space), columns, ("weight",), (), lanes),
        *once("f", particle_pieces.covariance(space), lanes),
        "%normalised = icmp ne i64 %NORMALISED, 0",
        *when("normalising", "%normalised", _normalise(lanes)),
    ]  # fmt: skip
    return _program(WEIGHING, _each_run(body), lanes)


def normalising(lanes: int) -> str:
    """The program that makes weights of logarithms."""
    return _program(NORMALISING, _each_run([*_of_run("log", "%COUNT"), *_normalise(lanes)]), lanes)


def _normalise(lanes: int) -> list[str]:
    columns = {"log": Column("%run_log", 1, "0"), "linear": Column("%run_linear", 1, "0")}
    both = ("log", "linear")
    return [
        *_of_run("linear", "%COUNT"),
        *_of_run("size", "1"),
        *_of_run("vanished", "1"),
        *_zeros("g", 1, _LESS_THAN_ALL),
        *over("h", particle_pieces.peak(), columns, ("log",), (), lanes),
        *once("i", particle_pieces.top(), lanes),
        *_zeros("j", 2),
        *over("k", particle_pieces.exponential(), columns, ("log",), both, lanes),
        *once("l", particle_pieces.normaliser(), lanes),
        *over("n", particle_pieces.share(), columns, both, both, lanes),
    ]


def summing(space: Space, lanes: int) -> str:
    """The program of the moments of clouds."""
    n = space.size
    columns = {
        "vector": Column("%run_vector", n, "%CLOUD_STRIDE"),
        "weight": Column("%run_weight", 1, "0", fill="0.0"),
    }
    body = [
        *_of_run("vector", "%COUNT"),
        *_of_run("weight", "%COUNT"),
        *_of_run("mean", str(n)),
        *_of_run("cov", str(n * n)),
        *_zeros("a", n + len(space.angles)),
        *over("b", particle_pieces.mean_sums(space), columns, ("vector", "weight"), (), lanes),
        *once("c", particle_pieces.mean(space), lanes),
        *_zeros("d", n * (n + 1) // 2),
        *over("e", particle_pieces.spread(space), columns, ("vector", "weight"), (), lanes),
        *once("f", particle_pieces.covariance(space), lanes),
    ]
    return _program(SUMMING, _each_run(body), lanes)


def over(
    v: str, piece: Piece, columns: Columns, read: Sequence[str], written: Sequence[str], lanes: int
) -> list[str]:
    """A piece for all particles of the run."""
    access = {name: Access("lanes", f"%{name}_stride") for name in columns} | _ACCESS
    lines, used = _text(piece, access, lanes)
    columns = {name: column for name, column in columns.items() if name in used}
    places, first = {}, 0
    for name, column in columns.items():
        places[name], first = first, first + EIGHT * column.rows
    aside = {name: column for name, column in columns.items() if not column.padded}
    inward = [
        line for name, column in aside.items() if name in read
        for line in _copied_in(f"{v}_{name}", column, places[name])
    ]  # fmt: skip
    outward = [
        line for name, column in aside.items() if name in written
        for line in _copied_out(f"{v}_{name}", column, places[name])
    ]  # fmt: skip
    body = [
        f"%{v}_p = mul i64 %{v}, {EIGHT}",
        f"%{v}_last = icmp sgt i64 %{v}_p, %latest",
        f"%{v}_present = select i1 %{v}_last, ptr %present_last, ptr %present",
    ]
    for name, column in columns.items():
        base = f"%{v}_{name}"
        whole = f"{base}_full" if name in aside else f"{base}_at"
        body.append(f"{whole} = getelementptr double, ptr {column.pointer}, i64 %{v}_p")
        if name in aside:
            body += [
                f"{base}_aside = getelementptr double, ptr %aside, i64 {places[name]}",
                f"{base}_at = select i1 %{v}_last, ptr {base}_aside, ptr {base}_full",
                f"{base}_stride = select i1 %{v}_last, i64 {EIGHT}, i64 {column.stride}",
            ]
    for part in range(0, EIGHT, lanes):
        given = dict(_GIVEN)
        for name, column in columns.items():
            at = f"{v}{part}_{name}_at"
            body.append(f"%{at} = getelementptr double, ptr %{v}_{name}_at, i64 {part}")
            given[name] = f"%{at}"
            given[f"{name}_stride"] = f"%{v}_{name}_stride" if name in aside else column.stride
        for name, base in (("sums", "%sums"), ("flag", "%run_flags"), ("present", f"%{v}_present")):
            body.append(f"%{v}{part}_{name} = getelementptr double, ptr {base}, i64 {part}")
            given[name] = f"%{v}{part}_{name}"
        body += _inlined(lines, f"{v}{part}_", given)
    return [
        *when(f"{v}_in", "%partial", inward),
        *loop(v, "0", "%eights", body),
        *when(f"{v}_back", "%partial", outward),
    ]


def once(v: str, piece: Piece, lanes: int) -> list[str]:
    """A piece for the run, its numbers being the same in all lanes."""
    lines, _ = _text(piece, {name: Access("one") for name in (*_ACCESS, "mean", "cov", "size")} | _FLAG, lanes)
    return _inlined(lines, f"{v}_", {**_GIVEN, "flag": "%run_flags"})


_FLAG = {"flag": Access("lanes", str(EIGHT))}
# What is the same for all particles of a run, and what is added up over them.
_ACCESS = {
    **{name: Access("one") for name in ("control", "factor", "reading", "whitening", "place", "mean", "top",
                                        "vanished", "total")},
    **_FLAG,
    "lapse": Access("value"),
    "sums": Access("lanes", str(EIGHT)),
    "present": Access("lanes"),
}  # fmt: skip
_GIVEN = {
    **{name: f"%run_{name}" for name in ("control", "factor", "reading", "whitening", "place", "mean", "cov", "size",
                                         "vanished")},
    "top": "%few",
    "total": "%few",
    "lapse": "%dt",
    "sums": "%sums",
}  # fmt: skip


def _text(piece: Piece, access: Mapping[str, Access], lanes: int) -> tuple[list[str], set[str]]:
    """The lines of a piece, and what they load and store. Where a function is not right, the run is flagged."""
    graph = piece.tracer.graph
    nodes = [part.number if isinstance(part, Symbol) else graph.constant(float(part)) for _, _, part in piece.outputs]
    lowered = Lowered(graph, nodes)
    arithmetic = lowered.graph
    outputs = [(name, index, node) for (name, index, _), node in zip(piece.outputs, lowered.outputs, strict=True)]
    if arithmetic.nodes[lowered.beyond][0] != "false":
        flag = operation(
            arithmetic, "select", lowered.beyond, arithmetic.constant(1.0), arithmetic.leaf("flag", 0)
        )
        outputs.append(("flag", 0, flag))
    order = arithmetic.needed(node for _, _, node in outputs)
    if len(order) > MOST_OPERATIONS:
        raise UntraceableError(
            f"a step of {len(order)} operations, of which more than {MOST_OPERATIONS} would take seconds to compile"
        )
    used = {str(arithmetic.nodes[number][1]) for number in order if arithmetic.nodes[number][0] == "leaf"}
    used |= {name for name, _, _ in outputs}
    own = {name: how for name, how in access.items() if name in used}
    return emit.function("piece", arithmetic, outputs, own, lanes)[1:-2], used


def _inlined(lines: Sequence[str], prefix: str, given: Mapping[str, str]) -> list[str]:
    """The lines of a function in the place of its call, with parameters by their names."""

    def renamed(match: re.Match[str]) -> str:
        return given.get(match[1]) or f"%{prefix}{match[1]}"

    return [re.sub(r"%([A-Za-z_0-9]+)", renamed, line) for line in lines]


def _copied_in(v: str, column: Column, place: int) -> list[str]:
    """The last particles of a run into their place aside, with twins of the last one."""
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


def _copied_out(v: str, column: Column, place: int) -> list[str]:
    """What was found of the last particles from aside to where it belongs."""
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


def _zeros(v: str, count: int, value: str = "0.0") -> list[str]:
    """So many sums begun anew, of what is added to."""
    return loop(
        f"{v}_z",
        "0",
        str(EIGHT * count),
        [
            f"%{v}_at = getelementptr double, ptr %sums, i64 %{v}_z",
            f"store double {value}, ptr %{v}_at, align 8",
        ],
    )


def _of_run(name: str, following: str) -> list[str]:
    """%run_<name>, where what belongs to the run begins."""
    return [
        f"%run_{name}_x = mul i64 %nth, {following}",
        f"%run_{name} = getelementptr double, ptr %{name}, i64 %run_{name}_x",
    ]


def _each_run(body: Sequence[str]) -> list[str]:
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


def _program(fields: Sequence[str], body: Sequence[str], lanes: int, functions: Sequence[str] = ()) -> str:
    lines = [*emit.declarations(lanes), *functions, "define void @run(ptr %fields) #0 {", "entry:"]
    for i, name in enumerate(fields):
        lines += [
            f"%{name}_field = getelementptr i64, ptr %fields, i64 {i}",
            f"%{name} = load {'i64' if name.isupper() else 'ptr'}, ptr %{name}_field, align 8",
        ]
    return "\n".join([*lines, *body, "ret void", "}", ATTRIBUTES, ""])


def drawing(lanes: int) -> str:
    """The program that draws uniform or normal numbers of each run's stream."""
    body = [
        *row("row_at", "row", "%nth", kind="i64"),
        "%number = load i64, ptr %row_at, align 8",
        *row("run_state", "state", "%number", "4"),
        *_of_run("out", "%COUNT"),
        "%normal = icmp ne i64 %NORMAL, 0",
        "br i1 %normal, label %normals, label %uniforms",
        "normals:",
        "call void @normals(ptr %run_state, ptr %run_out, i64 %COUNT, ptr %layers)",
        "br label %drawn",
        "uniforms:",
        "call void @uniforms(ptr %run_state, ptr %run_out, i64 %COUNT, ptr %layers)",
        "br label %drawn",
        "drawn:",
    ]
    return _program(DRAWING, loop("nth", "0", "%RUNS", body), lanes, numpy_streams.text(lanes))


def choosing(lanes: int) -> str:
    """The program that finds, for ascending positions in a run's weights added up, the particle that each lies in.

    position: shares of all the weight. Each step passes over a position or over a particle, without a branch.
    """
    add = [
        *row("weight_at", "run_weight", "%add"),
        "%one = load double, ptr %weight_at, align 8",
        "%sum_next = fadd double %sum, %one",
        *row("edge_at", "edge", "%add"),
        "store double %sum_next, ptr %edge_at, align 8",
    ]
    body = [
        *_of_run("weight", "%COUNT"),
        *_of_run("position", "%COUNT"),
        *_of_run("chosen", "%COUNT"),
        *loop("add", "0", "%COUNT", add, {"sum": ("double", "0.0")}),
        *row("end_at", "edge", "%COUNT", "1", "-1"),
        "%end = load double, ptr %end_at, align 8",
        # No position lies beyond the last particle, whatever rounding says.
        f"store double {_INFINITE}, ptr %end_at, align 8",
        "br label %begin",
        "begin:",
        "br label %head",
        "head:",
        "%place = phi i64 [0, %begin], [%place_next, %step]",
        "%particle = phi i64 [0, %begin], [%particle_next, %step]",
        "%more = icmp slt i64 %place, %COUNT",
        "br i1 %more, label %step, label %out",
        "step:",
        *row("position_at", "run_position", "%place"),
        "%share = load double, ptr %position_at, align 8",
        "%here = fmul double %share, %end",
        *row("limit_at", "edge", "%particle"),
        "%limit = load double, ptr %limit_at, align 8",
        "%within = fcmp olt double %here, %limit",
        *row("chosen_at", "run_chosen", "%place", kind="i64"),
        "store i64 %particle, ptr %chosen_at, align 8",
        "%placed = zext i1 %within to i64",
        "%place_next = add i64 %place, %placed",
        "%passed = xor i64 %placed, 1",
        "%particle_next = add i64 %particle, %passed",
        "br label %head",
        "out:",
    ]
    return _program(CHOOSING, loop("nth", "0", "%RUNS", body), lanes)
