"""NumPy's random numbers in LLVM's language: compiled code continues the streams of estlab.maths.streams.

The generator is PCG64, a linear congruential generator of 128 bits whose output is the xor of both halves, rotated
(O'Neill 2014, PCG XSL RR 128/64). A uniform number is the upper 53 bits of an output. A normal one is NumPy's
ziggurat of 256 layers (Marsaglia and Tsang 2000; Doornik 2005): the last 8 bits of an output choose the layer, the
next one the sign, 52 the position in it. A number in a layer's core is accepted at once, 99 in 100; the rest is
compared with the density.

Numbers equal NumPy's to the last bit: in the tail beyond 3.65, one in 4000, they are logarithms from the library that
NumPy uses. :func:`agrees` compares the code with the installed NumPy.
"""

from collections.abc import Callable
from functools import cache

import numpy as np

from estlab.compiled import emit
from estlab.compiled.flow import loop
from estlab.compiled.functions import Lowered
from estlab.compiled.trace import Tracer
from estlab.maths.space import Array

MULTIPLIER = 0x2360ED051FC65DA44385DF649FCCF645
_WORD, _STATE = 1 << 64, 1 << 128
_TAIL = 3.6541528853610088  # where the lowest layer's tail begins


def states(generators: list[np.random.Generator]) -> Array:
    """The state of streams (runs, 4): state and increment, each as its lower and its upper 64 bits.

    Raises ValueError for a generator of another kind.
    """
    found = np.empty((len(generators), 4), dtype=np.uint64)
    for row, generator in zip(found, generators, strict=True):
        if not isinstance(generator.bit_generator, np.random.PCG64):
            raise ValueError("it only draws from NumPy's PCG64; set engine=numpy")
        whole = generator.bit_generator.state["state"]
        row[:] = [part for name in ("state", "inc") for part in (whole[name] % _WORD, whole[name] // _WORD)]
    return found


@cache
def layers() -> Array:
    """For each layer (256, 4): the number of positions in its core, the width of a position, and the density at both
    edges.

    The widths are read from NumPy itself: for a state whose next output is known, the number is the width.
    """
    bits = np.random.PCG64(0)
    generator, inverse, increment = np.random.Generator(bits), pow(MULTIPLIER, -1, _STATE), 1
    width = np.empty(256)
    for layer in range(256):
        output = 1 << 9 | layer  # the first position; below 2^64, so that nothing is rotated
        before = (output - increment) * inverse % _STATE
        bits.state = {"bit_generator": "PCG64", "state": {"state": before, "inc": increment},
                      "has_uint32": 0, "uinteger": 0}  # fmt: skip
        width[layer] = generator.standard_normal()
    edge = width * 2.0**52
    inner = np.concatenate([[_TAIL, 0.0], edge[1:-1]])
    density = np.exp(-0.5 * np.concatenate([[0.0], edge[1:]]) ** 2)
    table = np.empty((256, 4))
    table[:, 0] = np.rint(inner / edge * 2.0**52).astype(np.int64).view(float)
    table[:, 1], table[:, 2], table[:, 3] = width, density, np.roll(density, 1)
    return table


def text(lanes: int) -> list[str]:
    """Functions @normals and @uniforms (state, out, count, layers), which continue a stream."""
    return [
        *_elementary("density", lambda x: (-0.5 * (x * x)).exp(), lanes),
        "declare double @log1p(double)",
        *_uniforms(),
        *_exact(),
        *_normals(),
    ]


def agrees(draw: Callable[[Array, Array], None]) -> bool:
    """Whether compiled code, called with states and room (1, count), draws the same numbers as NumPy."""
    generator = np.random.Generator(np.random.PCG64(20))
    found = np.empty((1, 40_000))  # ten of them from the tail
    draw(states([generator]), found)
    return bool(np.array_equal(found[0], generator.standard_normal(found.shape[1])))


def _elementary(name: str, function: Callable[..., object], lanes: int) -> list[str]:
    """A function of one number at an address, in place."""
    tracer = Tracer()
    found = function(tracer.leaf("x"))
    lowered = Lowered(tracer.graph, [found.number])  # type: ignore[attr-defined]
    return emit.function(name, lowered.graph, [("x", 0, lowered.outputs[0])], {"x": emit.Access("lanes")}, lanes)


def _output(v: str, state: str) -> list[str]:
    """%<v>, the output of a state."""
    return [
        f"%{v}_lo = trunc i128 {state} to i64",
        f"%{v}_up = lshr i128 {state}, 64",
        f"%{v}_hi = trunc i128 %{v}_up to i64",
        f"%{v}_x = xor i64 %{v}_lo, %{v}_hi",
        f"%{v}_by = lshr i64 %{v}_hi, 58",
        f"%{v} = call i64 @llvm.fshr.i64(i64 %{v}_x, i64 %{v}_x, i64 %{v}_by)",
    ]


def _uniform(v: str, output: str) -> list[str]:
    """%<v>, the number in [0, 1) from an output."""
    return [
        f"%{v}_u = lshr i64 {output}, 11",
        f"%{v}_d = uitofp i64 %{v}_u to double",
        f"%{v} = fmul double %{v}_d, 0x{np.float64(2.0**-53).view(np.uint64):016X}",
    ]


def _candidate(v: str, output: str) -> list[str]:
    """%<v>, the number for an output; %<v>_in, whether it lies in the core of its layer, at %<v>_at."""
    return [
        f"%{v}_n = and i64 {output}, 255",
        f"%{v}_m = shl i64 %{v}_n, 2",
        f"%{v}_at = getelementptr double, ptr %layers, i64 %{v}_m",
        f"%{v}_r = lshr i64 {output}, 9",
        f"%{v}_p = and i64 %{v}_r, {(1 << 52) - 1}",
        f"%{v}_k = load i64, ptr %{v}_at, align 8",
        f"%{v}_in = icmp ult i64 %{v}_p, %{v}_k",
        f"%{v}_wat = getelementptr double, ptr %{v}_at, i64 1",
        f"%{v}_w = load double, ptr %{v}_wat, align 8",
        f"%{v}_f = sitofp i64 %{v}_p to double",
        f"%{v}_a = fmul double %{v}_f, %{v}_w",
        f"%{v}_s = shl i64 {output}, 55",
        f"%{v}_g = and i64 %{v}_s, {-(1 << 63)}",
        f"%{v}_b = bitcast double %{v}_a to i64",
        f"%{v}_c = xor i64 %{v}_b, %{v}_g",
        f"%{v} = bitcast i64 %{v}_c to double",
    ]


def _next() -> list[str]:
    return [
        "define internal i64 @next(ptr %state) #0 {",
        "%before = load i128, ptr %state, align 8",
        "%by = getelementptr i64, ptr %state, i64 2",
        "%increment = load i128, ptr %by, align 8",
        f"%product = mul i128 %before, {MULTIPLIER}",
        "%after = add i128 %product, %increment",
        "store i128 %after, ptr %state, align 8",
        *_output("o", "%after"),
        "ret i64 %o",
        "}",
    ]


def _uniforms() -> list[str]:
    body = [
        "%o = call i64 @next(ptr %state)",
        *_uniform("u", "%o"),
        "%place = getelementptr double, ptr %out, i64 %i",
        "store double %u, ptr %place, align 8",
    ]
    return [
        "declare i64 @llvm.fshr.i64(i64, i64, i64)",
        *_next(),
        "define internal void @uniforms(ptr %state, ptr %out, i64 %count, ptr %layers) #0 {",
        "entry:",
        *loop("i", "0", "%count", body),
        "ret void",
        "}",
    ]


def _exact() -> list[str]:
    """One normal number, however many outputs it takes."""
    tail = f"0x{np.float64(_TAIL).view(np.uint64):016X}"
    inverse = f"0x{np.float64(-1.0 / _TAIL).view(np.uint64):016X}"
    return [
        "define internal double @normal(ptr %state, ptr %layers) #0 {",
        "entry:",
        "%room = alloca [8 x double], align 64",
        "br label %again",
        "again:",
        "%o = call i64 @next(ptr %state)",
        *_candidate("x", "%o"),
        "br i1 %x_in, label %core, label %outside",
        "core:",
        "ret double %x",
        "outside:",
        "%lowest = icmp eq i64 %x_n, 0",
        "br i1 %lowest, label %tail, label %wedge",
        "tail:",  # beyond the lowest layer: one exponential number compared with another
        "%o1 = call i64 @next(ptr %state)",
        *_uniform("u1", "%o1"),
        "%minus1 = fneg double %u1",
        "%log1 = call double @log1p(double %minus1)",
        f"%beyond = fmul double %log1, {inverse}",
        "%o2 = call i64 @next(ptr %state)",
        *_uniform("u2", "%o2"),
        "%minus2 = fneg double %u2",
        "%log2 = call double @log1p(double %minus2)",
        "%twice = fmul double %log2, -2.0",
        "%square = fmul double %beyond, %beyond",
        "%taken = fcmp ogt double %twice, %square",
        "br i1 %taken, label %end, label %tail",
        "end:",
        f"%size = fadd double %beyond, {tail}",
        "%low = lshr i64 %x_p, 8",
        "%odd = trunc i64 %low to i1",
        "%other = fneg double %size",
        "%signed = select i1 %odd, double %other, double %size",
        "ret double %signed",
        "wedge:",
        "%o3 = call i64 @next(ptr %state)",
        *_uniform("u3", "%o3"),
        "%lower_at = getelementptr double, ptr %x_at, i64 2",
        "%upper_at = getelementptr double, ptr %x_at, i64 3",
        "%lower = load double, ptr %lower_at, align 8",
        "%upper = load double, ptr %upper_at, align 8",
        "%height = fsub double %upper, %lower",
        "%part = fmul double %height, %u3",
        "%level = fadd double %part, %lower",
        "store double %x, ptr %room, align 8",
        "call void @density(ptr %room)",
        "%under = load double, ptr %room, align 8",
        "%below = fcmp olt double %level, %under",
        "br i1 %below, label %core, label %again",
        "}",
    ]


def _normals() -> list[str]:
    """Numbers in the cores of their layers are drawn here, with the state in registers; the rest by @normal."""
    return [
        "define internal void @normals(ptr %state, ptr %out, i64 %count, ptr %layers) #0 {",
        "entry:",
        "%first = load i128, ptr %state, align 8",
        "%by = getelementptr i64, ptr %state, i64 2",
        "%increment = load i128, ptr %by, align 8",
        "br label %head",
        "head:",
        "%i = phi i64 [0, %entry], [%next_i, %core], [%next_i, %outside]",
        "%before = phi i128 [%first, %entry], [%after, %core], [%later, %outside]",
        "%more = icmp slt i64 %i, %count",
        "br i1 %more, label %draw, label %done",
        "draw:",
        "%next_i = add i64 %i, 1",
        "%place = getelementptr double, ptr %out, i64 %i",
        f"%product = mul i128 %before, {MULTIPLIER}",
        "%after = add i128 %product, %increment",
        *_output("o", "%after"),
        *_candidate("x", "%o"),
        "br i1 %x_in, label %core, label %outside",
        "core:",
        "store double %x, ptr %place, align 8",
        "br label %head",
        "outside:",
        "store i128 %before, ptr %state, align 8",
        "%number = call double @normal(ptr %state, ptr %layers)",
        "store double %number, ptr %place, align 8",
        "%later = load i128, ptr %state, align 8",
        "br label %head",
        "done:",
        "store i128 %before, ptr %state, align 8",
        "ret void",
        "}",
    ]
