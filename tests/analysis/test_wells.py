"""Wells, barriers and kinds of laws."""

import math

import numpy as np
import pytest
from structures import link

import linkwise as lw
from linkwise.analysis.potential_wells import barrier, law_kind, rest_points, wells
from linkwise.errors import StructureError
from linkwise.model.chains import bnes_chain
from linkwise.model.structure import Link


def spring(text: str, **values: float) -> Link:
    return link("s", "a-ground", text, **values)


def rests(bond: Link, lo: float | None = None, hi: float | None = None) -> list[tuple[float, bool]]:
    return [(point.d, point.well) for point in rest_points(bond.force, bond.stiffness, lo, hi)]


@pytest.mark.parametrize(("alpha", "beta"), [(-100.0, 1e6), (-3e-4, 2e9), (-5e5, 1e-2)])
def test_bistable_law_has_the_closed_form_of_methods_7(alpha: float, beta: float) -> None:
    """Identity, whatever the scale: wells from 1e-7 to 1e4 m."""
    sink = spring("alpha*d + beta*d**3 + c*v", alpha=alpha, beta=beta, c=0.02)
    well = math.sqrt(-alpha / beta)
    np.testing.assert_allclose(wells(sink), [-well, well], rtol=1e-12)
    assert barrier(sink) == pytest.approx(alpha**2 / (4.0 * beta), rel=1e-12)
    (low, top, high) = rest_points(sink.force, sink.stiffness)
    assert (top.d, top.well) == (0.0, False)
    slopes = [low.stiffness, top.stiffness, high.stiffness]
    np.testing.assert_allclose(slopes, [-2 * alpha, alpha, -2 * alpha], rtol=1e-12)


def test_a_spring_has_one_well_and_no_barrier_and_dampers_and_constant_forces_no_rest() -> None:
    assert wells(spring("k*d", k=3.0)) == (0.0,)
    assert barrier(spring("k*d", k=3.0)) is None
    assert wells(spring("k*d**3", k=3.0)) == (0.0,)
    assert wells(spring("f0 + k*d", f0=6.0, k=-3.0)) == (), "a negative spring rests on a top"
    assert rests(spring("c*v", c=1.0)) == rests(spring("f0", f0=1.0)) == []
    np.testing.assert_allclose(wells(spring("f0 + k*d", f0=6.0, k=3.0)), [-2.0], rtol=1e-12)


def test_unequal_wells_are_left_from_the_deepest_one() -> None:
    """f = (d + 3)(d - 1)(d - 2), so that U = d**4/4 - 7 d**2/2 + 6 d; the deeper well is at -3."""
    uneven = spring("a*(d + 3)*(d - 1)*(d - 2)", a=1.0)
    energy = [d**4 / 4 - 7 * d**2 / 2 + 6 * d for d in (-3.0, 1.0)]
    np.testing.assert_allclose(wells(uneven), [-3.0, 2.0], rtol=1e-12)
    assert barrier(uneven) == pytest.approx(energy[1] - energy[0], rel=1e-12)
    # a well and a top between two neighbouring points of the search: the zero of the slope gives them away
    near = spring("a*d*(d - 1)*(d - 1.001)", a=1.0)
    np.testing.assert_allclose(wells(near), [0.0, 1.001], rtol=1e-12)


def test_clearance_jump_and_pole() -> None:
    """A gap rests at its middle; a friction-like jump through zero is a well; a pole is no zero."""
    gap = spring("k*(max(d - g, 0) + min(d + g, 0))", k=5.0, g=0.1)
    assert rests(gap) == [(0.0, True)]
    jump = spring("k*d + F*sign(d - g)", k=1.0, F=4.0, g=0.5)
    np.testing.assert_allclose(wells(jump), [0.5], rtol=1e-12)
    pole = spring("k/(1 + d)", k=1.0)
    assert rests(pole) == []


def test_a_periodic_law_asks_for_a_range() -> None:
    pendulum = spring("F*sin(d/s)", F=1.0, s=0.1)
    message = r'link "s": the force vanishes at more than 64 elongations; give a range of d'
    with pytest.raises(StructureError, match=message):
        wells(pendulum)
    np.testing.assert_allclose(wells(pendulum, -1.0, 1.0), [-0.2 * math.pi, 0.0, 0.2 * math.pi], rtol=1e-12)
    assert barrier(pendulum, -1.0, 1.0) == pytest.approx(0.2, rel=1e-12)


def test_an_empty_range_and_a_missing_value_are_refused() -> None:
    with pytest.raises(StructureError, match=r'link "s": the range of d from 1.0 to 1.0 is empty'):
        wells(spring("k*d", k=1.0), 1.0, 1.0)
    message = r'link "nes1": coefficient alpha is unknown and has no start value'
    with pytest.raises(StructureError, match=message):
        barrier(bnes_chain(2).unknown("nes").link("nes1"))


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
