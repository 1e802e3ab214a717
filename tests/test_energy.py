"""Energies over a given motion, against closed forms and the energy balance of an exact solution."""

from __future__ import annotations

import numpy as np
import pytest

from linkwise.chains import bnes_chain
from linkwise.coefficient import Coefficient
from linkwise.energy import dissipated_energy, kinetic_energy, potential_energy
from linkwise.errors import StructureError
from linkwise.law import Law
from linkwise.structure import BASE, Link, Mass, Structure


def test_kinetic_and_potential_energy_of_the_chain() -> None:
    chain = bnes_chain(2)
    x, v = np.array([[0.001, 0.011], [0.0, 0.0]]), np.array([[1.0, -2.0], [0.0, 3.0]])
    np.testing.assert_allclose(kinetic_energy(chain, v), [0.5 + 0.02, 0.045], rtol=1e-12)
    np.testing.assert_allclose(potential_energy(chain, x), [[0.015, -0.0025], [0.0, 0.0]], rtol=1e-12)


def damped(n: int) -> float:
    """Error of the balance, over the energy put in, for x'' = -k x - c x' sampled at n points over one second."""
    m, k, c = 2.0, 800.0, 3.0
    held = Link(
        "s", ("m", BASE), Law.parse("k*d + c*v"), {"k": Coefficient.number(k), "c": Coefficient.number(c)}
    )
    structure = Structure("", (Mass("m", Coefficient.number(m)),), (held,))
    time = np.linspace(0.0, 1.0, n)
    pole = complex(-c / (2.0 * m), np.sqrt(k / m - (c / (2.0 * m)) ** 2))
    z = np.exp(pole * time) / pole.imag
    x, v = z.imag[:, None], (pole * z).imag[:, None]
    still = np.zeros(n)
    heat = dissipated_energy(structure, time, x, v, base=still, base_velocity=still)
    total = kinetic_energy(structure, v) + potential_energy(structure, x, still)[:, 0] + heat[:, 0]
    assert np.all(np.diff(heat[:, 0]) >= 0.0)
    return float(np.abs(total / total[0] - 1.0).max())


def test_the_balance_closes_with_the_declared_order() -> None:
    """Order 6 of the time step: halving it divides the error by 64; at least 40 is asked, at most 1e-9 in the end."""
    assert damped(201) / damped(401) > 40.0
    assert damped(801) < 1e-9


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(
        StructureError, match=r"the dissipated energy needs at least 6 samples of the motion, got 5"
    ):
        dissipated_energy(bnes_chain(2), np.arange(5.0), np.zeros((5, 2)), np.zeros((5, 2)))
