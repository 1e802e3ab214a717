"""What noise adds to products of terms: closed forms, and the mean over many records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from structures import row_of_masses

import linkwise as lw
from linkwise.weak.displacements import read_displacements
from linkwise.weak.equations import weak_equations
from linkwise.weak.patch import Patch
from linkwise.weak.window import Window

WINDOW = Window.of_deviation(3.0, 1e-3)
SEEDS = 300


def structure(*laws: str) -> lw.Structure:
    """Masses in a row, each link to the one before it, the first to the ground."""
    unknown = lw.Coefficient.unknown(0.1)
    links = {
        f"l{i}": (law, dict.fromkeys(lw.Law.parse(law).coefficients, unknown))
        for i, law in enumerate(laws, start=1)
    }
    return row_of_masses([1.0] * len(laws), **links)


def record(masses: int, sigma: Sequence[float], rng: np.random.Generator | None) -> lw.Record:
    """Motion of two tones per mass, with noise of known `sigma` where there is a generator."""
    time = np.arange(400) / 1000.0
    x = np.stack(
        [np.sin((60 + 17 * i) * time) + 0.6 * np.cos((140 + 11 * i) * time + i) for i in range(masses)],
        axis=1,
    )
    if rng is not None:
        x = x + np.asarray(sigma) * rng.normal(size=x.shape)
    names = [f"x:m{i}" for i in range(1, masses + 1)]
    return lw.Record(0.0, 1000.0, tuple(names), x, dict(zip(names, sigma, strict=True)))


def patch(subject: lw.Structure, measured: lw.Record) -> Patch:
    [only] = weak_equations(measured, subject, read_displacements(measured, subject), window=WINDOW).patches
    return only


def test_bias_of_a_spring_in_closed_form() -> None:
    """(int phi d)^2 gains s^2 sum phi^2 in every window, and (int phi d)(int phi'' x) gains s^2 sum phi phi''."""
    only_patch = patch(structure("k*d"), record(1, [0.2], np.random.default_rng(1)))
    bias = (only_patch.products - only_patch.moments) / only_patch.windows
    assert bias == pytest.approx(
        0.04 * (WINDOW.kernels @ WINDOW.kernels.T)[np.ix_([0, 2], [0, 2])], rel=1e-12
    )


@pytest.mark.parametrize(
    ("laws", "sigma"),
    [
        (["k*d + c*v", "a*d + b*d**3 + c*v"], [0.1, 0.3]),
        (["k*d + k2*d**2 + k3*d**3 + c3*v*d**2 + f0"], [0.25]),
        (["k*d", "k*d + p*d**4", "b*d**3"], [0.2, 0.1, 0.15]),
        (["k*d + c*v + F*tanh(v/1e6)", "b*d**3 + F*tanh(v/1e6)"], [0.1, 0.15]),
    ],
    ids=["sink", "one mass", "three masses", "smoothed rates"],
)
def test_products_lose_their_bias(laws: list[str], sigma: list[float]) -> None:
    """The mean of the moments over many records is the products without noise; 4.5 standard errors bound each of < 60
    elements. The products themselves are off by far more.
    """
    subject, rng = structure(*laws), np.random.default_rng(7)
    clean = record(len(laws), sigma, None)
    truth = patch(subject, replace(clean, noise=dict.fromkeys(clean.channels, 0.0))).products
    patches = [patch(subject, record(len(laws), sigma, rng)) for _ in range(SEEDS)]
    shared = np.abs(patches[0].signs.T) @ np.abs(patches[0].signs) > 0.0  # terms that meet in an equation
    off = {}
    for name in ("moments", "products"):
        samples = np.array([getattr(sample_patch, name) for sample_patch in patches])
        error = samples.std(axis=0, ddof=1) / np.sqrt(SEEDS) + 1e-12 * np.abs(truth)  # constants only round
        off[name] = np.abs((samples.mean(axis=0) - truth)[shared] / error[shared])
    assert np.max(off["moments"]) < 4.5
    assert np.max(off["products"]) > 40.0  # nine times what the moments may be off


def test_terms_of_a_nonlinear_coefficient_lose_their_bias_to_second_order() -> None:
    """tanh has no finite series: what is left falls with the fourth power of the noise, the bias with the second."""
    subject = structure("F*tanh(d/s)")
    left = []
    for sigma in (0.1, 0.05):
        rng = np.random.default_rng(3)
        clean = record(1, [sigma], None)
        asked_at = subject.with_values({"l1.s": 1.0})
        truth = patch(asked_at, replace(clean, noise={"x:m1": 0.0})).products[0, 0]
        moment = np.mean([patch(asked_at, record(1, [sigma], rng)).moments[0, 0] for _ in range(SEEDS)])
        left.append(abs(moment / truth - 1.0))
    assert left[0] < 0.1**2 / 10 and left[1] < 0.05**2 / 4
