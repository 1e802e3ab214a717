"""Complex modes: the receptances that they give, and their derivatives."""

import numpy as np
import pytest

from linkwise.arrays import Floats
from linkwise.modal.oscillators import ComplexModes

FREQUENCIES, RATIOS = np.array([3.0, 3.2, 11.0]), np.array([0.02, 0.03, 0.01])
PAIRS, BETWEEN = ((0, 1), (1, 2)), np.array([0.3, -0.5])


def modes(parameters: Floats) -> ComplexModes:
    """From frequency and ratio of each coordinate in turn, then damping between pairs."""
    own = parameters[:6].reshape(3, 2)
    return ComplexModes(own[:, 0], own[:, 1], PAIRS, parameters[6:])


def stated() -> Floats:
    return np.concatenate([np.stack([FREQUENCIES, RATIOS], axis=1).ravel(), BETWEEN])


def residues(found: ComplexModes) -> Floats:
    """(n, n, n) products of vectors, which have no sign."""
    return np.asarray(np.einsum("kr,ks->krs", found.vectors, found.vectors))


def test_they_give_the_receptances_of_the_matrices() -> None:
    found = modes(stated())
    for frequency in (0.5, 3.1, 7.0):
        s = 2j * np.pi * frequency
        stiffness = np.diag((2.0 * np.pi * FREQUENCIES) ** 2)
        exact = np.linalg.inv(stiffness + s * found.damping + s**2 * np.eye(3))
        summed = sum(
            each / (s - pole) + each.conj() / (s - pole.conjugate())
            for each, pole in zip(residues(found), found.poles, strict=True)
        )
        np.testing.assert_allclose(summed, exact, rtol=1e-10)  # rounding


def test_their_derivatives_are_those_of_differences() -> None:
    found, at = modes(stated()), stated()
    by_pole, by_vector = found.changes
    for number, value in enumerate(at):
        step = np.zeros(len(at))
        step[number] = 1e-5 * max(abs(value), 0.1)
        ahead, behind = modes(at + step), modes(at - step)
        poles = (ahead.poles - behind.poles) / (2.0 * step[number])
        np.testing.assert_allclose(by_pole[number], poles, rtol=1e-5, atol=1e-7)  # central differences
        products = np.einsum("kr,ks->krs", by_vector[number], found.vectors)
        expected = (residues(ahead) - residues(behind)) / (2.0 * step[number])
        np.testing.assert_allclose(products + products.swapaxes(1, 2), expected, rtol=1e-4, atol=1e-8)


def test_a_mode_that_does_not_vibrate_is_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="does not vibrate"):
        _ = ComplexModes(FREQUENCIES, np.array([0.02, 1.5, 0.01]), (), np.empty(0)).poles
