"""Structures from short texts, the chains of the paper, and signals in laws."""

from typing import Any

import numpy as np
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


@pytest.mark.parametrize("n", [2, 4, 10])
def test_defaults_are_table_1(n: int) -> None:
    chain = lw.bnes_chain(n)
    assert chain.mass_names == tuple(f"m{i}" for i in range(1, n + 1))
    np.testing.assert_array_equal(chain.mass_values, np.tile([1.0, 0.01], n // 2))
    assert [link.name for link in chain.links] == [
        f"{kind}{i}" for i in range(1, n // 2 + 1) for kind in ("spring", "nes")
    ]
    for cell in range(1, n // 2 + 1):
        spring, sink = chain.link(f"spring{cell}"), chain.link(f"nes{cell}")
        assert spring.between == (f"m{2 * cell - 1}", f"m{2 * cell - 3}" if cell > 1 else "ground")
        assert sink.between == (f"m{2 * cell}", f"m{2 * cell - 1}")
        assert spring.values == {"k": 30000.0, "c": 1.0}
        assert sink.values == {"alpha": -100.0, "beta": 1e6, "c": 0.02}


def test_forces_are_equation_1_for_four_masses() -> None:
    """M x'' = -B f against Eq. (1) written out, at a random state."""
    rng = np.random.default_rng(4)
    x, v = 0.02 * rng.standard_normal(4), rng.standard_normal(4)
    chain = lw.bnes_chain(4)
    d, rate = chain.elongations(x), chain.elongations(v)
    ours = chain.incidence @ [float(link.force(d[i], rate[i])) for i, link in enumerate(chain.links)]

    def sink(i: int, j: int) -> float:
        return float(-100.0 * (x[i] - x[j]) + 1e6 * (x[i] - x[j]) ** 3 + 0.02 * (v[i] - v[j]))

    paper = [
        1.0 * v[0] + 30000.0 * x[0] + sink(0, 1) + 1.0 * (v[0] - v[2]) + 30000.0 * (x[0] - x[2]),
        sink(1, 0),
        1.0 * (v[2] - v[0]) + 30000.0 * (x[2] - x[0]) + sink(2, 3),
        sink(3, 2),
    ]
    np.testing.assert_allclose(ours, paper, rtol=1e-12)


@pytest.mark.parametrize(
    ("masses", "given", "message"),
    [
        (3, {}, r"the number of masses must be even and at least 2, .* got 3"),
        (0, {}, r"the number of masses must be even and at least 2, .* got 0"),
        (-2, {}, r"the number of masses must be even and at least 2, .* got -2"),
        (4.0, {}, r"the number of masses must be an integer, got 4.0"),
        (4, {"sink_mass": 0.0}, r'mass "m2": the mass must be positive, got 0.0 kg'),
    ],
)  # fmt: skip
def test_what_is_no_chain_is_refused(masses: int, given: dict[str, Any], message: str) -> None:
    with pytest.raises(lw.StructureError, match=message):
        lw.bnes_chain(masses, **given)


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
