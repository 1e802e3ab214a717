"""Energies over a given motion, against closed forms."""

from __future__ import annotations

import numpy as np

from linkwise.model.chains import bnes_chain
from linkwise.simulation.energy import kinetic_energy, potential_energy


def test_kinetic_and_potential_energy_of_the_chain() -> None:
    chain = bnes_chain(2)
    x, v = np.array([[0.001, 0.011], [0.0, 0.0]]), np.array([[1.0, -2.0], [0.0, 3.0]])
    np.testing.assert_allclose(kinetic_energy(chain, v), [0.5 + 0.02, 0.045], rtol=1e-12)
    np.testing.assert_allclose(potential_energy(chain, x), [[0.015, -0.0025], [0.0, 0.0]], rtol=1e-12)
