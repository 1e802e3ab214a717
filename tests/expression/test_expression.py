"""Expressions: parsed, printed, evaluated, differentiated and integrated; and each function that they may call."""

import math

import heyoka
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from linkwise.errors import LawError
from linkwise.expression import (
    FUNCTIONS,
    Call,
    Expression,
    Number,
    Program,
    Symbol,
    add,
    antiderivative,
    differentiate,
    kink_and_branch,
    kinks,
    multiply,
    parse,
    polynomial,
    substitute,
    symbols,
    to_text,
    walk,
)
from linkwise.expression.tree import writable_functions

NAMES = ("d", "v", "k", "g")
D, V, K = Symbol("d"), Symbol("v"), Symbol("k")
POINTS = {"d": 0.73, "v": -1.31, "k": 1.7, "g": 0.42}
STEP = 1e-200  # of the complex step: its square is below the smallest double, so the derivative is exact to rounding


def _by_real_part(choose: object) -> object:
    return lambda *zs: choose(zs, key=lambda z: complex(z).real)  # type: ignore[operator]


PYTHON = {  # the same functions for complex arguments next to the real axis
    "abs": lambda z: z if complex(z).real >= 0 else -z,
    "sign": lambda z: np.sign(complex(z).real),
    "max": _by_real_part(max),
    "min": _by_real_part(min),
    **{name: getattr(np, name) for name in ("sqrt", "exp", "tanh", "sin", "cos")},
}


def evaluate(text: str, point: dict[str, complex]) -> complex:
    """The text's value by Python itself: a way that shares nothing with ours."""
    return complex(eval(text, {"__builtins__": {}}, {**PYTHON, **point}))


def texts() -> st.SearchStrategy[str]:
    exponents = st.sampled_from(["2", "3", "-1", "-2", "0.5", "1.5", "k"])
    functions = st.sampled_from(
        [name for name in writable_functions() if len(FUNCTIONS[name].derivatives) == 1]
    )
    leaves = st.sampled_from(NAMES) | st.sampled_from(["0", "1", "2", "0.5", "3", "1.25", ".1", "2e-1"])

    def longer(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
        return st.one_of(
            st.tuples(inner, st.sampled_from([" + ", " - ", "*", "/", "-"]), inner).map("".join),
            st.tuples(inner, st.sampled_from(["+", "-", "*", "/"]), inner).map(lambda t: f"({''.join(t)})"),
            st.tuples(inner, exponents).map(lambda t: f"({t[0]})**{t[1]}"),
            inner.map(lambda t: f"-{t}"),
            st.tuples(functions, inner).map(lambda t: f"{t[0]}({t[1]})"),
            st.tuples(st.sampled_from(["max", "min"]), inner, inner).map(lambda t: f"{t[0]}({t[1]}, {t[2]})"),
        )

    return st.recursive(leaves, longer, max_leaves=8)


def value(expression: Expression, point: dict[str, float] = POINTS) -> float:
    return float(Program([expression], tuple(point))(*point.values())[0])


def worst_intermediate(expression: Expression) -> float:
    """The size of the largest value met on the way, and of its inverse: the condition of the evaluation, roughly."""
    sizes = [abs(value(node)) for node in walk(expression)]
    if not all(map(math.isfinite, sizes)):
        return math.inf
    return max(max(sizes), *(1 / size if size else 1.0 for size in sizes))


@pytest.mark.slow
@settings(derandomize=True, deadline=None, max_examples=200)
@given(texts())
def test_value_and_partials_agree_with_pythons_own_by_complex_step(text: str) -> None:
    expression = parse(text)
    slopes = {name: differentiate(expression, name) for name in NAMES}
    assume(all(worst_intermediate(coefficient) < 1e4 for coefficient in (expression, *slopes.values())))
    assume(all(abs(value(kink)) > 1e-6 for kink in kinks(expression)))
    with np.errstate(all="ignore"):
        try:
            expected = evaluate(text, dict(POINTS))
            by = {n: evaluate(text, {**POINTS, n: POINTS[n] + STEP * 1j}).imag / STEP for n in NAMES}
        except ArithmeticError:
            assume(False)
    assume(expected.imag == 0.0 and math.isfinite(expected.real))
    # the same operations in another order, up to 1e4 between, where 1e-16 of it is 1e-12; 1e-9 leaves room for powers
    assert value(expression) == pytest.approx(expected.real, rel=1e-9, abs=1e-9)
    for name, slope in slopes.items():
        assert value(slope) == pytest.approx(by[name], rel=1e-8, abs=1e-8)


@pytest.mark.slow
@settings(derandomize=True, deadline=None, max_examples=200)
@given(texts())
def test_text_round_trip(text: str) -> None:
    expression = parse(text)
    assert parse(to_text(expression)) == expression
    for name in ("d", "k"):
        slope = differentiate(expression, name)
        if not any(isinstance(node, Call) and node.function == "log" for node in walk(slope)):
            assert parse(to_text(slope)) == slope


@settings(derandomize=True, deadline=None, max_examples=200)
@given(st.text(alphabet="dvk01.e+-*/(),^ _=xsinmax\nα²'", max_size=24))
def test_any_text_is_an_expression_or_a_law_error(text: str) -> None:
    try:
        expression = parse(text, ("d", "v"))
    except LawError as error:
        assert error.reason and error.advice
        assert error.position is None or 0 <= error.position <= len(text)
    else:
        assert parse(to_text(expression)) == expression


@pytest.mark.parametrize(
    ("text", "canonical"),
    [
        ("d*d*k*2*3", "6*d**2*k"),
        ("d + d - 2*d", "0"),
        ("-(k - g)/2 + d - (d - g)", "-0.5*k + 1.5*g"),
        ("k/d/d", "k/d**2"),
        ("1/(k*d)**2", "1/(k*d)**2"),
        ("d/d", "d/d"),
        ("0*v + d**1 + v**0", "d + 1"),
        ("-d**2", "-d**2"),
        ("(-d)**2", "(-d)**2"),
        ("2**-1*d", "0.5*d"),
        ("max(d, v, k)", "max(max(d, v), k)"),
        ("max(d, d)*min(1, 2)", "d"),
        ("sqrt(4)*tanh(0) + abs(-3)", "3"),
        ("cos(2*pi*d)", "cos(6.283185307179586*d)"),
        ("1/0", "1/0"),
        ("(-1)**0.5 + exp(1e3)", "(-1)**0.5 + exp(1000)"),
        ("1e200*1e200*d", "1e+200*1e+200*d"),
        ("d**k**v", "d**(k**v)"),
        ("1*k*d/k", "k*d/k"),
    ],
)
def test_canonical_form(text: str, canonical: str) -> None:
    assert to_text(parse(text)) == canonical
    assert parse(canonical) == parse(text)


@pytest.mark.parametrize(
    ("text", "place", "reason", "advice"),
    [
        ("", None, "The expression is empty.", 'Write one, for instance "k*d + c*v".'),
        ("k*d + foo(v)", "foo", "'foo' is not a function.", "The functions are abs, sign, sqrt,"),
        ("Sin(d)", "Sin", "'Sin' is not a function.", "Did you mean sin?"),
        ("d(v)", "d(", "'d' is not a function.", "d is a variable: for a product write d*(...)."),
        ("k d", "d", "An operator is missing between 'k' and 'd'.", "A product is written with a star: k*d."),
        ("2d", "d", "An operator is missing between '2' and 'd'.", "2*d."),
        ("2(d)", "(d", "An operator is missing between '2' and '('.", "star"),
        ("k*d +", "+", "Something is missing after '+'.", "Add its operand."),
        ("max(*d, v)", "*d", "Something is missing between '(' and '*'.", "Add"),
        ("max(d,)", ",", "Something is missing after ','.", "Add"),
        ("(k*(d)", "(k", "This parenthesis is never closed.", "Add the missing ')'."),
        ("d^3", "^", "Unexpected character '^'.", "A power is written with two stars: d**3."),
        ("d.real", ".", "Unexpected character '.'.", "Names have no attributes"),
        ("d > 0", ">", "Unexpected character '>'.", "use max, min or sign"),
        ("d//2", "//", "'//' is not a supported operator.", "A quotient is written with one slash"),
        ("__import__('os')", "__import__", "'__import__' is not a valid name.", "Names begin with a letter"),
        ("(lambda: 0)()", "lambda", "'lambda' is a reserved word.", "Choose another name, such as lambda_."),
        ("k if d else v", "if", "An operator is missing between 'k' and 'if'.", "star"),
        ("sin*d", "sin", "'sin' is a function, not a name.", "Write sin(...), or rename the coefficient."),
        ("max(d)", "max", "'max' takes two or more arguments, not 1.", "Check commas and parentheses."),
        ("d, v", ",", "A comma may only separate the arguments of a function.", "Write one expression."),
        ("d + 1e999", "1e999", "This number is too large for double precision.", "The largest is 1.8e308."),
        ("d + 1" + "0" * 400, "1", "This number is too large for double precision.", "The largest is 1.8e308."),
        ("007*d", "007", "Invalid syntax: leading zeros", "An expression has names"),
        ("é*k2*d + foo(d)", "foo", "'foo' is not a function.", "The functions"),
        ("é*k2*d + max(é)", "max", "'max' takes two", "Check"),
    ],
)  # fmt: skip
def test_errors_say_what_where_and_what_to_do(text: str, place: str | None, reason: str, advice: str) -> None:
    with pytest.raises(LawError) as caught:
        parse(text, ("d", "v"))
    error = caught.value
    assert error.reason.startswith(reason) and advice in error.advice
    assert error.text == text
    if place is None:
        assert error.position is None
    else:
        assert error.position is not None and text[error.position :].startswith(place)


@pytest.mark.parametrize(
    "text",
    ["(" * 51 + "d" + ")" * 51, "sin(" * 51 + "d" + ")" * 51, "-" * 51 + "d", "d" + "**d" * 51, "(" * 1500],
)
def test_deep_nesting_is_refused(text: str) -> None:
    with pytest.raises(LawError, match=r"nested deeper than 50 levels"):
        parse(text)


@pytest.mark.parametrize(
    "text",
    [
        "(" * 50 + "d" + ")" * 50,
        "sin(" * 50 + "d" + ")" * 50,
        "(1 + 2*" * 50 + "d" + ")" * 50,
        "d" + "**d" * 50,
    ],
)
def test_nesting_up_to_the_limit_is_read_and_used(text: str) -> None:
    expression = parse(text)
    assert parse(to_text(substitute(expression, {"d": V}))) == parse(text.replace("d", "v"))
    assert math.isfinite(value(differentiate(expression, "d")))


def test_long_is_not_deep_but_too_long_a_text_and_what_is_none_are_refused() -> None:
    assert parse("+".join(["d"] * 999)) == multiply(Number(999.0), D)
    terms = "*d - ".join(f"k{index}" for index in range(200))
    assert len(symbols(parse(terms))) == 201
    with pytest.raises(LawError, match=r"has 2001 characters; at most 2000 are supported") as caught:
        parse("d" * 2001)
    assert caught.value.advice.startswith("Split it into several links")
    with pytest.raises(LawError, match=r"must be a string\.\n  3\.0\nWrite it in quotes"):
        parse(3.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "at", "slope"),
    [
        ("sign(d)", 0.0, 0.0),
        ("abs(d)", 0.0, 0.0),
        ("abs(d)", -2.0, -1.0),
        ("max(d, 0)", 0.0, 0.5),
        ("min(3*d, d)", 0.0, 2.0),
        ("abs(d)**1.5", 0.0, 0.0),
        ("d**2.5", 0.0, 0.0),
    ],
)
def test_slope_at_a_kink_is_the_mean_of_both_sides(text: str, at: float, slope: float) -> None:
    assert value(differentiate(parse(text), "d"), {"d": at}) == slope


def test_slope_by_an_exponent_vanishes_with_the_base_and_has_none_below_it() -> None:
    by_p = differentiate(parse("d**p"), "p")
    assert value(by_p, {"d": 0.0, "p": 1.5}) == 0.0
    assert value(by_p, {"d": 2.0, "p": 1.5}) == pytest.approx(2.0**1.5 * math.log(2.0), rel=1e-12)
    assert math.isnan(value(by_p, {"d": -1.0, "p": 2.0}))


@pytest.mark.parametrize(
    ("text", "terms"),
    [
        ("k*d + g*d**3 + v", {(1, 0): "k", (3, 0): "g", (0, 1): "1"}),
        ("(d + g)**2*v - v*d**2", {(1, 1): "2*g", (0, 1): "g**2"}),
        ("(2*d*v)**3", {(3, 3): "8"}),
        ("d/k + sin(g)", {(1, 0): "1/k", (0, 0): "sin(g)"}),
        ("(d + v)*(d - v)", {(2, 0): "1", (0, 2): "-1"}),
        ("0", {}),
        ("sin(d)", None),
        ("k/d", None),
        ("d**k", None),
        ("v*sin(d)", None),
        ("((1 + d + v)**60 + 1)**60", None),
    ],
)
def test_polynomial(text: str, terms: dict[tuple[int, int], str] | None) -> None:
    exponents = polynomial(parse(text), ("d", "v"))
    expected = None if terms is None else {key: parse(term) for key, term in terms.items()}
    assert exponents == expected


@pytest.mark.parametrize(
    "text",
    [
        "k*d + g*d**3 - 2", "(d + g)**2*v", "sin(2*d + k)", "cos(g - d)*k", "exp(-d/g)", "k*tanh(d/g)", "sqrt(d + 1)",
        "abs(2*d - g)", "sign(d - g) + d", "1/(d + 2)", "(3*d + 2)**0.5", "abs(d)**k", "k*d*abs(d)", "d**2*sign(d)",
        "abs(d)**1.5*sign(d)", "abs(d)*abs(d)**2", "v**2*k",
    ],
)  # fmt: skip
def test_the_slope_of_the_antiderivative_is_the_expression(text: str) -> None:
    expression = parse(text)
    primitive = antiderivative(expression, "d")
    assert primitive is not None
    slope = differentiate(primitive, "d")
    for d in (-0.61, -0.3, 0.17, 0.45, 0.9):
        point = {**POINTS, "d": d}
        assert value(slope, point) == pytest.approx(value(expression, point), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    "text", ["sin(d**2)", "d*exp(d)", "max(d, 0)", "d**d", "sin(d)*cos(d)", "d/abs(d)**3"]
)
def test_no_antiderivative_is_said(text: str) -> None:
    assert antiderivative(parse(text), "d") is None


def test_tanh_integral_neither_overflows_nor_cancels() -> None:
    primitive = antiderivative(parse("tanh(d)"), "d")
    assert primitive is not None
    rise = add(primitive, multiply(Number(-1.0), substitute(primitive, {"d": Number(0.0)})))
    assert value(rise, {"d": -800.0}) == pytest.approx(800.0 - math.log(2.0), rel=1e-12)
    assert value(rise, {"d": 0.5}) == pytest.approx(math.log(math.cosh(0.5)), rel=1e-12)


def test_kinks_inner_ones_first_and_once() -> None:
    expression = parse("k*max(abs(d) - g, 0)*sign(d) + min(v, k) + sin(abs(d))")
    assert kinks(expression) == (D, parse("abs(d) - g"), parse("v - k"))
    assert kinks(parse("k*d + tanh(v)")) == ()


def test_program_broadcasts_and_protects() -> None:
    d, k = np.arange(6.0).reshape(3, 2), np.array([1.0, 2.0])
    outputs = Program([parse("k*d"), D, K, Number(2.5)], ("d", "k"))(d, k)
    assert [output.shape for output in outputs] == [(3, 2)] * 4
    assert not any(output.flags.writeable for output in outputs) and d.flags.writeable and k.flags.writeable
    np.testing.assert_array_equal(outputs[0], d * k)
    np.testing.assert_array_equal(outputs[3], np.full((3, 2), 2.5))
    first, second = Program([parse("-d"), parse("d**2")], ("d",))([1, 2])
    assert first.dtype == second.dtype == np.float64 and second.tolist() == [1.0, 4.0]
    # no warning, and no infinity is hidden
    result = Program([parse("1/d"), parse("sqrt(d)")], ("d",))(np.array([0.0, -1.0]))
    assert np.isinf(result[0][0]) and np.isnan(result[1][1])


X, Y = Symbol("x"), Symbol("y")
PLACES = {"x": np.array([0.3, 0.7, 1.9]), "y": np.array([0.5, 0.6, 2.5])}  # in every domain, at no kink
BELOW = {name: -values for name, values in PLACES.items()}  # on the other side of every kink


def _call(name: str) -> Call:
    return Call(name, (X, Y)[: len(FUNCTIONS[name].derivatives)])


def _values(expression: object, points: dict[str, np.ndarray], **more: np.ndarray) -> np.ndarray:
    inputs = {**points, **more}
    return Program([expression], tuple(inputs))(*inputs.values())[0]  # type: ignore[list-item]


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if FUNCTIONS[name].kink is not None])
@pytest.mark.parametrize("points", [PLACES, BELOW])
def test_branches_are_the_value_on_both_sides_of_the_kink(name: str, points: dict[str, np.ndarray]) -> None:
    kink, branch = kink_and_branch(name, _call(name).arguments)
    side = np.sign(_values(kink, points))
    assert set(np.abs(side)) == {1.0}
    np.testing.assert_array_equal(_values(branch, points, s=side), _values(_call(name), points))


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if FUNCTIONS[name].kink is None])
def test_the_integrator_has_the_same_function(name: str) -> None:
    argument = heyoka.expression("x")
    compiled = heyoka.cfunc([getattr(heyoka, name)(argument)], vars=[argument])
    # identity: two units in the last place of a double
    ours = _values(_call(name), {"x": PLACES["x"]})
    np.testing.assert_allclose(compiled(PLACES["x"][None, :])[0], ours, rtol=4e-16)


def test_logarithms_are_for_derivatives_only_and_a_smooth_function_has_no_kink() -> None:
    with pytest.raises(ValueError, match="sin is smooth"):
        kink_and_branch("sin", (X,))
    assert set(FUNCTIONS) - set(writable_functions()) == {"log"}
    with pytest.raises(LawError, match="'log' is not a function"):
        parse("log(x)")
