"""The terms that a link may have: read from text, named, with their units, and refused with the reason."""

import re

import pytest
from present import some

import linkwise as lw
from linkwise.discovery import parse_terms
from linkwise.discovery.terms import FAMILIES


def names(text: str) -> list[str]:
    return [term.coefficient for term in parse_terms(text)]


def test_the_default_is_the_cubic_family() -> None:
    assert parse_terms(lw.discovery.DiscoveryOptions().terms) == parse_terms("cubic")
    told = [(term.text, term.coefficient, term.unit, term.elastic) for term in parse_terms("cubic")]
    assert told == [
        ("v", "c", "N s/m", False),
        ("d", "k", "N/m", True),
        ("d**2", "k2", "N/m^2", True),
        ("d**3", "k3", "N/m^3", True),
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("bistable", ["v", "d", "d**3"]),
        ("quintic", ["v", "d", "d**2", "d**3", "d**4", "d**5"]),
        ("quadratic-damping", ["v*abs(v)"]),
        ("friction(0.01)", ["tanh(v/0.01)"]),
        ("contact(1e-3)", ["max(d - 1e-3, 0)", "min(d + 1e-3, 0)"]),
        ("linear, friction(0.01), d*abs(d)", ["v", "d", "tanh(v/0.01)", "d*abs(d)"]),
        (" cubic ,linear,, d ", ["v", "d", "d**2", "d**3"]),
        ("max(d - 0.1, 0), min(d, 0)", ["max(d - 0.1, 0)", "min(d, 0)"]),  # commas in brackets divide nothing
        ("d**3, d*d*d", ["d**3"]),  # the same function twice is one term
    ],
)
def test_families_and_terms_may_be_mixed(text: str, expected: list[str]) -> None:
    assert [term.text for term in parse_terms(text)] == expected


@pytest.mark.parametrize(
    "family", [name + ("(0.01)" if one.argument else "") for name, one in FAMILIES.items()]
)
def test_every_term_of_a_family_is_a_law_that_vanishes_at_rest(family: str) -> None:
    for term in some(parse_terms(family)):
        law = lw.Law.parse(term.product)
        assert law.coefficients == (term.coefficient,)
        assert law.units[term.coefficient] == term.unit != "?"
        assert float(law.force(0.0, 0.0, {term.coefficient: 1.0})) == 0.0


def test_names_that_two_terms_would_share_are_numbered() -> None:
    assert names("friction(0.1), d, friction(0.01)") == ["F_1", "k", "F_3"]
    assert len(set(names("v**2, quadratic-damping, contact(1e-3), gap(2e-3), d*sin(d), sin(d)"))) == 7
    assert names("contact(1e-3)") == ["kc", "kn"]
    assert parse_terms(["linear", "max(d - 0.1, 0)"]) == parse_terms("linear, max(d - 0.1, 0)")
    (gap,) = parse_terms("gap(0.5)")
    assert gap.product == "kc*(max(d - 0.5, 0) + min(d + 0.5, 0))"
    assert float(lw.Law.parse(gap.product).force(2.0, 0.0, {"kc": 3.0})) == 4.5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", 'the list of terms is empty; write a list such as "v, d, d**2, d**3"'),
        ("friction()", "the family friction takes the rate in m/s at which it saturates, a positive number in brackets, as in "
         "friction(0.01); got 'friction()'"),
        ("friction(-1)", "takes the rate in m/s at which it saturates, a positive number in brackets, as in friction(0.01); "
         "got 'friction(-1)'"),
        ("contact(nan)", "the family contact takes the elongation in m, of either sign, at which it closes, a positive "
         "number in brackets"),
        ("gap(0.1", "the family gap takes the elongation in m at which either side closes, a positive number in brackets"),
        ("cubic(2)", "the family cubic takes no argument; got 'cubic(2)'"),
        ("k*d", "the term 'k*d' contains the name 'k': a term is a function of d and v alone, its coefficient is added; write "
         "a number"),
        ("qubic", "the term 'qubic' contains the name 'qubic'"),
        ("qubic", "or one of the families linear, cubic, bistable, quintic, quadratic-damping, friction, stribeck, contact, "
         "gap"),
        ("linear, d**0.5", "the term 'd**0.5' is not a number for some negative d or v, and links move both ways; write it "
         "with abs and sign, as in sign(d)*sqrt(abs(d))"),
        ("d, 2*d", "the term '2*d' is a linear combination of "),
        ("cubic, d + d**3", "the term 'd + d**3' is a linear combination of "),
        ("max(d, 0), min(d, 0), d", "the term 'd' is a linear combination of "),
        ("d, tanh(v/k)", "the name 'k' in the term 'tanh(v/k)' is that of a coefficient"),
        ("tanh(v/s), tanh(d/s)", "choose another, as in 'tanh(d/s_2)'"),
        ("3.0", "the term '3.0' depends neither on d nor on v; write 1 for a constant force on the masses"),
    ],
)  # fmt: skip
def test_what_is_no_term_is_refused_with_the_reason(text: str, message: str) -> None:
    with pytest.raises(lw.IdentificationError, match=re.escape(message)):
        parse_terms(text)


@pytest.mark.parametrize(
    ("text", "message"), [("d**", "Something is missing after"), ("d/v", "Division by zero at rest")]
)
def test_what_no_law_can_be_is_refused_at_its_place(text: str, message: str) -> None:
    with pytest.raises(lw.LawError, match=message) as error:
        parse_terms(f"linear, {text}")
    assert f"  {text}\n" in str(error.value)


def test_terms_that_are_nearly_alike_are_taken() -> None:
    assert len(parse_terms("d, sin(d), tanh(d), friction(1), friction(1.001), v")) == 6
    assert len(parse_terms("linear, sign(d)*sqrt(abs(d)), exp(d) - 1, exp(900*d) - 1")) == 5


def test_families_without_a_number_have_a_parameter() -> None:
    terms = parse_terms("friction, stribeck, contact, gap")
    assert [term.parameters for term in terms] == [("v_f",), ("v_s",), ("d_c",), ("d_t",), ("d_g",)]
    assert [unit for term in terms for unit in term.parameter_units.values()] == ["m/s"] * 2 + ["m"] * 3


def test_numbers_take_the_place_of_parameters() -> None:
    [term] = parse_terms("exp(-(v/v_s)**2)*tanh(v/v_0)")
    assert term.at({"v_s": 0.5, "v_0": 2e-3}).text == "exp(-(v/0.5)**2)*tanh(v/0.002)"
    [power] = parse_terms("abs(d)**n*sign(d)")
    assert power.at({"n": 1.5}).law.force(-4.0, 0.0, {}) == pytest.approx(-8.0)
    [shifted] = parse_terms("max(d - d_0, 0)")
    assert shifted.at({"d_0": -1.5}).law.force(1.0, 0.0, {}) == 2.5
