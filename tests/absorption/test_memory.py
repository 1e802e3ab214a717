"""Sinks with memory: energies that close, the power in the resistor of a piezo, its optimal load, and rest at states of 0."""

from typing import Any

import numpy as np
import pytest
from structures import harvester, link, oscillator, structure

import linkwise as lw
from linkwise.analysis.linear_modes import natural_frequencies

PIEZO = {"k": 40.0, "c": 0.4, "theta": 2e-3, "R": 1e5, "C": 43e-9}
RELEASE: dict[str, Any] = {"duration": 2.0, "release": {"v:m1": 1.0}, "sinks": ["piezo"]}


def tower(law: str = "k*d + c*v - theta*V", **changes: float) -> lw.Structure:
    """A mass on a spring that carries a small one on a piezo with a resistor."""
    host = link("tower", "m1-ground", "k*d + c*v", k=3000.0, c=1.0)
    state = lw.model.LinkState("(-theta*v - V/R)/C", unit="V")
    piezo = link("piezo", "m2-m1", law, {"V": state}, **(PIEZO | changes))
    return structure({"m1": 1.0, "m2": 0.05}, host, piezo)


def test_the_damper_the_resistor_and_the_capacitor_share_what_the_link_takes() -> None:
    """Work on the link less its spring's: c v^2 and V^2/R are dissipated, C V^2/2 stays in the capacitor."""
    structure = tower()
    by_power = {
        power: lw.absorb(structure, **RELEASE, rate=2000.0, harvesters={"piezo": power})
        for power in ("c*v**2", "V**2/R")
    }
    energies = [absorption.harvests[0].energy for absorption in by_power.values()]
    run = by_power["V**2/R"].with_sinks
    record = lw.simulate(structure, duration=2.0, rate=2000.0, release={"v:m1": 1.0}, sensors=["state"])
    stored = 0.5 * PIEZO["C"] * record.channel("state:piezo.V")[-1] ** 2
    # trapezoidal rule over a decaying oscillation: (2 w h)^2/12 of a term at its ends, w = 60 rad/s, h = 0.5 ms
    assert sum(energies) + stored == pytest.approx(
        run.share("piezo") * run.total, rel=(2 * 60 * 5e-4) ** 2 / 12
    )
    assert energies[1] > 0.1 * energies[0]  # it is a harvester


@pytest.mark.parametrize(
    ("harvesters", "message"),
    [
        ({"piezo": "V**2*R"}, r"'V\*\*2\*R' is not a power in W, with V in V, R in ohm"),
        ({"piezo": "V**2/Q"}, r"contains 'Q'; choose from d, v, V, k, c, theta, R, C"),
        ({"piezo": "V**/R"}, "is not a power"),
        ({"pie": "V**2/R"}, 'unknown link "pie"; did you mean "piezo"'),
        ({"piezo": -0.1}, "the damping of a harvester must be positive"),
        # a nan beside "can be trusted" before; V is 0/0 at the start in the second
        ({"piezo": "V**2/(R - R)"}, r"harvester on piezo: its power .* is not a finite number at 0 s"),
        ({"piezo": "V**2/R*abs(V)/abs(V)"}, r"harvester on piezo: its power .* is not a finite number at 0 s"),
    ],
)  # fmt: skip
def test_what_is_no_harvester_is_refused(harvesters: dict[str, float | str], message: str) -> None:
    numbers = "finite" in message
    with pytest.raises(lw.SimulationError if numbers else lw.StructureError, match=message):
        lw.absorb(tower(), **RELEASE, harvesters=harvesters)


@pytest.mark.parametrize("power", ["2", "-V**2/R", "20*V**2/R"])
def test_a_link_that_delivers_more_than_it_takes_is_not_trusted(power: str) -> None:
    found = lw.absorb(tower(), **RELEASE, harvesters={"piezo": power})
    assert not found.trusted
    assert any(f"{power} would deliver" in finding for finding in found.findings)
    assert lw.absorb(tower(), **RELEASE, harvesters={"piezo": "V**2/R"}).trusted


# --- rest and modes at states of 0


def test_equilibria_and_modes_are_those_in_a_short_circuit() -> None:
    still = oscillator("k*d + c*v", k=40.0, c=0.4)
    piezo = harvester(1.0, "ground", "piezo", **PIEZO)
    assert [point.x.tolist() for point in lw.analysis.equilibria(piezo).stable] == [[0.0]]
    np.testing.assert_allclose(
        lw.analysis.modes(piezo).frequencies, lw.analysis.modes(still).frequencies, rtol=1e-12
    )
    open_circuit = np.sqrt((40.0 + PIEZO["theta"] ** 2 / PIEZO["C"]) / still.mass_values[0]) / (2.0 * np.pi)
    assert natural_frequencies(piezo)[0] == pytest.approx(open_circuit, rel=1e-12)


def test_a_state_that_does_not_rest_is_refused() -> None:
    creep = lw.Law.parse("k*(d - z)", {"z": "r*(d - z)"})
    creeping, sink = (
        link(name, ends, creep, k=40.0, r=2.0) for name, ends in (("creep", "m1-ground"), ("sink", "m2-m1"))
    )
    resting = "the state z does not rest at 0 while the ends of the link are at rest"
    with pytest.raises(lw.StructureError, match=resting):
        lw.analysis.equilibria(structure({"m1": 1.0}, creeping))
    two = structure({"m1": 1.0, "m2": 0.1}, creeping, sink)
    with pytest.raises(lw.StructureError, match="does not rest at 0"):
        lw.absorb(two, duration=1.0, release={"v:m1": 1.0}, sinks=["sink"])
