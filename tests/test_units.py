"""Values with units, to SI."""

import numpy as np
import pytest

from linkwise.errors import LinkwiseError
from linkwise.expression.dimensions import KILOGRAM, METRE, NEWTON, NONE, SECOND
from linkwise.units import factor_to_si, to_si


@pytest.mark.parametrize(
    ("given", "dimension", "value"),
    [
        ("30 kN/m", "N/m", 30000.0),
        ("10 g", "kg", 0.01),
        ("5 mm", "m", 0.005),
        ("0.02 N*s/m", "N s/m", 0.02),
        ("2 N s²/m²", "N s^2/m^2", 2.0),
        ("1e6 N/m^3", "N/m^3", 1e6),
        ("-2 m/s2", "m/s^2", -2.0),
        ("1 g", "m/s^2", 9.80665),
        ("3 µm", "m", 3e-6),
        ("3Nm", "N m", 3.0),
        ("3 1/Nm", "1/(N m)", 3.0),
        ("2 rad/Ncm", "rad/(N m)", 200.0),
        ("60 rev/min", "rad/s", 2.0 * np.pi),
        ("5 %", "", 0.05),
        ("3 kN", "?", 3000.0),
        (3, "kg", 3.0),
        (np.float32(0.5), "kg", 0.5),
    ],
)
def test_to_si(given: object, dimension: str, value: float) -> None:
    """Identity: a conversion is one product, rounded once or twice."""
    assert to_si(given, dimension) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    ("given", "dimension", "message"),
    [
        ("30", "N/m", "'30' has no unit: add one, as in '30 N/m', or remove the quotes if it is in N/m already"),
        ("30 kg", "N/m", "'30 kg' is in kg: expected a number in N/m or a text with a unit such as '1 N/m'."),
        ("30 kg", "", "'30 kg' is in kg: expected a number."),
        ("10 KN/m", "N/m", "'10 KN/m' cannot be read as a quantity: expected a number in N/m or a text"),
        ("", "m", "'' cannot be read"),
        ("3 N/", "N", "'3 N/' cannot be read"),
        ("__import__('os')", "m", "cannot be read as a quantity"),
        ("1e999 m", "m", "'1e999 m' is not finite."),
        (float("nan"), "m", "nan is not finite."),
        (True, "m", "True is not a value: expected a number in m or"),
        (None, "m", "None is not a value: expected a number in m or"),
    ],
)  # fmt: skip
def test_to_si_refuses(given: object, dimension: str, message: str) -> None:
    with pytest.raises(LinkwiseError) as caught:
        to_si(given, dimension)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("unit", "dimension", "factor"),
    [
        ("mm", "m", 1e-3),
        ("μm", "m", 1e-6),
        ("ms", "s", 1e-3),
        ("m/s2", "m/s^2", 1.0),
        ("mm/s**2", "m/s^2", 1e-3),
        ("g", "m/s^2", 9.80665),
        ("mg", "m/s^2", 9.80665e-3),
        ("g_n", "m/s^2", 9.80665),
    ],
)
def test_factor_to_si(unit: str, dimension: str, factor: float) -> None:
    assert factor_to_si(unit, dimension) == pytest.approx(factor, rel=1e-15)


@pytest.mark.parametrize(
    ("unit", "message"),
    [
        ("V", "'V' is in V: expected a unit that converts to m."),
        ("3 mm", "'3 mm' is not a unit: expected a unit that converts to m."),
        ("", "'' cannot be read as a quantity: expected a unit that converts to m."),
        ("g", "'g' is in g: expected"),
    ],
)
def test_factor_to_si_refuses(unit: str, message: str) -> None:
    with pytest.raises(LinkwiseError) as caught:
        factor_to_si(unit, "m")
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("dimension", "text"),
    [
        (NONE, ""),
        (KILOGRAM, "kg"),
        (METRE, "m"),
        (NEWTON, "N"),
        (NEWTON / METRE**3, "N/m^3"),
        (NEWTON * SECOND / METRE, "N s/m"),
        (NEWTON * SECOND**2 / METRE**2, "N s^2/m^2"),
        (NEWTON / (METRE * SECOND), "N/(m s)"),
        (METRE**-1, "1/m"),
        (KILOGRAM / METRE, "N s^2/m^2"),
        (NEWTON ** (METRE.metre / 2), "N^(1/2)"),
    ],
)
def test_dimension_text_is_a_unit_of_that_dimension(dimension: object, text: str) -> None:
    """What laws print is what structure files may say."""
    assert str(dimension) == text
    assert to_si(f"1 {text}" if text else "1", text) == pytest.approx(1.0, rel=1e-15)
