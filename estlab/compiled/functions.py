"""Elementary functions as graphs of additions, multiplications, divisions and roots: the same bits on every
processor.

Accurate within 2 units in the last place: sin, cos and tan for |x| <= 1e6, arctan2 up to 1e300, hypot from 1e-140 to
1e150, the remainder for quotients up to 2^26, exp and log for all numbers. Outside these ranges the graph reports it
(``Lowered.beyond``), and the caller computes the run another way. Coefficients: FreeBSD msun (k_sin.c, k_cos.c,
s_atan.c, e_exp.c, e_log.c).
"""

import math
from collections.abc import Callable, Iterable, Sequence

from estlab.compiled.graph import Graph
from estlab.compiled.rules import operation

SIN = (-1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04, 2.75573137070700676789e-06,
       -2.50507602534068634195e-08, 1.58969099521155010221e-10)  # fmt: skip
COS = (4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05, -2.75573143513906633035e-07,
       2.08757232129817482790e-09, -1.13596475577881948265e-11)  # fmt: skip
ATAN = (3.33333333333329318027e-01, -1.99999999998764832476e-01, 1.42857142725034663711e-01,
        -1.11111104054623557880e-01, 9.09088713343650656196e-02, -7.69187620504482999495e-02,
        6.66107313738753120669e-02,
        -5.83357013379057348645e-02, 4.97687799461593236017e-02, -3.65315727442169155270e-02,
        1.62858201153657823623e-02)  # fmt: skip
EXP = (1.66666666666666019037e-01, -2.77777777770155933842e-03, 6.61375632143793436117e-05, -1.65339022054652515390e-06,
       4.13813679705723846039e-08)  # fmt: skip
LOG = (6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01, 2.222219843214978396e-01,
       1.818357216161805012e-01, 1.531383769920937332e-01, 1.479819860511658591e-01)  # fmt: skip
# Half of pi, in parts of 33 bits, so that their products with integers up to 2^20 are exact, and the remainder.
HALF_PI = (
    1.57079632673412561417e00,
    6.07710050630396597660e-11,
    2.02226624871116645580e-21,
    8.47842766036889956997e-32,
)
HALF_PI_33 = (HALF_PI[0], 6.07710050650619224932e-11)
# Angles as sums of a double and its remainder.
QUARTER_PI = (7.85398163397448278999e-01, 3.06161699786838301793e-17)
ATAN_HALF = (4.63647609000806093515e-01, 2.26987774529616870924e-17)
LN2 = (6.93147180369123816490e-01, 1.90821492927058770002e-10)
ROUNDING = 6755399441055744.0  # 1.5 * 2^52: adding it rounds a number to an integer, which then stands in the last bits
ROUNDING_BITS = 0x4338000000000000
SIGN_BIT = -(1 << 63)

Function = Callable[..., int]


class Lowered:
    """A graph of arithmetic only, made from one with elementary functions.

    outputs: the nodes that were requested. beyond: whether an argument lies where a function is not accurate.
    """

    def __init__(self, source: Graph, outputs: Sequence[int], conditions: Iterable[int] = ()) -> None:
        self.graph = Graph()
        conditions, places = list(conditions), {}
        self._limits: list[int] = []
        for number in source.needed([*outputs, *conditions]):
            name, *rest = source.nodes[number]
            if name == "const":
                places[number] = self.graph.constant(source.values[number])
            elif name == "leaf":
                places[number] = self.graph.leaf(rest[0], rest[1])  # type: ignore[arg-type]
            elif name in ("true", "false"):
                places[number] = self.graph.truth(name == "true")
            else:
                given = [places[a] for a in source.arguments(number)]
                places[number] = self._made(str(name), given)
        self.outputs = [places[number] for number in outputs]
        self.beyond = self.graph.truth(False)
        for limit in [*self._limits, *(places[number] for number in conditions)]:
            self.beyond = operation(self.graph, "or", self.beyond, limit)

    def _made(self, name: str, given: Sequence[int]) -> int:
        function = FUNCTIONS.get(name)
        if function is None:
            return operation(self.graph, name, *given)
        found, limit = function(Arithmetic(self.graph), *given)
        if limit is not None and limit not in self._limits:
            self._limits.append(limit)
        return found


class Arithmetic:
    """Operations on nodes and constants, in which the functions below are written."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph

    def __getattr__(self, name: str) -> Function:
        return lambda *given: operation(self.graph, name.rstrip("_"), *[self.of(a) for a in given])

    def of(self, a: int | float) -> int:
        """The node of a constant; a node unchanged."""
        return self.graph.constant(a) if isinstance(a, float) else a

    def whole(self, value: int) -> int:
        """A constant of 64 bits."""
        return self.graph.node("iconst", value)

    def polynomial(self, z: int, coefficients: Sequence[float]) -> int:
        """c[0] + z (c[1] + z (...))."""
        total = self.of(coefficients[-1])
        for coefficient in coefficients[-2::-1]:
            total = self.add(self.mul(total, z), coefficient)
        return total

    def ibinary(self, name: str, a: int, b: int) -> int:
        """An operation on bits."""
        return self.graph.node(name, a, b)


Found = tuple[int, int | None]


def _reduced(m: Arithmetic, x: int) -> tuple[int, int, int, int]:
    """x minus its nearest multiple of pi / 2, and its rounding error; the multiple as bits; the limit."""
    shifted = m.add(m.mul(x, 2.0 / math.pi), ROUNDING)
    q = m.sub(shifted, ROUNDING)
    first = m.sub(x, m.mul(q, HALF_PI[0]))
    w = m.mul(q, HALF_PI[1])
    second = m.sub(first, w)
    lost = m.sub(m.sub(first, second), w)
    w = m.mul(q, HALF_PI[2])
    third = m.sub(second, w)
    lost = m.add(lost, m.sub(m.sub(second, third), w))
    tail = m.sub(lost, m.mul(q, HALF_PI[3]))
    high = m.add(third, tail)
    low = m.add(m.sub(third, high), tail)
    return high, low, m.bits(shifted), m.gt(m.abs(x), 1e6)


def _kernels(m: Arithmetic, x: int) -> tuple[int, int, int, int]:
    """Sine and cosine of |x| <= pi / 4; and the rounding error of each."""
    z = m.mul(x, x)
    less = m.mul(m.mul(z, x), m.polynomial(z, SIN))
    sine = m.add(x, less)
    half = m.mul(0.5, z)
    w = m.sub(1.0, half)
    more = m.add(m.sub(m.sub(1.0, w), half), m.mul(m.mul(z, z), m.polynomial(z, COS)))
    cosine = m.add(w, more)
    return sine, cosine, m.add(m.sub(x, sine), less), m.add(m.sub(w, cosine), more)


def _odd(m: Arithmetic, bits: int) -> int:
    """Whether sine and cosine are exchanged."""
    return m.graph.node("ine", m.ibinary("iand", bits, m.whole(1)), m.whole(0))


def _signed(m: Arithmetic, value: int, bits: int) -> int:
    """The value, with its sign changed if the second bit is set."""
    sign = m.ibinary("ishl", m.ibinary("iand", bits, m.whole(2)), m.whole(62))
    return m.graph.node("from_bits", m.ibinary("ixor", m.bits(value), sign))


def sin(m: Arithmetic, x: int) -> Found:
    """The sine."""
    high, _, bits, limit = _reduced(m, x)
    sine, cosine, _, _ = _kernels(m, high)
    found = _signed(m, m.select(_odd(m, bits), cosine, sine), bits)
    # For x = -0 the sum with zero has lost the sign.
    return m.select(m.eq(x, 0.0), x, found), limit


def cos(m: Arithmetic, x: int) -> Found:
    """The cosine."""
    high, _, bits, limit = _reduced(m, x)
    sine, cosine, _, _ = _kernels(m, high)
    return _signed(m, m.select(_odd(m, bits), sine, cosine), m.ibinary("iadd", bits, m.whole(1))), limit


def tan(m: Arithmetic, x: int) -> Found:
    """The tangent: the quotient, corrected for the rounding errors of both sides."""
    high, low, bits, limit = _reduced(m, x)
    sine, cosine, of_sine, of_cosine = _kernels(m, high)
    of_sine, of_cosine = m.add(of_sine, m.mul(low, cosine)), m.sub(of_cosine, m.mul(low, sine))
    odd = _odd(m, bits)
    above, more_above = m.select(odd, m.neg(cosine), sine), m.select(odd, m.neg(of_cosine), of_sine)
    below, more_below = m.select(odd, sine, cosine), m.select(odd, of_sine, of_cosine)
    more = m.div(m.sub(m.mul(more_above, below), m.mul(more_below, above)), m.mul(below, below))
    return m.select(m.eq(x, 0.0), x, m.add(m.div(above, below), more)), limit


def arctan2(m: Arithmetic, y: int, x: int) -> Found:
    """The angle of (x, y): of the smaller over the larger, near 0, near atan(1/2) or near pi / 4; and its octant."""
    ay, ax = m.abs(y), m.abs(x)
    swap = m.gt(ay, ax)
    n, d = m.select(swap, ax, ay), m.select(swap, ay, ax)
    limit = m.gt(d, 1e300)
    middle, upper = m.gt(n, m.mul(d, 7.0 / 16.0)), m.gt(n, m.mul(d, 11.0 / 16.0))
    # (n / d - c) / (1 + c n / d) for c of 0, 1/2 and 1; the differences are exact.
    above = m.select(upper, m.sub(n, d), m.select(middle, m.sub(m.add(n, n), d), n))
    below = m.select(upper, m.add(n, d), m.select(middle, m.add(m.add(d, d), n), d))
    t = m.div(above, m.select(m.eq(below, 0.0), 1.0, below))
    z = m.mul(t, t)
    w = m.mul(z, z)
    s = m.add(m.mul(z, m.polynomial(w, ATAN[::2])), m.mul(w, m.polynomial(w, ATAN[1::2])))
    high, low = (m.select(upper, QUARTER_PI[i], m.select(middle, ATAN_HALF[i], 0.0)) for i in (0, 1))
    angle = m.sub(high, m.sub(m.sub(m.mul(t, s), low), t))
    left = m.graph.node("negative_bits", m.bits(x))
    quarters = m.select(swap, 1.0, m.select(left, 2.0, 0.0))
    angle = m.select(m.graph.node("bxor", swap, left), m.neg(angle), angle)
    found = m.add(m.mul(quarters, HALF_PI_33[0]), m.add(m.mul(quarters, HALF_PI_33[1]), angle))
    return m.copysign(m.abs(found), y), limit


def hypot(m: Arithmetic, a: int, b: int) -> Found:
    """sqrt(a^2 + b^2)."""
    square = m.add(m.mul(a, a), m.mul(b, b))
    some = m.or_(m.ne(a, 0.0), m.ne(b, 0.0))
    small = m.and_(m.lt(square, 1e-280), some)
    return m.sqrt(square), m.or_(m.gt(square, 1e300), small)


def remainder(m: Arithmetic, a: int, b: int) -> Found:
    """a minus the next lower multiple of b, with the sign of b; products of two halves of b are exact."""
    q = m.floor(m.div(a, b))
    spread = m.mul(b, 134217729.0)
    high = m.sub(spread, m.sub(spread, b))
    rest = m.sub(m.sub(a, m.mul(q, high)), m.mul(q, m.sub(b, high)))
    # The quotient was rounded, and may be one too large; a number below an integer is never rounded below it.
    negative, other = m.lt(b, 0.0), m.copysign(0.0, b)
    missed = m.or_(m.and_(negative, m.gt(rest, 0.0)), m.and_(m.not_(negative), m.lt(rest, 0.0)))
    rest = m.select(missed, m.add(rest, b), rest)
    limit = m.or_(m.gt(m.abs(q), 67108864.0), m.gt(m.abs(b), 1e290))
    limit = m.or_(limit, m.or_(m.lt(m.abs(b), 1e-280), m.gt(m.abs(a), 1e290)))
    return m.select(m.eq(rest, 0.0), other, rest), limit


def exp(m: Arithmetic, x: int) -> Found:
    """The exponential of the remainder of x after n log 2, times 2^n in two steps: n may be below all powers."""
    x = m.max(m.min(x, 720.0), -760.0)
    shifted = m.add(m.mul(x, 1.0 / math.log(2.0)), ROUNDING)
    n = m.sub(shifted, ROUNDING)
    high, low = m.sub(x, m.mul(n, LN2[0])), m.mul(n, LN2[1])
    r = m.sub(high, low)
    t = m.mul(r, r)
    c = m.sub(r, m.mul(t, m.polynomial(t, EXP)))
    y = m.sub(1.0, m.sub(m.sub(low, m.div(m.mul(r, c), m.sub(2.0, c))), high))
    whole = m.ibinary("isub", m.bits(shifted), m.whole(ROUNDING_BITS))
    half = m.ibinary("iashr", whole, m.whole(1))
    for power in (half, m.ibinary("isub", whole, half)):
        y = m.mul(y, m.graph.node("from_bits", m.ibinary("ishl", m.ibinary("iadd", power, m.whole(1023)), m.whole(52))))
    return m.select(m.ne(x, x), x, y), None


def log(m: Arithmetic, x: int) -> Found:
    """The natural logarithm: k log 2 plus that of a number near 1."""
    small = m.lt(x, 2.2250738585072014e-308)
    scaled = m.select(small, m.mul(x, 18014398509481984.0), x)
    bits = m.bits(scaled)
    above = m.ibinary("isub", bits, m.whole(0x3FE6A09E667F3BCD))  # sqrt(1/2)
    k = m.ibinary("iashr", above, m.whole(52))
    f = m.sub(m.graph.node("from_bits", m.ibinary("isub", bits, m.ibinary("ishl", k, m.whole(52)))), 1.0)
    number = m.sub(m.graph.node("from_bits", m.ibinary("iadd", k, m.whole(ROUNDING_BITS))), ROUNDING)
    number = m.sub(number, m.select(small, 54.0, 0.0))
    s = m.div(f, m.add(2.0, f))
    z = m.mul(s, s)
    r = m.mul(z, m.polynomial(z, LOG))
    half = m.mul(0.5, m.mul(f, f))
    inner = m.sub(half, m.add(m.mul(s, m.add(half, r)), m.mul(number, LN2[1])))
    found = m.sub(m.mul(number, LN2[0]), m.sub(inner, f))
    found = m.select(m.eq(x, math.inf), x, found)
    found = m.select(m.eq(x, 0.0), -math.inf, found)
    return m.select(m.ge(x, 0.0), found, math.nan), None


FUNCTIONS: dict[str, Callable[..., Found]] = {
    "sin": sin,
    "cos": cos,
    "tan": tan,
    "arctan2": arctan2,
    "hypot": hypot,
    "remainder": remainder,
    "exp": exp,
    "log": log,
}
