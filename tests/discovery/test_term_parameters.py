"""Parameters inside terms that a discovery finds: a rate at which friction saturates, an exponent, a gap."""

import pytest
from structures import row_of_masses

import linkwise as lw

MASSES = {"m1": 1.0, "m2": 0.3}


def pair(law: str, values: dict[str, float]) -> lw.Structure:
    """Two masses in a row, the second on a link with a law of its own."""
    support = ("k*d + c*v", {"k": 1000.0, "c": 1.0})
    return row_of_masses(list(MASSES.values()), **{"m1-ground": support, "m2-m1": (law, values)})


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
    discovery = lw.discover(recorded(structure, 40.0, seed), MASSES, terms=terms)
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
        lw.discover(record, MASSES, terms=terms) for terms in ("v, d, d**3, friction", "v, d, d**3")
    )
    assert with_them.trusted
    assert with_them.structure == without.structure


def test_a_parameter_of_which_motion_tells_no_size_is_refused() -> None:
    with pytest.raises(lw.IdentificationError, match=r"'b' of the term .* has the unit \?.*write a number"):
        lw.discover(recorded(CUBIC, 40.0, 1), MASSES, terms="v, d, d*exp(-abs(d)**n/b)")


@pytest.mark.slow
@pytest.mark.usefixtures("memory_not_sought")
def test_friction_that_gives_energy_stands_in_for_another_damping() -> None:
    """Quadratic damping, which was not offered: negative friction was beyond doubt, and c 8 standard errors off."""
    quadratic = pair("k*d + c*v + c2*v*abs(v)", {"k": 400.0, "c": 0.3, "c2": 0.5})
    record = recorded(quadratic, 28.0, 3)
    discovery = lw.discover(record, MASSES, terms="linear, d**3, friction")
    assert lw.Verdict.TERMS_MAY_BE_MISSING in discovery.verdicts
    assert any("damping in m2-m1 one gives energy" in remark for remark in discovery.remarks)
    assert lw.discover(record, MASSES, terms="linear, d**3, v*abs(v)").trusted
