"""Laws in a word."""

import pytest
from structures import link

import linkwise as lw
from linkwise.analysis.potential_wells import law_kind


@pytest.mark.parametrize(
    ("law", "reach", "kind"),
    [
        ("c*v", 1.0, "damper only"),
        ("k*d + c*v", 1.0, "linear"),
        ("k*d + 0*d**3", 1.0, "linear"),
        ("k*d + F*tanh(v/0.01)", 1.0, "linear"),
        ("k*d + k3*d**3", 1.0, "hardening"),
        ("k*d - k3*d**3", 0.5, "softening"),
        ("-k*d + 4*k3*d**3", 1.0, "bistable"),
        ("-k*d + 4*k3*d**3", 0.4, "negative stiffness"),  # its wells, at 0.5 m, were not seen
        ("-k*d", 1.0, "negative stiffness"),
        ("k*d - 10*k3*d**3 + 12*k5*d**5", 1.0, "3 wells"),
        ("k*d + k2*d**2", 0.5, "uneven"),
        ("k*max(d - 0.1, 0)", 1.0, "one-sided"),
        ("k*max(d - 0.1, 0) + k*min(d + 0.1, 0)", 1.0, "hardening"),
        ("0*d", 1.0, "damper only"),
        ("f0*1", 1.0, "constant force"),
        ("0*f0", 1.0, "damper only"),
        ("f0 + c*v", 1.0, "damper only"),
    ],
)
def test_kind_of_a_law(law: str, reach: float, kind: str) -> None:
    ones = dict.fromkeys(lw.Law.parse(law).coefficients, 1.0)
    assert law_kind(link("link", "m1-ground", law, **ones), reach) == kind


def test_a_term_with_coefficient_zero_does_not_bend_and_estimates_know_kinds(fitted: lw.Estimate) -> None:
    assert {link.link.name: link.kind for link in fitted.links} == {"spring1": "linear", "nes1": "bistable"}
    assert law_kind(link("link", "m1-ground", "k*d + q*d**2", k=30000.1, q=0.0), 0.0123) == "linear"


@pytest.mark.parametrize(("name", "kind"), [("bouc-wen", "linear with memory"), ("dahl", "memory")])
def test_a_law_with_memory_says_so(name: str, kind: str) -> None:
    law = lw.model.named_law(name)
    joint = law.link("joint", ("m1", "ground"), dict.fromkeys(law.coefficients, 0.5))
    assert law_kind(joint, 1.0) == kind
