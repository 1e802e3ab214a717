"""Two records that nobody here made: a circuit that behaves as an oscillator, and a beam between magnets.

The figures are those of the records' own description: of the circuit, per mass, g = 1.8608e5, c = 41.89, k = 1.84325e5,
k2 = -6.37e3, k3 = 7.294e5, with a constant force of about 5 mV, and a free run of 0.3 mV for these coefficients.
"""

from pathlib import Path

import numpy as np
import pytest
from present import present
from structures import asked_oscillator, link, structure

import linkwise as lw

pytestmark = pytest.mark.slow


PER_MASS = {"k": 1.84325e5, "k2": -6.37e3, "k3": 7.294e5, "c": 41.89}
GAIN = 1.8608e5

CIRCUIT = structure(
    {"m1": lw.Coefficient.unknown()},
    link("spring", "m1-ground", "k*d + k2*d**2 + k3*d**3 + c*v"),
    link("offset", "m1-ground", "f0"),
)

BEAM = asked_oscillator("k*d + k3*d**3 + c*v + c3*v*d**2", 1.0, name="beam")


@pytest.fixture(scope="module")
def circuit(shared_data: Path) -> lw.Record:
    return lw.read_record(shared_data / "silverbox_multisine.csv")


@pytest.fixture(scope="module")
def beam(shared_data: Path) -> lw.Record:
    return lw.read_record(shared_data / "magnet_beam_decay.csv")


@pytest.mark.parametrize("two_links", [False, True])
def test_circuit(circuit: lw.Record, two_links: bool) -> None:
    """From four fifths; a free run over the last stays below 0.5 mV. The constant may be a link of its own."""
    single = asked_oscillator("k*d + k2*d**2 + k3*d**3 + c*v + f0")
    asked = CIRCUIT if two_links else single
    cut = len(circuit) * 4 // 5
    fit = lw.identify(circuit[:cut], asked, method="weak")
    mass = fit.masses[0].value
    assert mass == pytest.approx(1 / GAIN, rel=0.03)
    for name, value in PER_MASS.items():
        assert fit.coefficient(f"spring.{name}").value / mass == pytest.approx(value, rel=0.03)
    constant = fit.coefficient("offset.f0" if two_links else "spring.f0").value
    assert constant == pytest.approx(5e-3, abs=1e-3)
    assert lw.analysis.free_run(fit.structure, circuit[cut:]).rmse["x:m1"] < 0.5e-3


def test_circuit_without_its_constant_force(circuit: lw.Record) -> None:
    """What must be refused: ten times the error in the free run."""
    cut = len(circuit) * 4 // 5
    fit = lw.identify(circuit[:cut], asked_oscillator("k*d + k2*d**2 + k3*d**3 + c*v"), method="weak")
    assert not fit.trusted
    assert lw.analysis.free_run(fit.structure, circuit[cut:]).rmse["x:m1"] > 5e-3


def test_more_terms_explain_more_of_the_beam(beam: lw.Record) -> None:
    """No polynomial explains it to its noise, and the answer says by how much; each set of terms explains more."""
    laws = [
        "k*d + c*v",
        "k*d + k3*d**3 + c*v + c3*v*d**2",
        "k*d + k2*d**2 + k3*d**3 + c*v + c2*v*d + c3*v*d**2",
        "k*d + k2*d**2 + k3*d**3 + k4*d**4 + k5*d**5 + c*v + c2*v*d + c3*v*d**2 + c4*v*d**4 + f0",
    ]
    fits = [lw.identify(beam, asked_oscillator(law, 1.0), method="weak") for law in laws]
    left = [present(fit.chi_square_per_sample) for fit in fits]
    assert left == sorted(left, reverse=True) and left[0] > 10 * left[-1]
    assert [fit.trusted for fit in fits[:-1]] == [False, False, False]
    assert "of its forces, which is" in fits[0].message
    small = np.sqrt(fits[-1].coefficient("spring.k").value) / (2 * np.pi)
    assert 30.0 < small < 42.05  # Hz: it hardens, and was driven near its resonance at 42.05 Hz
    # four standard deviations of the estimate, as tests/signals/test_noise.py has them
    assert fits[0].noise["x:m1"].sigma == pytest.approx(3.7e-7, rel=0.05)
