"""Linear modes, against closed forms and the defining equations."""

import math

import numpy as np
import pytest
from structures import link, structure

from linkwise.analysis.linear_modes import modes, natural_frequencies
from linkwise.analysis.rest_positions import equilibria
from linkwise.errors import StructureError
from linkwise.model.chains import bnes_chain
from linkwise.model.law import Law
from linkwise.model.structure import GROUND, Structure

SPRING = Law.parse("k*d + c*v")


def row(k: list[float], c: list[float], masses: list[float], *, grounded: bool = True) -> Structure:
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
    chain = bnes_chain(6)
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
    top = modes(bnes_chain(2), [0.0, 0.0])
    assert np.isnan(top.frequencies[0])
    assert np.isnan(top.damping[0])
    assert top.frequencies[1] > 0.0
    assert top.note == "1 of 2 modes of negative stiffness, unstable and without a frequency"
    assert top.eigenvalues.real.max() > 0.0


@pytest.mark.parametrize("masses", [2, 6])
def test_modes_are_those_of_the_deepest_equilibrium_unless_a_place_is_given(masses: int) -> None:
    """At d = 0.02 the sink is pulled back by -100*0.02 + 1e6*0.02**3 = 6 N."""
    chain = bnes_chain(masses)
    np.testing.assert_array_equal(modes(chain).at, equilibria(chain)[0].x)
    np.testing.assert_array_equal(natural_frequencies(chain), modes(chain).frequencies)
    note = 'this is not an equilibrium: the links exert 6 N on mass "m1"'
    assert modes(bnes_chain(2), [0.0, 0.02]).note == note


def test_what_cannot_be_is_refused() -> None:
    message = r"`at` must have 2 finite displacements in m, one for each mass"
    with pytest.raises(StructureError, match=message):
        modes(bnes_chain(2), [0.0])
    falling = structure({"m": 1.0}, link("f", "m-ground", "f0", f0=1.0))
    message = r"no stable equilibrium was found: .*vanishes nowhere; give `at`"
    with pytest.raises(StructureError, match=message):
        modes(falling)
