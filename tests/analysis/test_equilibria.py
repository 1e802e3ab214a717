"""Equilibria and their stability, against closed forms, Newton's method against products, and eigenvalues."""

import math
from itertools import product

import numpy as np
import pytest
from structures import link, structure

from linkwise.analysis.rest_positions import Equilibria, equilibria
from linkwise.arrays import Floats
from linkwise.errors import StructureError
from linkwise.model.chains import bnes_chain
from linkwise.model.structure import BASE, GROUND, Link, Structure


def free(*links: Link) -> Structure:
    names = sorted({end for bond in links for end in bond.between} - {GROUND, BASE})
    return structure(dict.fromkeys(names, 1.0), *links)


def bistable(name: str, between: str) -> Link:
    return link(name, between, "alpha*d + beta*d**3", alpha=-100.0, beta=1e6)


def net_force(subject: Structure, x: Floats) -> Floats:
    d = subject.elongations(x, 0.0)
    forces = np.array([float(bond.force(d[i])) for i, bond in enumerate(subject.links)])
    return np.asarray(subject.incidence @ forces)


def tangent_eigenvalues(subject: Structure, x: Floats) -> Floats:
    d = subject.elongations(x, 0.0)
    incidence = subject.incidence.toarray()
    slopes = np.array([float(bond.stiffness(d[i])) for i, bond in enumerate(subject.links)])
    return np.linalg.eigvalsh(incidence * slopes @ incidence.T)


def positions(rests: Equilibria) -> set[tuple[float, ...]]:
    return {tuple(np.round(point.x, 9) + 0.0) for point in rests}


@pytest.mark.parametrize("n", [2, 4, 6])
def test_each_sink_of_the_chain_rests_in_either_well_or_on_top(n: int) -> None:
    rests = equilibria(bnes_chain(n))
    choices = product((-0.01, 0.0, 0.01), repeat=n // 2)
    assert positions(rests) == {tuple(np.array([(0.0, d) for d in choice]).ravel()) for choice in choices}
    assert (len(rests.stable), rests.complete, rests.note) == (2 ** (n // 2), True, "")
    assert rests[0].energy == pytest.approx(-0.0025 * n / 2, rel=1e-12)
    assert [point.stable for point in rests] == sorted((point.stable for point in rests), reverse=True)


def test_ten_sinks_are_cut_at_the_limit_which_is_said_with_the_wells_first() -> None:
    rests = equilibria(bnes_chain(20))
    assert (len(rests), len(rests.stable), rests.complete) == (4096, 1024, False)
    assert rests.note == "only 4096 of 59049 combinations of rest points were used, wells first"
    huge = equilibria(bnes_chain(200), limit=3)
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

    def joined(k: float) -> Structure:
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
    with pytest.raises(StructureError, match=message):
        equilibria(bnes_chain(2), start=[0.0, 0.0, 0.0])
    with pytest.raises(StructureError, match=r"`start` must have 2 finite displacements"):
        equilibria(bnes_chain(2), start=[0.0, math.nan])
    message = r'link "spring1": coefficient k is unknown and has no start value'
    with pytest.raises(StructureError, match=message):
        equilibria(bnes_chain(2).unknown("all"))
    pendulum = free(link("p", "a-ground", "F*sin(d/s)", F=1.0, s=0.1))
    with pytest.raises(StructureError, match=r'link "p": .*give a range of d \(`reach`\)'):
        equilibria(pendulum)
    assert len(equilibria(pendulum, reach=(-0.5, 0.5))) == 3
