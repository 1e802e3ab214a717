"""Where structures rest, the wells of their links, and the modes about a rest."""

import math
from itertools import product

import numpy as np
import pytest
from structures import link, structure

import linkwise as lw
from linkwise.analysis.linear_modes import modes, natural_frequencies
from linkwise.analysis.potential_wells import barrier, law_kind, rest_points, wells
from linkwise.analysis.rest_positions import Equilibria, equilibria
from linkwise.arrays import Floats
from linkwise.model.structure import BASE, GROUND


def free(*links: lw.Link) -> lw.Structure:
    names = sorted({end for bond in links for end in bond.between} - {GROUND, BASE})
    return structure(dict.fromkeys(names, 1.0), *links)


def bistable(name: str, between: str) -> lw.Link:
    return link(name, between, "alpha*d + beta*d**3", alpha=-100.0, beta=1e6)


def net_force(subject: lw.Structure, x: Floats) -> Floats:
    d = subject.elongations(x, 0.0)
    forces = np.array([float(bond.force(d[i])) for i, bond in enumerate(subject.links)])
    return np.asarray(subject.incidence @ forces)


def tangent_eigenvalues(subject: lw.Structure, x: Floats) -> Floats:
    d = subject.elongations(x, 0.0)
    incidence = subject.incidence.toarray()
    slopes = np.array([float(bond.stiffness(d[i])) for i, bond in enumerate(subject.links)])
    return np.linalg.eigvalsh(incidence * slopes @ incidence.T)


def positions(rests: Equilibria) -> set[tuple[float, ...]]:
    return {tuple(np.round(point.x, 9) + 0.0) for point in rests}


@pytest.mark.parametrize("n", [2, 4, 6])
def test_each_sink_of_the_chain_rests_in_either_well_or_on_top(n: int) -> None:
    rests = equilibria(lw.bnes_chain(n))
    choices = product((-0.01, 0.0, 0.01), repeat=n // 2)
    assert positions(rests) == {tuple(np.array([(0.0, d) for d in choice]).ravel()) for choice in choices}
    assert (len(rests.stable), rests.complete, rests.note) == (2 ** (n // 2), True, "")
    assert rests[0].energy == pytest.approx(-0.0025 * n / 2, rel=1e-12)
    assert [point.stable for point in rests] == sorted((point.stable for point in rests), reverse=True)


def test_ten_sinks_are_cut_at_the_limit_which_is_said_with_the_wells_first() -> None:
    rests = equilibria(lw.bnes_chain(20))
    assert (len(rests), len(rests.stable), rests.complete) == (4096, 1024, False)
    assert rests.note == "only 4096 of 59049 combinations of rest points were used, wells first"
    huge = equilibria(lw.bnes_chain(200), limit=3)
    assert (len(huge), len(huge.stable)) == (3, 3)
    assert "of 1e47 combinations" in huge.note


def test_links_side_by_side_act_as_one_whichever_way_they_point() -> None:
    """The bistable law in two halves, the second one turned round, and a constant force of its own."""
    halves = free(link("a", "m-ground", "a*d", a=-100.0), link("b", "ground-m", "b*d**3", b=1e6))
    assert positions(equilibria(halves)) == {(-0.01,), (0.0,), (0.01,)}
    loaded = free(link("k", "m-base", "k*d", k=50.0), link("f", "ground-m", "f0", f0=2.0))
    (only,) = equilibria(loaded)
    np.testing.assert_allclose(only.x, [0.04], rtol=1e-12)
    assert only.stable
    assert only.energy == pytest.approx(0.5 * 50.0 * 0.04**2 - 2.0 * 0.04, rel=1e-12)


def test_a_circle_of_linear_springs_under_a_constant_force() -> None:
    """Two masses, three springs, the right one pulled: K x = F by hand."""
    ring = free(
        link("s1", "a-ground", "k*d", k=100.0),
        link("s2", "b-a", "k*d", k=50.0),
        link("s3", "b-ground", "k*d + f0", k=20.0, f0=-3.0),
    )
    rests = equilibria(ring)
    assert len(rests) == 1
    by_hand = np.linalg.solve([[150.0, -50.0], [-50.0, 70.0]], [0.0, 3.0])
    np.testing.assert_allclose(rests[0].x, by_hand, rtol=1e-12)
    assert rests[0].stable and not rests.complete
    note = "the links form a cycle, so Newton's method searched from 1 combinations of rest points"
    assert rests.note == note


def test_two_sinks_joined_by_a_soft_spring_have_nine_equilibria_and_by_a_stiff_one_three() -> None:
    """Fold of the mixed states: for x1 = -x2, -100 x + 1e6 x**3 + 2 k x = 0 has a root besides 0 only for k < 50."""

    def joined(k: float) -> lw.Structure:
        return free(bistable("n1", "a-ground"), bistable("n2", "b-ground"), link("k", "b-a", "k*d", k=k))

    soft, stiff = equilibria(joined(5.0)), equilibria(joined(500.0))
    assert (len(soft), len(soft.stable)) == (9, 4)
    assert (len(stiff), len(stiff.stable)) == (3, 2)
    mixed = math.sqrt((100.0 - 2.0 * 5.0) / 1e6)
    assert (round(mixed, 9), round(-mixed, 9)) in positions(soft)
    for k, points in ((5.0, soft), (500.0, stiff)):
        for point in points:
            np.testing.assert_allclose(net_force(joined(k), point.x), 0.0, atol=1e-9)
            assert point.stable == bool(np.all(tangent_eigenvalues(joined(k), point.x) > 0.0))


def test_a_floating_structure_is_said_to_float() -> None:
    flying = free(bistable("n", "b-a"))
    rests = equilibria(flying)
    assert positions(rests) == {(-0.005, 0.005), (0.005, -0.005), (0.0, 0.0)}
    assert [point.neutral for point in rests] == [1, 1, 1]
    assert [point.stable for point in rests] == [True, True, False]
    assert rests.note == (
        "1 rigid-body motion without elastic resistance; displacements are those with the least sum of squares"
    )


def test_a_mass_on_a_damper_alone_is_free_to_rest_anywhere() -> None:
    balanced = free(link("s", "a-ground", "k*d", k=1.0), link("c", "b-a", "c*v", c=1.0))
    (only,) = equilibria(balanced)
    assert (only.stable, only.neutral) == (True, 1)
    dampers = free(link("c", "a-ground", "c*v", c=1.0))
    (anywhere,) = equilibria(dampers)
    assert (anywhere.stable, anywhere.neutral) == (True, 1)
    assert "1 rigid-body motion" in equilibria(dampers).note
    # a cubic spring is stable and neutral
    (only,) = equilibria(free(link("s", "a-ground", "k*d**3", k=1.0)))
    assert (only.stable, only.neutral) == (True, 1)


def test_starts_and_laws_that_cannot_be_are_refused() -> None:
    message = r"`start` must have 2 finite displacements in m, one for each mass"
    with pytest.raises(lw.StructureError, match=message):
        equilibria(lw.bnes_chain(2), start=[0.0, 0.0, 0.0])
    with pytest.raises(lw.StructureError, match=r"`start` must have 2 finite displacements"):
        equilibria(lw.bnes_chain(2), start=[0.0, math.nan])
    message = r'link "spring1": coefficient k is unknown and has no start value'
    with pytest.raises(lw.StructureError, match=message):
        equilibria(lw.bnes_chain(2).unknown("all"))
    pendulum = free(link("p", "a-ground", "F*sin(d/s)", F=1.0, s=0.1))
    with pytest.raises(lw.StructureError, match=r'link "p": .*give a range of d \(`reach`\)'):
        equilibria(pendulum)
    assert len(equilibria(pendulum, reach=(-0.5, 0.5))) == 3


def spring(text: str, **values: float) -> lw.Link:
    return link("s", "a-ground", text, **values)


def rests(bond: lw.Link, lo: float | None = None, hi: float | None = None) -> list[tuple[float, bool]]:
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
    with pytest.raises(lw.StructureError, match=message):
        wells(pendulum)
    np.testing.assert_allclose(wells(pendulum, -1.0, 1.0), [-0.2 * math.pi, 0.0, 0.2 * math.pi], rtol=1e-12)
    assert barrier(pendulum, -1.0, 1.0) == pytest.approx(0.2, rel=1e-12)


def test_an_empty_range_and_a_missing_value_are_refused() -> None:
    with pytest.raises(lw.StructureError, match=r'link "s": the range of d from 1.0 to 1.0 is empty'):
        wells(spring("k*d", k=1.0), 1.0, 1.0)
    message = r'link "nes1": coefficient alpha is unknown and has no start value'
    with pytest.raises(lw.StructureError, match=message):
        barrier(lw.bnes_chain(2).unknown("nes").link("nes1"))


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


SPRING = lw.Law.parse("k*d + c*v")


def row(k: list[float], c: list[float], masses: list[float], *, grounded: bool = True) -> lw.Structure:
    """Masses in a row on springs with dampers, the first one on the ground unless it flies."""
    ends = [f"m{i}-" + (f"m{i - 1}" if i else GROUND) for i in range(len(masses))][0 if grounded else 1 :]
    links = (link(f"s{i}", end, SPRING, k=k[i], c=c[i]) for i, end in enumerate(ends))
    return structure({f"m{i}": m for i, m in enumerate(masses)}, *links)


def test_one_mass() -> None:
    computed = modes(row([400.0], [2.0], [4.0]))
    np.testing.assert_allclose(computed.frequencies, [10.0 / (2.0 * math.pi)], rtol=1e-12)
    np.testing.assert_allclose(computed.damping, [2.0 / (2.0 * math.sqrt(400.0 * 4.0))], rtol=1e-12)
    np.testing.assert_allclose(computed.shapes, [[0.5]], rtol=1e-12)
    np.testing.assert_allclose(computed.eigenvalues[0].real, -0.25, rtol=1e-12)
    assert computed.note == ""
    # an overdamped mass has a ratio above one
    np.testing.assert_allclose(modes(row([1.0], [10.0], [1.0])).damping, [5.0], rtol=1e-12)


def test_equal_masses_in_a_row_have_the_textbook_frequencies() -> None:
    """Fixed-free row: omega_j = 2 sqrt(k/m) sin((2j - 1) pi / (2 (2n + 1)))."""
    n, k, m = 6, 900.0, 0.25
    j = np.arange(1, n + 1)
    omega = 2.0 * math.sqrt(k / m) * np.sin((2 * j - 1) * math.pi / (2 * (2 * n + 1)))
    stiffness_damping = 1e-4
    computed = modes(row([k] * n, [stiffness_damping * k] * n, [m] * n))
    np.testing.assert_allclose(computed.frequencies, omega / (2.0 * math.pi), rtol=1e-12)
    np.testing.assert_allclose(computed.damping, 0.5 * stiffness_damping * omega, rtol=1e-8)


def test_shapes_are_mass_normalised_and_diagonalise_the_stiffness() -> None:
    chain = lw.bnes_chain(6)
    rest = equilibria(chain)[0].x
    computed = modes(chain, rest)
    d = chain.elongations(rest)
    incidence = chain.incidence.toarray()
    stiffness = incidence * [float(link.stiffness(d[i])) for i, link in enumerate(chain.links)] @ incidence.T
    omega2 = (2.0 * np.pi * computed.frequencies) ** 2
    np.testing.assert_allclose(computed.shapes.T * chain.mass_values @ computed.shapes, np.eye(6), atol=1e-12)
    diagonal = computed.shapes.T @ stiffness @ computed.shapes
    np.testing.assert_allclose(diagonal, np.diag(omega2), atol=1e-12 * omega2.max())
    assert np.all(computed.shapes[np.abs(computed.shapes).argmax(axis=0), range(6)] > 0.0)
    assert np.all(np.diff(computed.frequencies) >= 0.0)


def test_damping_ratios_are_those_of_the_eigenvalues_of_the_state_matrix() -> None:
    """Damping that couples the modes: ratios from an independent eigenvalue problem in physical coordinates."""
    k, c, m = [900.0, 400.0, 200.0], [0.3, 4.0, 0.1], [1.0, 2.0, 0.5]
    computed = modes(row(k, c, m))
    b = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0], [0.0, 0.0, 1.0]])
    state = np.block([[np.zeros((3, 3)), np.eye(3)], [-(b * k @ b.T) / np.c_[m], -(b * c @ b.T) / np.c_[m]]])
    upper = np.array([value for value in np.linalg.eigvals(state) if value.imag > 0.0])
    upper = upper[np.argsort(np.abs(upper))]
    np.testing.assert_allclose(computed.damping, -upper.real / np.abs(upper), rtol=1e-8)
    np.testing.assert_allclose(np.abs(computed.eigenvalues[::2]), np.abs(upper), rtol=1e-8)


def test_rigid_and_unstable_motions_are_said() -> None:
    flying = modes(row([50.0], [1.0], [1.0, 1.0], grounded=False))
    np.testing.assert_allclose(flying.frequencies, [0.0, 10.0 / (2.0 * math.pi)], rtol=1e-12)
    assert np.isnan(flying.damping[0])
    np.testing.assert_allclose(flying.damping[1], 0.1, rtol=1e-12)
    assert flying.note == "1 of 2 modes at 0 Hz, without elastic resistance"
    top = modes(lw.bnes_chain(2), [0.0, 0.0])
    assert np.isnan(top.frequencies[0])
    assert np.isnan(top.damping[0])
    assert top.frequencies[1] > 0.0
    assert top.note == "1 of 2 modes of negative stiffness, unstable and without a frequency"
    assert top.eigenvalues.real.max() > 0.0


@pytest.mark.parametrize("masses", [2, 6])
def test_modes_are_those_of_the_deepest_equilibrium_unless_a_place_is_given(masses: int) -> None:
    """At d = 0.02 the sink is pulled back by -100*0.02 + 1e6*0.02**3 = 6 N."""
    chain = lw.bnes_chain(masses)
    np.testing.assert_array_equal(modes(chain).at, equilibria(chain)[0].x)
    np.testing.assert_array_equal(natural_frequencies(chain), modes(chain).frequencies)
    note = 'this is not an equilibrium: the links exert 6 N on mass "m1"'
    assert modes(lw.bnes_chain(2), [0.0, 0.02]).note == note


def test_what_cannot_be_is_refused() -> None:
    message = r"`at` must have 2 finite displacements in m, one for each mass"
    with pytest.raises(lw.StructureError, match=message):
        modes(lw.bnes_chain(2), [0.0])
    falling = structure({"m": 1.0}, link("f", "m-ground", "f0", f0=1.0))
    message = r"no stable equilibrium was found: .*vanishes nowhere; give `at`"
    with pytest.raises(lw.StructureError, match=message):
        modes(falling)
