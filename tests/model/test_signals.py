"""Signals in laws: recorded inputs that a law names, declared with their units at the top of a structure."""

import pytest

import linkwise as lw

VALVE = """
name = "valve"
signals = { u = "V" }

[[mass]]
name = "m1"
mass = 1.0

[[link]]
name = "damper"
between = ["m1", "ground"]
law = "k*d + (c0 + cu*u)*v"
coefficients = { k = 400.0, c0 = "unknown", cu = "2 N s/m/V" }
"""


def test_a_structure_names_its_signals_and_is_written_as_it_was_read() -> None:
    structure = lw.parse_structure(VALVE)
    law = structure.link("damper").law
    assert structure.signals == {"u": "V"}
    assert law.signals == ("u",)
    assert law.coefficients == ("k", "c0", "cu")
    assert lw.parse_structure(lw.model.format_structure(structure)) == structure
    assert structure.with_values({"damper.c0": 1.0}).signals == {"u": "V"}
    assert float(structure.with_values({"damper.c0": 1.0}).link("damper").force(0.1, 2.0, {"u": 3.0})) == 54.0


def test_units_of_coefficients_follow_from_that_of_a_signal() -> None:
    levitated = lw.rig({"ball": 0.1}, {"coil": "ball - ground: K*i**2/(1 + d/a)**2"}, signals={"i": "A"})
    assert dict(levitated.link("coil").law.units) == {"K": "N/A^2", "a": "m"}


def test_a_state_may_be_driven_by_a_signal() -> None:
    law = lw.Law.parse("k*d - Bl*i", {"i": "(u - R*i - Bl*v)/L"}, signals={"u": "V"})
    assert law.variables == ("d", "v", "i", "u")
    assert law.state_units["i"] == "A"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('u = "V"', 'u = "V", w = "A"', "no law names the signal w"),
        ("c0 =", "u = 1.0, c0 =", "u is a coefficient and a signal; rename one of the two"),
        ('u = "V"', 'd = "V"', "a signal cannot be named 'd', which is the elongation in laws"),
        ('u = "V"', 'u = "mV"', "numbers in laws are SI, and 'mV' is no SI unit"),
        ('signals = { u = "V" }', "", "coefficients of the law .* are missing: add u"),
    ],
)
def test_what_cannot_be_a_signal_is_refused(old: str, new: str, message: str) -> None:
    with pytest.raises(lw.StructureError, match=message):
        lw.parse_structure(VALVE.replace(old, new))


def test_one_signal_has_one_unit_in_all_links() -> None:
    links = tuple(
        lw.Link(end, ("m", end), lw.Law.parse("g*u", signals={"u": unit}), {"g": 1.0})
        for end, unit in (("ground", "V"), ("base", "A"))
    )
    with pytest.raises(lw.StructureError, match='signal u is in "V" here, and in "A" in another link'):
        lw.Structure("two units", (lw.Mass("m", 1.0),), links)


def test_what_takes_no_signal_says_so() -> None:
    valve = lw.parse_structure(VALVE)
    with pytest.raises(
        lw.StructureError, match=r"the law names a signal \(u\), which is not supported in basins"
    ):
        lw.model.link.refuse_memory(valve.links, "basins")
