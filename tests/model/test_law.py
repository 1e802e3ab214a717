"""Laws: coefficients, units, force, partials, energy, and what a law refuses to be."""

import pickle

import numpy as np
import pytest
from scipy.integrate import quad

import linkwise as lw
from linkwise.expression import Number, Symbol, parse, to_text

BISTABLE = "alpha*d + beta*d**3 + c*v"
VALUES = {"alpha": -100.0, "beta": 1e6, "c": 0.02}
LAWS = {  # law: values
    BISTABLE: VALUES,
    "k*d*(1 + d/0.3) + c*v + c3*v*d**2": {"k": 2.0, "c": 0.3, "c3": 5.0},
    "k*max(abs(d) - gap, 0)*sign(d)": {"k": 2e3, "gap": 0.4},
    "k*min(d, 0.3) + c*v": {"k": 2.0, "c": 1.0},
    "F*tanh(v/s) + k*d": {"F": 3.0, "s": 0.2, "k": 2.0},
    "F*tanh(d/s)": {"F": 3.0, "s": 0.02},
    "k*abs(d)**p*sign(d)": {"k": 2.0, "p": 1.7},
    "k*abs(d)*d + q*v*abs(v)": {"k": 2.0, "q": 0.7},
    "F*(exp(d/g) - 1)": {"F": 0.1, "g": 0.5},
    "k*sqrt(d**2 + h**2)*d - T*sin(w*d) + T*cos(w*d)": {"k": 2.0, "h": 0.1, "T": 0.3, "w": 7.0},
    "k*d/(1 + d**2/g**2)": {"k": 2.0, "g": 0.5},
}


def points(*, seed: int = 1, count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.0, 1.0, count), rng.uniform(-1.0, 1.0, count)


def test_the_papers_law() -> None:
    law = lw.Law.parse(BISTABLE)
    assert law.coefficients == law.linear == ("alpha", "beta", "c") and law.nonlinear == ()
    assert law.units == {"alpha": "N/m", "beta": "N/m^3", "c": "N s/m"}
    columns = {name: to_text(column) for name, column in law.basis.items()}
    assert columns == {"alpha": "d", "beta": "d**3", "c": "v"}
    assert law.remainder == Number(0.0) and law.kinks == ()
    assert law.elastic == parse("alpha*d + beta*d**3")
    d, v = points()
    np.testing.assert_allclose(law.force(d, v, VALUES), -100 * d + 1e6 * d**3 + 0.02 * v, rtol=1e-12)
    assert law.potential(0.01, VALUES) == pytest.approx(-0.0025, rel=1e-12)  # the barrier alpha^2 / (4 beta)
    assert str(law) == BISTABLE and lw.Law.parse(BISTABLE) is law
    copy = pickle.loads(pickle.dumps(law))
    assert copy == law and copy.units == law.units
    of_motion = lw.Law.parse("k*max(abs(d) - g, 0) + c*abs(v) + abs(k)*d").kinks
    assert of_motion == (Symbol("d"), parse("abs(d) - g"), Symbol("v"))


@pytest.mark.parametrize(("text", "values"), LAWS.items(), ids=LAWS)
def test_partials_agree_with_central_differences(text: str, values: dict[str, float]) -> None:
    """Richardson-extrapolated central differences, error of order h^4, away from kinks by more than 2 h."""
    law, (d, v) = lw.Law.parse(text), points()
    smooth = np.all(
        [np.abs(kink_values(kink, d, v, values)) > 0.01 for kink in law.kinks] or [d < 2.0], axis=0
    )
    d, v = d[smooth], v[smooth]
    partials = law.partials(d, v, values)
    np.testing.assert_array_equal(partials.force, law.force(d, v, values))
    point = {"d": d, "v": v, **{name: np.full(d.shape, value) for name, value in values.items()}}
    exact = {"d": partials.by_d, "v": partials.by_v, **partials.by_coefficient}
    assert list(partials.by_coefficient) == list(law.coefficients)
    for name, slope in exact.items():
        h = 1e-4 * np.maximum(np.abs(point[name]), 0.1)

        def shifted(step: np.ndarray, name: str = name) -> np.ndarray:
            moved = {**point, name: point[name] + step}
            return law.force(moved.pop("d"), moved.pop("v"), moved)

        wide, narrow = (shifted(2 * h) - shifted(-2 * h)) / (4 * h), (shifted(h) - shifted(-h)) / (2 * h)
        expected = (4 * narrow - wide) / 3
        scale = np.abs(partials.force).max() / h.min()
        np.testing.assert_allclose(slope, expected, rtol=1e-6, atol=scale * 1e-14)


def kink_values(kink: object, d: np.ndarray, v: np.ndarray, values: dict[str, float]) -> np.ndarray:
    return np.asarray(lw.Law(to_text(kink), kink, tuple(values)).force(d, v, values))  # type: ignore[arg-type]


@pytest.mark.parametrize(("text", "values"), LAWS.items(), ids=LAWS)
def test_potential_is_the_integral_of_the_elastic_force(text: str, values: dict[str, float]) -> None:
    """Against SciPy's adaptive quadrature, told the kinks; its tolerance is 1e-12 of the energy."""
    law = lw.Law.parse(text)
    turns = {"k*max(abs(d) - gap, 0)*sign(d)": (-0.4, 0.4), "k*min(d, 0.3) + c*v": (0.3,)}.get(text, ())
    for end in (-0.9, -0.2, 0.3, 0.8):
        inside = [turn for turn in turns if min(end, 0) < turn < max(end, 0)]
        options = {"points": inside or None, "epsabs": 1e-13, "limit": 200}
        expected = quad(lambda s: float(law.force(s, 0.0, values)), 0.0, end, **options)[0]
        assert law.potential(end, values) == pytest.approx(expected, rel=1e-10, abs=1e-12)
    assert law.potential(0.0, values) == 0.0
    d, v = points()  # basis and remainder make up the law
    pieces = {"_": law.remainder, **law.basis}
    forces = {name: lw.Law("", piece, law.coefficients).force(d, v, values) for name, piece in pieces.items()}
    total = forces["_"] + sum(values[name] * forces[name] for name in law.linear)
    np.testing.assert_allclose(total, law.force(d, v, values), rtol=1e-12, atol=1e-12 * np.abs(total).max())


@pytest.mark.parametrize(
    ("text", "linear", "nonlinear"),
    [
        ("k*(d - gap)", ("k",), ("gap",)),
        ("F*tanh(v/s)", ("F",), ("s",)),
        ("a*b*d + c*v", ("a", "c"), ("b",)),
        ("k*abs(d)**p*sign(d)", ("k",), ("p",)),
        ("max(k*d, 0)", (), ("k",)),
        ("F0 + k*d/m", ("F0", "k"), ("m",)),
    ],
)
def test_linear_coefficients(text: str, linear: tuple[str, ...], nonlinear: tuple[str, ...]) -> None:
    law = lw.Law.parse(text)
    assert (law.linear, law.nonlinear) == (linear, nonlinear)


@pytest.mark.parametrize(
    ("text", "units"),
    [
        ("k*max(abs(d) - g, 0)*sign(d)", {"k": "N/m", "g": "m"}),
        ("F*tanh(v/s)", {"F": "N", "s": "m/s"}),
        ("F*tanh(v/0.01) + k*d*tanh(2*v)", {"F": "N", "k": "N/m"}),
        ("F*sin(w*d + phi)", {"F": "N", "w": "1/m", "phi": ""}),
        ("k*d + d**3", {"k": "N/m"}),
        ("k*d*(1 + d/0.01)", {"k": "N/m"}),
        ("q*v*abs(v)", {"q": "N s^2/m^2"}),
        ("k*abs(d)**1.5*sign(d)", {"k": "N/m^(3/2)"}),
        ("k*sqrt(d**2 + l**2)*d/l", {"k": "N/m", "l": "m"}),
        ("F*(1 - exp(-a*abs(d))) + G*2**(d/g)", {"F": "N", "a": "1/m", "G": "N", "g": "m"}),
        ("a*b*d", {"a": "?", "b": "?"}),
        ("k*abs(d)**p", {"k": "?", "p": ""}),
        ("d + sin(d)", {}),
    ],
)
def test_units(text: str, units: dict[str, str]) -> None:
    assert lw.Law.parse(text).units == units


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "k*d + k*v",
            "No units of the coefficients are consistent: 'k*v' must be in the unit of 'k*d', but differs by 1/s.\n"
            "  k*d + k*v\n        ^\nGive each term a coefficient of its own.",
        ),
        (
            "k*d*tanh(k*d)",
            "No units of the coefficients are consistent: the force must be in N, but differs by 1/N.\n"
            "  k*d*tanh(k*d)\n  ^\nGive each term a coefficient of its own.",
        ),
        ("F*tanh(F*d)*d*exp(F)", "the argument of exp must have no unit, but differs by 1/m."),
        ("F*d**(F*v)*tanh(F)", "the argument of tanh must have no unit, but differs by s/m."),
    ],
)
def test_units_that_cannot_be(text: str, message: str) -> None:
    with pytest.raises(lw.LawError) as caught:
        _ = lw.Law.parse(text).units
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("text", "place", "message"),
    [
        ("k/d", "d", "Division by zero at rest (d = 0, v = 0), where a law must be finite."),
        ("k*d + c*d/v", "v", "Keep the divisor away from 0, as in d/(1 + abs(d)/s)."),
        ("k*d**-2", "d**", "Division by zero at rest"),
        ("k*sqrt(d - 1)", "sqrt", "No finite value at rest"),
        ("1.7e308 + 1.7e308*exp(d)", "1.7e308 +", "No finite value at rest"),
        ("k*x", "x", "write d for x."),
        ("k*d + sin(t)", "t)", "A law does not depend on time; a force that does is an excitation."),
        ("k*d + foo(v)", "foo", "'foo' is not a function."),
        ("k*d + __import__('os').system('ls')", "__import__", "'__import__' is not a valid name."),
    ],
)
def test_what_no_law_can_be(text: str, place: str, message: str) -> None:
    with pytest.raises(lw.LawError) as caught:
        lw.Law.parse(text)
    assert message in str(caught.value)
    assert caught.value.position is not None
    assert text[caught.value.position :].startswith(place)


def test_a_force_needs_the_values_of_all_coefficients_of_which_some_may_make_a_divisor_vanish() -> None:
    assert lw.Law.parse("k*d/(1 - nu)").force(1.0, 0.0, {"k": 1.0, "nu": 0.5}) == 2.0
    with pytest.raises(lw.LawError) as caught:
        lw.Law.parse(BISTABLE).force(0.1, 0.2, {"alpha": 1.0, "c": 2.0})
    assert str(caught.value) == (
        f"The coefficient 'beta' has no value.\n  {BISTABLE}\n            ^\nValues are given for: alpha, c."
    )
