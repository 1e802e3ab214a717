"""Terms with recorded signals, which are offered where a record has some, and tested by likelihood."""

from dataclasses import replace

import numpy as np
import pytest

import linkwise as lw
from linkwise.discovery import parse_terms

TRUE = {"m1-ground.k": 400.0, "m1-ground.c": 0.5, "m1-ground.c_u": 2.0}
RATE = 200.0


def valve_record() -> lw.Record:
    valve = lw.rig({"m1": 1.0}, {"m1-ground": "m1 - ground: k*d + c*v + c_u*u*v"}, TRUE, signals={"u": "V"})
    time = np.arange(801) / RATE
    run = lw.simulate(
        valve,
        release={"x:m1": 0.05},
        duration=4.0,
        rate=RATE,
        forces={"m1": "3*sin(17*t) + 2*sin(23*t)"},
        signals={"u": lw.model.Sampled(0.0, RATE, 1.0 + np.sin(5.0 * time))},
    )
    return replace(run.with_noise(40.0, seed=493), simulated=None)


def test_terms_with_signals_have_names_and_units() -> None:
    terms = parse_terms("v, u, u*d, u*v, u**2*v", {"u": "V"})
    assert [term.product for term in terms] == ["c*v", "g_u*u", "k_u*u*d", "c_u*u*v", "a5*u**2*v"]
    assert [term.unit for term in terms[1:4]] == ["N/V", "s A/m^2", "s^2 A/m^2"]
    assert not terms[3].is_damping
    with pytest.raises(lw.IdentificationError, match=r"contains the name 'w'.* or record a channel signal:w"):
        parse_terms("v, w*v", {"u": "V"})
    with pytest.raises(lw.IdentificationError, match="is a linear combination of"):
        parse_terms("u, 2*u", {"u": "V"})


@pytest.mark.slow
def test_a_valve_is_discovered() -> None:
    found = lw.discover(valve_record(), {"m1": 1.0})
    link = found.structure.links[0]
    assert found.trusted
    assert link.law.text == "k*d + c*v + c_u*u*v"
    assert found.structure.signals == {"u": "V"}
    fit = found.estimate
    z = (fit.values - list(TRUE.values())) / np.sqrt(fit.covariance.diagonal())
    assert np.abs(z).max() < 3.3  # of a thousand


def test_a_term_that_names_a_signal_needs_its_channel() -> None:
    without = valve_record().select(["x:m1", "force:m1"])
    with pytest.raises(lw.IdentificationError, match=r"contains the name 'u'.* or record a channel signal:u"):
        lw.discover(without, {"m1": 1.0}, terms="v, d, u*v")
