"""Structures from short texts: what is not known is unknown, and what a text does not say is refused with its place."""

from typing import Any

import pytest

import linkwise as lw

MASSES: dict[str, Any] = {"frame": 1.8, "sink": "120 g"}
LINKS = {"leaf": "frame - ground: k*d + c*v", "nes": "sink - frame: alpha*d + beta*d**3 + c*v"}


def test_a_rig_is_what_its_file_says() -> None:
    file = """
    name = "rig"
    mass = [{ name = "frame", mass = 1.8 }, { name = "sink", mass = "120 g" }]
    [[link]]
    name = "leaf"
    between = ["frame", "ground"]
    law = "k*d + c*v"
    coefficients = { k = { start = "30 N/mm", lower = 0.0 }, c = 1.6 }
    [[link]]
    name = "nes"
    between = ["sink", "frame"]
    law = "alpha*d + beta*d**3 + c*v"
    coefficients = { alpha = "unknown", beta = "unknown", c = "=leaf.c" }
    """
    known: dict[str, Any] = {"leaf.c": 1.6, "leaf.k": {"start": "30 N/mm", "lower": 0.0}, "nes.c": "=leaf.c"}
    assert lw.rig(MASSES, LINKS, known) == lw.parse_structure(file)


def test_what_turns_and_named_laws_are_read() -> None:
    turning = lw.rig(
        {"disc": "20 g m^2"}, {"shaft": "disc - ground: k*d", "joint": "disc - ground: bouc-wen"}
    )
    assert turning.rotations == ("disc",) and turning.unit_of("shaft.k") == "N m/rad"
    assert turning.link("joint").law.states and not turning.coefficient("joint.F").known
    assert lw.rig({"m 1": "unknown"}, {"a-b": "m 1  -  base:k*d"}).link("a-b").between == ("m 1", "base")


@pytest.mark.parametrize(
    ("masses", "links", "known", "message"),
    [
        (MASSES, {"leaf": "frame: k*d"}, {}, 'expected "FIRST - SECOND: LAW", such as "sink - frame: k*d + c*v", got'),
        (MASSES, {"leaf": "frame - ground: k*(d"}, {}, "invalid law"),
        (MASSES, LINKS, {"nes.alfa": 1.0}, 'is not a coefficient of this rig; did you mean "nes.alpha"?; they are leaf.k'),
        (MASSES, LINKS, {"leaf.k": "30 N"}, "rig, link[0].coefficients.k"),
        ({"frame": "120"}, {"leaf": LINKS["leaf"]}, {}, "rig, mass[0].mass"),
        (MASSES, {"leaf": "frame - grund: k*d"}, {}, 'unknown end "grund"; did you mean "ground"?'),
    ],
)  # fmt: skip
def test_what_a_text_does_not_say_is_refused(
    masses: dict[str, Any], links: dict[str, str], known: dict[str, Any], message: str
) -> None:
    with pytest.raises(lw.StructureError) as error:
        lw.rig(masses, links, known)
    assert message in str(error.value)


def test_links_and_masses_of_texts_print_as_they_are_made() -> None:
    for made in (
        lw.Link("leaf", ("frame", "ground"), "k*d + c*v", {"k": "30 N/mm", "c": "unknown"}),
        lw.Link("leaf", ("frame", "ground"), "k*z", {"k": "=a.k", "s": lw.Coefficient.unknown(0.5)}, {"z": "v - z/s"}),
        lw.Mass("sink", "120 g"),
        lw.Mass("disc", "20 g m^2", unit="rad"),
        lw.Coefficient.unknown(2.0, upper=3.0, sigma=0.1),
        lw.Law.parse("k*z", {"z": "v"}),
    ):  # fmt: skip
        text = repr(made)
        names = {"Link": lw.Link, "Mass": lw.Mass, "Coefficient": lw.Coefficient, "Law": lw.Law}
        assert eval(text, names) == made and len(text) < 200
    with pytest.raises(lw.StructureError, match='link "leaf", coefficient k'):
        lw.Link("leaf", ("frame", "ground"), "k*d", {"k": "30 kg"})
    with pytest.raises(lw.StructureError, match='mass "sink"'):
        lw.Mass("sink", "120 mm")
