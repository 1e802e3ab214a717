"""Options of discovery, terms with parameters and with signals."""

from dataclasses import fields, replace
from types import MappingProxyType

import numpy as np
import pytest
from problems import chain_record
from structures import row_of_masses

import linkwise as lw
from linkwise.discovery.candidates import DiscoveryKeywords

MASSES = {"m1": 1.0, "m2": 0.01}


@pytest.fixture(scope="module")
def record() -> lw.Record:
    """A record of two masses."""
    return chain_record(2, duration=0.5).with_noise(40.0, seed=1)


def test_an_object_asks_what_keywords_ask(record: lw.Record) -> None:
    names = {field.name for field in fields(lw.discovery.DiscoveryOptions)}
    assert names == set(DiscoveryKeywords.__annotations__)
    options = lw.discovery.DiscoveryOptions(terms=["v", "d"])
    short = record[:51]  # few samples for the candidates: 2 terms on m1-m2, m1-ground and m2-ground
    remarks = lw.discovery.check_discovery(short, MASSES, options)
    assert "102 samples for 6 candidates" in remarks[0]
    assert lw.discovery.check_discovery(short, MASSES, terms="v, d") == remarks


def test_both_at_once_invalid_terms_and_unknown_keywords_are_refused(record: lw.Record) -> None:
    options = lw.discovery.DiscoveryOptions()
    with pytest.raises(TypeError, match="got options and also terms; give one of the two"):
        lw.discover(record, MASSES, options, terms="v, d")
    with pytest.raises(TypeError, match="term"):
        lw.discovery.check_discovery(record, MASSES, term="v, d")  # type: ignore[call-arg]  # the point of the test
    with pytest.raises(lw.IdentificationError, match="the list of terms is empty"):
        lw.discovery.DiscoveryOptions(terms=[])


OF_TWO = {"m1": 1.0, "m2": 0.3}


def pair(law: str, values: dict[str, float]) -> lw.Structure:
    """Two masses in a row, the second on a link with a law of its own."""
    support = ("k*d + c*v", {"k": 1000.0, "c": 1.0})
    return row_of_masses(list(OF_TWO.values()), **{"m1-ground": support, "m2-m1": (law, values)})


FRICTION = pair("k*d + c*v + F*tanh(v/v_f)", {"k": 400.0, "c": 0.2, "F": 0.3, "v_f": 0.05})
CUBIC = pair("k*d + k3*d**3 + c*v", {"k": 400.0, "c": 0.5, "k3": 2e4})


def recorded(structure: lw.Structure, snr_db: float, seed: int) -> lw.Record:
    record = lw.simulate(structure, release={"v:m1": 1.5}, duration=6.0, rate=500.0)
    return record.with_noise(snr_db, seed=seed)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("structure", "terms", "parameter", "value", "seed"),
    [
        (FRICTION, "v, d, d**2, d**3, friction", "v_f", 0.05, 12),
        (CUBIC, "v, d, abs(d)**n*sign(d)", "n", 3.0, 11),  # with n of 2.5 or 3.5 a false link makes up
    ],
)
def test_it_is_found(structure: lw.Structure, terms: str, parameter: str, value: float, seed: int) -> None:
    """Within four standard errors, which chance exceeds once in 16 000 times."""
    discovery = lw.discover(recorded(structure, 40.0, seed), OF_TWO, terms=terms)
    assert discovery.trusted
    assert [link.name for link in discovery.structure.links] == ["m1-ground", "m2-m1"]
    coefficient = discovery.estimate.coefficient(f"m2-m1.{parameter}")
    assert coefficient.standard_error is not None
    assert abs(coefficient.value - value) < 4.0 * coefficient.standard_error
    assert coefficient.standard_error < 0.02 * value
    assert parameter == "n" or lw.discovery.term_score(discovery.structure, structure).exact


def test_terms_with_parameters_that_are_not_needed_change_nothing() -> None:
    record = recorded(CUBIC, 40.0, 14)
    with_them, without = (
        lw.discover(record, OF_TWO, terms=terms) for terms in ("v, d, d**3, friction", "v, d, d**3")
    )
    assert with_them.trusted
    assert with_them.structure == without.structure


def test_a_parameter_of_which_motion_tells_no_size_is_refused() -> None:
    with pytest.raises(lw.IdentificationError, match=r"'b' of the term .* has the unit \?.*write a number"):
        lw.discover(recorded(CUBIC, 40.0, 1), OF_TWO, terms="v, d, d*exp(-abs(d)**n/b)")


@pytest.mark.slow
@pytest.mark.usefixtures("memory_not_sought")
def test_friction_that_gives_energy_stands_in_for_another_damping() -> None:
    """Quadratic damping, which was not offered: negative friction was beyond doubt, and c 8 standard errors off."""
    quadratic = pair("k*d + c*v + c2*v*abs(v)", {"k": 400.0, "c": 0.3, "c2": 0.5})
    record = recorded(quadratic, 28.0, 3)
    discovery = lw.discover(record, OF_TWO, terms="linear, d**3, friction")
    assert lw.Verdict.TERMS_MAY_BE_MISSING in discovery.verdicts
    assert any("damping in m2-m1 one gives energy" in remark for remark in discovery.remarks)
    assert lw.discover(record, OF_TWO, terms="linear, d**3, v*abs(v)").trusted


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
    terms = lw.discovery.parse_terms("v, u, u*d, u*v, u**2*v", {"u": "V"})
    assert [term.product for term in terms] == ["c*v", "g_u*u", "k_u*u*d", "c_u*u*v", "a5*u**2*v"]
    assert [term.unit for term in terms[1:4]] == ["N/V", "s A/m^2", "s^2 A/m^2"]
    assert not terms[3].is_damping
    with pytest.raises(lw.IdentificationError, match=r"contains the name 'w'.* or record a channel signal:w"):
        lw.discovery.parse_terms("v, w*v", {"u": "V"})
    with pytest.raises(lw.IdentificationError, match="is a linear combination of"):
        lw.discovery.parse_terms("u, 2*u", {"u": "V"})


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


def test_what_was_stated_is_copied_and_what_is_no_list_is_left_to_its_check() -> None:
    """A generator ended in a TypeError on pickles."""
    stated, masses = {"force:m1": 0.1}, (name for name in ["m1"])
    options = lw.discovery.DiscoveryOptions(input_noise=MappingProxyType(stated), ambient=masses)  # type: ignore[arg-type]
    stated.clear()
    assert options.input_noise == {"force:m1": 0.1} and id(options.ambient) == id(masses)
