"""Free vibration over amplitude: exact periods, energies that are kept, ends that are reached, and what is refused."""

import numpy as np
import pytest
from scipy.special import ellipk
from structures import HARDENING, link, oscillator, row_of_masses, structure

import linkwise as lw

K, K3 = 400.0, 1e5


def test_frequencies_of_a_duffing_oscillator_are_those_of_its_exact_period() -> None:
    curve = lw.backbone(oscillator(HARDENING, k=K, k3=K3, c=0.4), 1, to_amplitude={"x:m1": 0.5})
    amplitude = curve.amplitude[:, 0]
    stiff = K + K3 * amplitude**2
    period = 4.0 / np.sqrt(stiff) * ellipk(0.5 * K3 * amplitude**2 / stiff)
    np.testing.assert_allclose(curve.hz, 1.0 / period, rtol=1e-8)
    np.testing.assert_allclose(curve.energy, 0.5 * K * amplitude**2 + 0.25 * K3 * amplitude**4, rtol=1e-8)
    assert amplitude[-1] == pytest.approx(0.5, rel=1e-8)


def test_a_mode_of_a_chain_is_periodic_in_a_simulation_without_damping() -> None:
    laws = {"k": K, "k3": K3, "c": 2.0}, {"k": 300.0, "k3": 4e5, "c": 1.0}
    chain = row_of_masses([1.0, 0.5], first=(HARDENING, laws[0]), second=(HARDENING, laws[1]))
    curve = lw.backbone(chain, 2, to_energy=0.3)
    assert curve.energy[-1] == pytest.approx(0.3, rel=1e-6)
    assert curve.hz[0] == pytest.approx(lw.analysis.modes(chain).frequencies[1], rel=1e-4)
    undamped, hz = chain.with_values({"first.c": 0.0, "second.c": 0.0}), curve.hz[-1]
    release = dict(zip(curve.channels, curve.starts[-1].tolist(), strict=True))
    record = lw.simulate(undamped, release=release, duration=1.0 / hz, rate=64.0 * hz)
    np.testing.assert_allclose(record.values[-1], curve.starts[-1], rtol=1e-9)
    np.testing.assert_allclose(0.5 * np.ptp(record.values, axis=0), curve.amplitude[-1], rtol=1e-3)


def test_a_curve_that_ends_too_soon_says_so() -> None:
    curve = lw.backbone(lw.bnes_chain(2), 1, to_amplitude={"x:m1": 0.01})
    assert not curve.reached
    assert "before the end that was asked for" in str(curve)


def test_modes_of_a_host_are_followed() -> None:
    modes = tuple(lw.model.HostMode(hz, 0.01, {"tip": shape}) for hz, shape in ((5.0, 1.0), (31.0, 0.9)))
    beam = structure({}, link("stop", "beam.tip-ground", "k3*d**3", k3=1e6), hosts=[lw.Host("beam", modes)])
    curve = lw.backbone(beam, 1, to_amplitude={"x:beam.tip": 0.05})
    assert curve.channels == ("x:beam.tip",)
    assert curve.hz[0] == pytest.approx(5.0, rel=1e-4)
    assert curve.hz[-1] > 6.0


def test_what_has_no_backbone_is_refused() -> None:
    spring = oscillator(HARDENING, k=K, k3=K3, c=0.4)
    with pytest.raises(
        lw.SimulationError,
        match=r"there is no vibration in mode 2; the frequencies of modes 1 to 1 are 3\.183 Hz",
    ):
        lw.backbone(spring, 2)
    with pytest.raises(lw.SimulationError, match="an amplitude or at an energy; give one"):
        lw.backbone(spring, 1, to_amplitude={"x:m1": 0.1}, to_energy=1.0)
    with pytest.raises(
        lw.SimulationError,
        match=r"the energy at which a backbone ends must be positive, in SI units, got -1\.0",
    ):
        lw.backbone(spring, 1, to_energy=-1.0)
    with pytest.raises(lw.StructureError, match="is not smooth"):
        lw.backbone(oscillator("k*d + k2*d*abs(d)", k=K, k2=1.0), 1)


def test_a_linear_structure_needs_an_end() -> None:
    """Its curve went on to 1e36 J, as its frequency never changes by a third."""
    spring = oscillator("k*d + c*v", name="spring", k=400.0, c=0.5)
    with pytest.raises(lw.SimulationError, match="at any amplitude, so that nothing ends the curve"):
        lw.backbone(spring, 1)
    assert lw.backbone(spring, 1, to_energy=1.0).reached
