"""Links with memory: states as text, their units, the structure file, named laws, and what refuses them."""

import numpy as np
import pytest

import linkwise as lw

JOINT = """
[[mass]]
name = "m1"
mass = 1.0

[[link]]
name = "joint"
between = ["m1", "ground"]
law = "k*d + c*v + F*z"
states = { z = "(v - s*abs(v)*z - (1 - s)*v*abs(z))/x0" }
coefficients = { k = 1e3, c = 0.5, F = "20 N", x0 = "1 mm", s = 0.6 }
"""
PIEZO = """
[[mass]]
name = "m1"
mass = "10 g"

[[link]]
name = "piezo"
between = ["m1", "base"]
law = "alpha*d + beta*d**3 + c*v - theta*V"
states = { V = STATE }
coefficients = { alpha = "unknown", beta = "unknown", c = "unknown", theta = "unknown", R = "100 kohm", C = "43 nF" }
"""
RATE = "(-theta*v - V/R)/C"


def piezo(state: str) -> lw.Link:
    return lw.parse_structure(PIEZO.replace("STATE", state)).link("piezo")


def test_units_follow_through_the_rates() -> None:
    """Electrical ones from one coefficient or from the state; without any the unit of a voltage is open."""
    link = lw.parse_structure(JOINT).link("joint")
    assert dict(link.law.units) == {"k": "N/m", "c": "N s/m", "F": "N", "s": "", "x0": "m"}
    assert dict(link.law.state_units) == {"z": ""}
    assert link.coefficients["x0"].value == 1e-3
    for state in (f'"{RATE}"', f'{{ rate = "{RATE}", unit = "V" }}'):
        link = piezo(state)
        assert link.law.state_units["V"] == "V"
        assert link.law.units["theta"] == "N/V" and link.law.units["C"] == "F"
        assert link.coefficients["C"].value == pytest.approx(43e-9, rel=1e-12)
    law = lw.Law.parse("k*d - theta*V", {"V": RATE})
    assert law.state_units["V"] == "?" and law.units["k"] == "N/m"


@pytest.mark.parametrize(
    ("law", "rate", "message", "position"),
    [
        ("F*z", "v - abs(v)*z/x0 + d*z/x0", "must be in the unit of 'v'", 18),
        ("z + k*d", "v - abs(v)*z", "must be in the unit of z per second", 0),  # z is in N, not in m
        ("F*z", "v*(", "empty", 2),
        ("F*z", "t*v", "Unknown variable 't'", 0),
        ("F*z", "v/d*z", "Division by zero", 2),
    ],
)
def test_rates_that_disagree_are_refused(law: str, rate: str, message: str, position: int) -> None:
    with pytest.raises(lw.LawError, match=message) as error:
        _ = lw.Law.parse(law, {"z": rate}).units
    assert (error.value.text, error.value.position) == (rate, position)


def test_a_stated_unit_that_the_rates_exclude_is_refused() -> None:
    with pytest.raises(lw.LawError, match="No units of the coefficients are consistent"):
        _ = lw.Law.parse("k*d + q", {"q": lw.model.LinkState("k*(v - q/c)", unit="V")}).units
    with pytest.raises(lw.StructureError, match="invalid law: No units"):
        lw.parse_structure(PIEZO.replace("STATE", f'"{RATE}"').replace("100 kohm", "100 N"))


@pytest.mark.parametrize(
    ("name", "message"),
    [("d", "the elongation"), ("abs", "a function"), ("2z", "not a valid name"), ("t", "time")],
)
def test_names_that_laws_use_are_refused(name: str, message: str) -> None:
    with pytest.raises(lw.StructureError, match=message):
        lw.Law.parse("k*d", {name: "v"})


@pytest.mark.parametrize("initial", ["0.25", '"unknown"', '"0.5 V"'])
def test_initial_values_survive_the_file(initial: str) -> None:
    text = PIEZO.replace("STATE", f'{{ rate = "{RATE}", initial = {initial}, unit = "V" }}')
    structure = lw.parse_structure(text)
    assert lw.parse_structure(lw.model.format_structure(structure)) == structure
    state = structure.link("piezo").states["V"]
    assert isinstance(state, lw.model.LinkState)
    assert state.initial == {"0.25": 0.25, '"unknown"': None, '"0.5 V"': 0.5}[initial]


def test_a_table_of_a_state_is_decoded_strictly_and_an_unknown_initial_value_is_asked_for() -> None:
    with pytest.raises(lw.StructureError, match=r"states.V, unknown key .start|unknown key .start"):
        piezo(f'{{ rate = "{RATE}", start = 1.0 }}')
    with pytest.raises(lw.StructureError, match=r"link\[0\]\.states\.V: expected a rate as text or a table"):
        piezo("3.0")
    link = piezo(f'{{ rate = "{RATE}", initial = "unknown" }}')
    with pytest.raises(lw.StructureError, match=r"value of state V is unknown.*release state:piezo.V"):
        link.initial_state("V")


@pytest.mark.parametrize("name", lw.model.NAMED_LAWS)
def test_every_named_law_is_consistent_and_complete(name: str) -> None:
    named = lw.model.named_law(name)
    link = named.link("link", ("m1", "ground"))
    assert set(link.law.coefficients) == set(named.coefficients) >= set(named.bounds or {})
    assert "?" not in {*link.law.units.values(), *link.law.state_units.values()}
    assert named.title and named.source
    if named.wider:  # takes every motion of this law, and has no bounds
        wider = lw.model.named_law(named.wider)
        assert wider.states.keys() == named.states.keys() and not wider.bounds


def bouc_wen(coefficients: str) -> lw.Structure:
    return lw.parse_structure(
        'mass = [{ name = "m1", mass = 1.0 }]\n[[link]]\nname = "joint"\nbetween = ["m1", "ground"]\n'
        f'law = "bouc-wen"\ncoefficients = {{ {coefficients} }}'
    )


def bounds(structure: lw.Structure) -> dict[str, tuple[float, float]]:
    return {parameter.name: (parameter.lower, parameter.upper) for parameter in structure.parameters}


@pytest.mark.parametrize("given", ["0.7", '"unknown"', "{ start = 0.7 }", "{ start = 0.7, lower = -1 }"])
def test_bounds_of_a_named_law_hold_for_what_is_given(given: str) -> None:
    """Also after a number was written with the text of the law, and is made unknown from there."""
    written = bouc_wen(f"s = {given}, x0 = 0.02")
    unknown = lw.parse_structure(lw.model.format_structure(written)).unknown("all")
    assert bounds(unknown)["joint.s"] == (-1.0 if "lower" in given else 0.0, 1.0)
    assert bounds(unknown)["joint.x0"] == (0.0, np.inf)
    assert bounds(unknown)["joint.F"] == (-np.inf, np.inf)


def test_families_take_a_number_of_branches_and_have_bounds() -> None:
    link = lw.model.named_law("iwan(3)").link("joint", ("m1", "ground"), {"chi": lw.Coefficient.number(-0.5)})
    structure = lw.Structure("joint", (lw.Mass("m1", lw.Coefficient.number(1.0)),), (link,))
    assert bounds(structure.unknown("all"))["joint.chi"] == (-1.0, 0.0)
    assert [len(lw.model.named_law(name).states) for name in ("iwan(3)", "fractional(8)")] == [4, 8]
    for name, message in (("iwan(99)", "1 to 16"), ("dahl(2)", "no branches"), ("bouc-wenn", "did you mean")):
        with pytest.raises(lw.StructureError, match=message):
            lw.model.named_law(name)


@pytest.mark.parametrize("door", ["weak", "sindy", "discovery"])
def test_what_does_not_take_memory_says_so(door: str) -> None:
    time, structure = np.arange(200) / 100.0, lw.parse_structure(JOINT)
    record = lw.Record(start=0.0, rate=100.0, channels=("x:m1",), values=np.sin(9.0 * time)[:, None])
    with pytest.raises(lw.StructureError, match=rf"joint.*memory \(state z\).*not supported in.*{door}"):
        if door == "discovery":
            lw.discover(record, structure)
        else:
            lw.identify(record, structure.unknown("joint.k"), method=door)  # type: ignore[arg-type]


@pytest.mark.parametrize("law", ["k*d", "2*k*d + q"])
def test_states_of_another_link_that_the_law_does_not_take_are_refused(law: str) -> None:
    """They were left out without a word."""
    joint = lw.parse_structure(JOINT).link("joint")
    own = {"q": "v - q"} if "q" in law else {}
    with pytest.raises(lw.StructureError, match=r"coefficients of the law .* are missing"):
        lw.Link("spring", ("m1", "ground"), lw.Law.parse(law, own), {"k": 1.0}, states=joint.states)
