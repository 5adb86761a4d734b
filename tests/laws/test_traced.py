"""The tracer and what it compiles to: never wrong, the same bits at every width, functions right to two units."""

import functools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estlab.compiled.symbols import UntraceableError
from estlab.compiled.trace import Tracer
from tests.tracing import compiled, interpreted, traced

RNG = np.random.default_rng(4)
NUMBERS = np.concatenate(
    [
        RNG.normal(size=(3, 40)),
        RNG.uniform(-30.0, 30.0, (3, 20)),
        RNG.choice([0.0, -0.0, 1.0, -1.0, 0.5, 2.0, np.pi, np.inf, -np.inf, np.nan], (3, 30)),
    ],
    axis=1,
)


def assert_as_numpy(function, x=NUMBERS, ulps=64.0, lanes=2):
    """Every answer of the compiled function is NumPy's but for rounding, where it does not say that it is beyond."""
    with np.errstate(all="ignore"):
        expected = np.stack([np.asarray(part, dtype=float) + np.zeros(x.shape[1]) for part in function(x)])
    found, beyond = compiled(function, len(x), len(expected), lanes)(x)
    same = np.isclose(found, expected, rtol=ulps * 2.0**-52, atol=ulps * 2.0**-52, equal_nan=True)
    assert (same | beyond).all(), (x[:, ~(same | beyond).all(axis=0)], found, expected)
    assert beyond.mean() < 0.6


# --- elementary functions

_TURNS = np.concatenate(
    [
        RNG.uniform(-7.0, 7.0, 4000),
        RNG.uniform(-1e6, 1e6, 4000),
        np.arange(-2000, 2000) * (np.pi / 2),  # where little is left of them
        np.ldexp(RNG.uniform(-1.0, 1.0, 1000), -RNG.integers(0, 400, 1000)),
    ]
)
_ALL = np.exp(RNG.uniform(-700.0, 700.0, 6000))
_SIDES = np.stack(
    [
        np.concatenate([RNG.normal(size=4000), np.exp(RNG.uniform(-300.0, 300.0, 2000))]),
        np.concatenate([RNG.normal(size=4000), -np.exp(RNG.uniform(-300.0, 300.0, 2000))]),
    ]
)
FUNCTIONS = {
    "sin": _TURNS[None],
    "cos": _TURNS[None],
    "tan": _TURNS[None],
    "exp": np.concatenate([RNG.uniform(-745.0, 709.0, 4000), RNG.normal(size=4000)])[None],
    "log": np.concatenate([_ALL, RNG.uniform(0.5, 2.0, 4000), np.ldexp(1.0 + RNG.random(500), -1060)])[None],
    "arctan2": _SIDES,
    "hypot": np.clip(_SIDES, -1e140, 1e140) + 1e-130,
    "arctan": RNG.normal(size=(1, 3000)) * np.exp(RNG.uniform(-20.0, 20.0, (1, 3000))),
}


@pytest.mark.skipif(np.finfo(np.longdouble).nmant < 63, reason="long double has no more digits here")
@pytest.mark.parametrize("name", FUNCTIONS)
def test_elementary_functions_are_right_to_two_units_in_the_last_place(name):
    x = FUNCTIONS[name]
    function = getattr(np, name)
    (found,), beyond = compiled(lambda x: (function(*x),), len(x), lanes=4)(x)
    exact = function(*x.astype(np.longdouble))
    assert not beyond.any()
    assert (np.abs(found - exact) / np.spacing(np.abs(exact.astype(float)))).max() <= 2.0


def test_far_from_zero_they_say_that_they_are_not_right():
    _, beyond = compiled(lambda x: (np.sin(x[0]), np.arctan2(x[0], 1.0)), 1, 2)(np.array([[1.0, 1.1e6, 1e301, np.inf]]))
    assert beyond.tolist() == [False, True, True, True]


def test_zeros_infinities_and_nan_are_what_they_are_in_numpy():
    special = [0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 5e-324]
    pairs = np.array([(a, b) for a in special for b in special]).T

    def function(x):
        a, b = x
        of_one = [f(a) for f in (np.exp, np.log, np.sign, np.abs, np.sqrt, np.floor, np.rint, np.negative)]
        of_two = [f(a, b) for f in (np.arctan2, np.minimum, np.maximum, np.divide, np.copysign, np.multiply)]
        return (*of_one, *of_two, np.where(a < b, a, b))

    with np.errstate(all="ignore"):
        expected = np.stack(function(pairs))
    found, beyond = compiled(function, 2, 15)(pairs)
    same = np.isclose(found, expected, rtol=2.0**-51, atol=0.0) & (np.signbit(found) == np.signbit(expected))
    assert (same | (np.isnan(found) & np.isnan(expected)) | beyond).all()


def test_vectors_of_all_widths_give_the_bits_of_numpy_going_through_the_graph():
    def function(x):
        a, b, c = x
        return (np.sin(a) * np.tan(b), np.arctan2(b, c) % 1.3, np.exp(-(a**2)) / np.log(np.abs(c) + 2.0),
                np.where((a > b) & ~(c < 0.0), np.hypot(a, b), np.cos(c)))  # fmt: skip

    bits = interpreted(function, 3, 4)(NUMBERS)[0].view(np.int64)
    for lanes in (1, 2, 4, 8):
        assert np.array_equal(compiled(function, 3, 4, lanes)(NUMBERS)[0].view(np.int64), bits)


# --- expressions at random

_UNARY = st.sampled_from(
    [
        f"{name}({{}})"
        for name in [
            "sin",
            "cos",
            "tan",
            "arctan",
            "exp",
            "log",
            "sqrt",
            "abs",
            "sign",
            "floor",
            "rint",
            "square",
            "negative",
        ]
    ]
    + ["clip({}, -1.5, 2.0)", "({})**3", "({})**0.5", "({})**-2", "({})**2.5"]
)
_BINARY = st.sampled_from(
    [f"({{}} {operator} {{}})" for operator in "+-*/"]
    + [f"{name}({{}}, {{}})" for name in ["minimum", "maximum", "arctan2", "hypot", "remainder"]]
    + [
        "where(({0} > {1}) & ~({1} <= 0.5), {0}, {1} - 1.0)",
        "where(({0} < 0.0) | ({0} == {1}), {1}, {0})",
        "(({} > {}) * 2.0)",
    ]
)
_LEAVES = st.sampled_from(
    ["x[0]", "x[1]", "x[2]", *(f"float64({value})" for value in ("0.0", "-0.0", "1.0", "-1.0", "0.3"))]
)


def _grown(children):
    unary = st.builds(lambda form, a: form.format(a), _UNARY, children)
    return unary | st.builds(lambda form, a, b: form.format(a, b), _BINARY, children, children)


_NAMES = {name: getattr(np, name) for name in dir(np)}


@given(st.recursive(_LEAVES, _grown, max_leaves=6))
def test_expressions_at_random_are_what_numpy_says(text):
    """But where rounding decides on which side of a step a number falls, or is magnified beyond these few digits."""
    code = eval(f"lambda x: ({text} + 0.0 * x[0],)", _NAMES)
    with np.errstate(all="ignore"):
        x = NUMBERS[:, :60]
        expected = np.asarray(code(x)[0], dtype=float)
        near = np.stack([np.asarray(code(x * (1.0 + k * 2.0**-48))[0], dtype=float) for k in (-3, -1, 1, 3)])
        slack = 1e-11 * (1.0 + np.abs(expected)) + 4.0 * np.abs(near - expected).max(axis=0)
    (found,), beyond = interpreted(code, 3)(x)
    unsure = np.isnan(near).any(axis=0) != np.isnan(expected)
    with np.errstate(invalid="ignore"):
        close = np.abs(found - expected) <= slack
    same = close | (found == expected) | (np.isnan(found) & np.isnan(expected))
    assert (same | beyond | unsure | ~np.isfinite(slack)).all(), text


# --- models as users write them

MARKS = np.array([[1.0, 4.0, -2.0], [0.5, -3.0, 2.0]])
A = np.array([[1.0, 0.1, 0.0], [0.0, 0.9, 0.2], [0.0, 0.0, 1.0]])


class Gain:
    """A model that is a method."""

    def __init__(self, gain):
        self.gain = gain

    def move(self, x):
        return tuple(self.gain * part for part in x)


def _in_place(x):
    a, b, c = x
    d = a - b
    d *= d
    d += c
    return d, np.sqrt(d * d + 1.0)


def _scaled_by(scale, x):
    return np.stack([scale * x[0], x[1] ** 2, np.hypot(x[0], x[2])])


MODELS = {
    "a product with a matrix": lambda x: tuple(A @ x),
    "a generator": lambda x: tuple(part * k for k, part in enumerate(x)),
    "a closure over arrays": lambda x: tuple(np.sqrt((MARKS[0] - x[0]) ** 2 + (MARKS[1] - x[1]) ** 2)),
    "a sum over an array": lambda x: ((MARKS[0] * x[0]).sum(), np.sum(MARKS * x[1]), np.mean(x)),
    "the smallest of an array": lambda x: (np.abs(MARKS[0] - x[0]).min(), np.max(MARKS[1] + x[1], axis=0)),
    "a method": Gain(0.3).move,
    "a partial": functools.partial(_scaled_by, 2.0),
    "in place": _in_place,
    "concatenate": lambda x: np.concatenate([x[:2] * 2.0, [x[2]]]),
    "an array of objects": lambda x: np.array([np.sin(x[0]), x[1] * x[2]]),
    "an empty array like it, filled": lambda x: [x[0] * 0.0 + 1.0, np.ones_like(x[0]) * x[1]],
    "an angle brought back": lambda x: ((x[0] + np.pi) % (2.0 * np.pi) - np.pi, np.mod(x[1], 0.7), x[2] // 0.5),
    "truths that are counted": lambda x: ((x[0] > 0.0) * 1.0 + (x[1] > 0.0), np.sum(MARKS[0] > x[0])),
    "a clip with names": lambda x: (np.clip(x[0], a_min=-1.0, a_max=1.0), x[1].clip(0.0, None)),
    "what is left of a turn": lambda x: (np.radians(x[0]), np.degrees(x[1]), np.arcsin(np.sin(x[2])), np.trunc(x[0])),
}


@pytest.mark.parametrize("name", MODELS)
def test_models_as_users_write_them_are_what_numpy_says(name):
    finite = NUMBERS[:, np.isfinite(NUMBERS).all(axis=0)]
    expected = [[np.asarray(part, dtype=float) for part in MODELS[name](x)] for x in finite.T]
    found, beyond = compiled(MODELS[name], 3, len(expected[0]))(finite)
    np.testing.assert_allclose(found[:, ~beyond], np.array(expected).T[:, ~beyond], rtol=1e-13, atol=1e-13)


def _branches(x):
    return (x[0] if x[0] > 0.0 else x[1],)


def _writes_through_a_mask(x):
    y = x[0] * 1.0
    y[y < 0.0] = 0.0
    return (y,)


def _fills(x):
    out = np.zeros(2)
    out[0] = x[0]
    return out


def _swallows(x):
    try:
        return (abs(x[0]) if x[0] > 0.0 else x[1],)
    except Exception:
        return (x[2],)


REFUSED = {
    "branches": (_branches, r"^_branches \(tests/laws/test_traced\.py:\d+\): it branches on a value: take np\.where$"),
    "swallows": (_swallows, r"_swallows \(tests/laws/test_traced\.py:\d+\): it branches on a value"),
    "mask": (
        _writes_through_a_mask,
        r"^_writes_through_a_mask \(tests/laws/test_traced\.py:\d+\): TypeError|plain number$",
    ),
    "fills": (_fills, r"^_fills \(tests/laws/test_traced\.py:\d+\): it turns a component into a plain number$"),
    "adds truths": (lambda x: ((x[0] > 0.0) + (x[1] > 0.0),), "adds or subtracts truths"),
    "math": (lambda x: (math.sin(x[0]),), "it turns a component into a plain number"),
    "sorts": (lambda x: tuple(np.sort(x)), "np.sort is not known|branches on a value"),
    "draws": (lambda x: (x[0] + np.random.default_rng().normal(),), "answers otherwise when it is asked again"),
    "too many": (lambda x: (x[0], x[1]), "answers with 2 components where 1 belong"),
    "unknown": (lambda x: (np.sinc(x[0]),), "np.sinc is not known to the tracer|takes|not known"),
    "gamma": (lambda x: (np.heaviside(x[0], 0.5),), "np.heaviside is not known to the tracer"),
    "power": (lambda x: (x[0] ** x[1],), "raises to a power that is no constant"),
    "casts": (lambda x: (x[0].astype(int),), "a component has no astype"),
    "breaks": (lambda x: (x[0] / None,), "computes with a NoneType"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_traced_is_refused_in_one_line_that_names_it(name):
    function, line = REFUSED[name]
    with pytest.raises(UntraceableError, match=line) as refusal:
        traced(function, 3)
    assert "\n" not in str(refusal.value)


def test_a_model_that_changes_what_it_is_given_changes_its_own_alone():
    tracer = Tracer()
    x = tracer.leaves("x", 2)

    def greedy(x):
        first, second = x
        first += 1.0
        return first, second

    answer = tracer.call(greedy, x, shape=(2,))
    assert tracer.graph.nodes[x[0].number] == ("leaf", "x", 0)
    assert tracer.graph.nodes[answer[0].number][0] == "add"
