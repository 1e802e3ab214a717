"""The table of functions of laws: every rule of an entry against the entry's value."""

import heyoka
import numpy as np
import pytest

from linkwise.errors import LawError
from linkwise.expression import (
    FUNCTIONS,
    Call,
    Program,
    Symbol,
    antiderivative,
    differentiate,
    kink_and_branch,
    parse,
)
from linkwise.expression.tree import writable_functions

X, Y = Symbol("x"), Symbol("y")
POINTS = {"x": np.array([0.3, 0.7, 1.9]), "y": np.array([0.5, 0.6, 2.5])}  # in every domain, at no kink
BELOW = {name: -values for name, values in POINTS.items()}  # on the other side of every kink
STEP = 2.0**-17  # near the cube root of the rounding error: a central difference errs by its square, 6e-11


def _call(name: str) -> Call:
    return Call(name, (X, Y)[: len(FUNCTIONS[name].derivatives)])


def _values(expression: object, points: dict[str, np.ndarray], **more: np.ndarray) -> np.ndarray:
    inputs = {**points, **more}
    return Program([expression], tuple(inputs))(*inputs.values())[0]  # type: ignore[list-item]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_derivatives_are_those_of_the_value(name: str) -> None:
    for variable in ("x", "y")[: len(FUNCTIONS[name].derivatives)]:
        slope = _values(differentiate(_call(name), variable), POINTS)
        ends = [{**POINTS, variable: POINTS[variable] + sign * STEP} for sign in (1.0, -1.0)]
        above, below = (_values(_call(name), end) for end in ends)
        # the third derivatives are below 100 at these points, and 100/6 STEP**2 is 1e-9
        np.testing.assert_allclose(slope, (above - below) / (2.0 * STEP), atol=2e-9)


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if FUNCTIONS[name].antiderivative])
def test_antiderivatives_have_the_value_as_their_derivative(name: str) -> None:
    primitive = antiderivative(_call(name), "x")
    assert primitive is not None
    slope = _values(differentiate(primitive, "x"), POINTS)
    np.testing.assert_allclose(slope, _values(_call(name), POINTS), rtol=1e-13)


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if FUNCTIONS[name].degree is not None])
def test_degrees_say_how_the_value_scales(name: str) -> None:
    degree = FUNCTIONS[name].degree
    assert degree is not None
    scaled = _values(_call(name), {key: 4.0 * values for key, values in POINTS.items()})
    np.testing.assert_allclose(scaled, 4.0 ** float(degree) * _values(_call(name), POINTS), rtol=1e-14)


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if FUNCTIONS[name].degree is None])
def test_a_function_of_a_pure_number_scales_with_no_power(name: str) -> None:
    ratios = [_values(_call(name), {"x": 2.0 * POINTS["x"]}) / _values(_call(name), {"x": POINTS["x"]})]
    assert np.ptp(ratios) > 0.1  # that of x**p would be 0


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if FUNCTIONS[name].kink is not None])
@pytest.mark.parametrize("points", [POINTS, BELOW])
def test_branches_are_the_value_on_both_sides_of_the_kink(name: str, points: dict[str, np.ndarray]) -> None:
    kink, branch = kink_and_branch(name, _call(name).arguments)
    side = np.sign(_values(kink, points))
    assert set(np.abs(side)) == {1.0}
    np.testing.assert_array_equal(_values(branch, points, s=side), _values(_call(name), points))


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if FUNCTIONS[name].kink is None])
def test_the_integrator_has_the_same_function(name: str) -> None:
    argument = heyoka.expression("x")
    compiled = heyoka.cfunc([getattr(heyoka, FUNCTIONS[name].integrator or name)(argument)], vars=[argument])
    # identity: two units in the last place of a double
    ours = _values(_call(name), {"x": POINTS["x"]})
    np.testing.assert_allclose(compiled(POINTS["x"][None, :])[0], ours, rtol=4e-16)


def test_logarithms_are_for_derivatives_only_and_a_smooth_function_has_no_kink() -> None:
    with pytest.raises(ValueError, match="sin is smooth"):
        kink_and_branch("sin", (X,))
    assert set(FUNCTIONS) - set(writable_functions()) == {"log"}
    with pytest.raises(LawError, match="'log' is not a function"):
        parse("log(x)")
