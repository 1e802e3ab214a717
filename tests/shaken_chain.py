"""A chain of masses in random forces, followed by a Runge-Kutta method of the tests' own."""

import numpy as np
from structures import row_of_masses

import linkwise as lw
from linkwise.arrays import Floats

RATE = 100.0
STIFFNESS, DAMPING = 1000.0, 1.0  # N/m, N s/m; masses of 1 kg
SUBSTEPS = 4  # in a sample, over which a random force is constant
STEADY = 2000  # samples before a record, after which its start is forgotten
NOISE = 1e-4  # m, of displacements of some mm


def chain(n: int, law: str = "k*d + c*v") -> lw.Structure:
    values = {"k": STIFFNESS, "c": DAMPING}
    given = {name: values.get(name, 0.0) for name in lw.Law.parse(law).coefficients}
    return row_of_masses([1.0] * n, **{f"l{i}": (law, given) for i in range(1, n + 1)})


def matrices(n: int) -> tuple[Floats, Floats]:
    """Of the equations of a chain of n masses of 1 kg, and how its springs stretch with their displacements."""
    incidence = np.eye(n) - np.eye(n, k=1)
    pulls = incidence @ incidence.T
    return np.block([[np.zeros((n, n)), np.eye(n)], [-STIFFNESS * pulls, -DAMPING * pulls]]), incidence


def motion(forces: Floats, cubic: float = 0.0) -> Floats:
    """(N, 2 n) displacements and velocities of the chain, by the Runge-Kutta method of order 4 in its substeps.

    Of what is linear a step is a polynomial of the matrix of the equations.
    """
    n, step = forces.shape[1], 1.0 / (RATE * SUBSTEPS)
    matrix, incidence = matrices(n)
    identity, moved = np.eye(2 * n), step * matrix
    onward = identity + moved @ (identity + moved @ (identity + moved @ (identity + moved / 4.0) / 3.0) / 2.0)
    pushed = step * (identity + moved @ (identity + moved @ (identity + moved / 4.0) / 3.0) / 2.0)[:, n:]

    def bent(state: Floats, force: Floats) -> Floats:
        """The rate of the state with cubic springs."""
        rate = matrix @ state
        rate[n:] += force - cubic * (incidence @ (incidence.T @ state[:n]) ** 3)
        return rate

    state, out = np.zeros(2 * n), np.empty((len(forces) // SUBSTEPS, 2 * n))
    for number, force in enumerate(forces):
        if number % SUBSTEPS == 0:
            out[number // SUBSTEPS] = state
        if cubic == 0.0:
            state = onward @ state + pushed @ force
            continue
        k1 = bent(state, force)
        k2 = bent(state + 0.5 * step * k1, force)
        k3 = bent(state + 0.5 * step * k2, force)
        k4 = bent(state + step * k3, force)
        state = state + step / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    return out
