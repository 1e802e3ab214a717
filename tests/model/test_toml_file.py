"""Structure files: read as they are promised, written so that reading gives the same, refused with the place."""

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkwise.errors import StructureError
from linkwise.model.chains import bnes_chain
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.structure import Link, Mass, Structure
from linkwise.model.structure_file import format_structure, parse_structure, read_structure, write_structure

EXAMPLE = """\
name = "two-mass bistable chain"

[[mass]]
name = "m1"
mass = 1.0                      # kg

[[mass]]
name = "m2"
mass = "10 g"

[[link]]
name = "spring"
between = ["m1", "ground"]
law = "k*d + c*v"
coefficients = { k = "30 kN/m", c = 1 }

[[link]]
name = "nes"
between = ["m2", "m1"]
law = "alpha*d + beta*d**3 + c*v"
coefficients = { alpha = "unknown", beta = { start = "2 MN/m^3" }, c = { start = 0.02, lower = 0.0 } }

[[link]]
name = "second"
between = ["m2", "base"]
law = "alpha*d"
coefficients = { alpha = "=nes.alpha" }
"""


def test_the_file_of_the_interface_is_read() -> None:
    structure = parse_structure(EXAMPLE)
    assert structure.name == "two-mass bistable chain"
    assert structure.mass_values.tolist() == [1.0, 0.01]
    assert structure.link("spring").values == {"k": 30000.0, "c": 1.0}
    nes = structure.link("nes")
    assert nes.between == ("m2", "m1")
    assert nes.coefficients["alpha"] == Coefficient.unknown()
    assert nes.coefficients["beta"] == Coefficient.unknown(2e6)
    assert nes.coefficients["c"] == Coefficient.unknown(0.02, lower=0.0)
    assert [parameter.name for parameter in structure.parameters] == ["nes.alpha", "nes.beta", "nes.c"]
    assert structure.parameters[0].members == ((1, "alpha"), (2, "alpha"))


def test_a_mass_may_be_unknown_or_shared() -> None:
    text = EXAMPLE.replace("mass = 1.0 ", 'mass = { start = "2 kg", upper = 9 } ').replace(
        '"10 g"', '"=m1.mass"'
    )
    (mass,) = parse_structure(text).unknown("mass:m2").parameters[-1:]
    assert (mass.name, mass.start, mass.lower, mass.upper) == ("m1.mass", None, 0.0, 9.0)
    assert mass.members == ((-1, "mass"), (-2, "mass"))


@pytest.mark.parametrize(("sigma", "kilograms"), [("1e-4", 1e-4), ('"0.1 g"', 1e-4), ('"1 %"', 1e-4)])
def test_a_mass_may_be_known_to_within(sigma: str, kilograms: float) -> None:
    text = EXAMPLE.replace('mass = "10 g"', f'mass = {{ start = "10 g", sigma = {sigma} }}')
    structure = parse_structure(text)
    mass = structure.coefficient("m2.mass")
    assert (mass.value, mass.known) == (0.01, False)
    assert mass.sigma == pytest.approx(kilograms, rel=1e-12)
    assert structure.parameters[-1].sigma == mass.sigma
    assert parse_structure(format_structure(structure)) == structure


def test_what_is_written_reads_back_equal(tmp_path: Path) -> None:
    chain = bnes_chain(2)
    of_several_lines = replace(chain.link("spring1"), law=Law.parse("k*d +\n\tc*v"))
    tabbed = Structure("", chain.masses, (of_several_lines, chain.link("nes1")))
    for structure in (parse_structure(EXAMPLE), bnes_chain(10), bnes_chain(4).unknown("nes"), tabbed):
        write_structure(structure, tmp_path / "s.toml")
        assert read_structure(tmp_path / "s.toml") == structure
    (tmp_path / "s.toml").write_text(EXAMPLE, encoding="utf-8-sig")  # a byte order mark is no obstacle
    assert read_structure(tmp_path / "s.toml") == parse_structure(EXAMPLE)


def test_an_identified_structure_is_written_with_numbers_only() -> None:
    values = {"nes.alpha": -100.0, "nes.beta": 1e6, "nes.c": 0.1 + 0.2}
    identified = parse_structure(EXAMPLE).with_values(values)
    text = format_structure(identified)
    assert "unknown" not in text
    assert '"=' not in text
    assert "c = 0.30000000000000004" in text
    assert parse_structure(text) == identified


names = st.text(
    st.characters(exclude_categories=["C", "Z"], exclude_characters="[]:=/\\"), min_size=1
).filter(lambda name: name not in ("ground", "base"))
finite = st.floats(allow_nan=False, allow_infinity=False)
coefficients = st.one_of(
    st.builds(Coefficient.number, finite),
    st.just(Coefficient.unknown()),
    finite.map(lambda x: Coefficient.unknown(x, lower=x if x < 1e300 else -math.inf, upper=math.inf)),
    finite.map(lambda x: Coefficient.unknown(upper=x)),
)


@pytest.mark.slow
@settings(max_examples=40)
@given(names, names, st.text(st.characters(exclude_categories=["Cs"])), coefficients, coefficients)
def test_round_trip_is_exact(mass: str, link: str, title: str, k: Coefficient, c: Coefficient) -> None:
    """Quotes, control characters in the title, unicode, denormals, 1e308: all come back as they were."""
    only_link = Link(link, (mass, "ground"), Law.parse("k*d + c*v"), {"k": k, "c": c})
    structure = Structure(title, (Mass(mass, Coefficient.number(1e-3)),), (only_link,))
    assert parse_structure(format_structure(structure)) == structure


REFUSED = {
    "no TOML": ("mass = 1.0  ", "mass = = 1.0", "s.toml, line 5, column 8: is not valid TOML: invalid value"),
    "key twice": (
        'mass = "10 g"', 'mass = 1\nmass = 2',
        "s.toml, line 10, column 9: is not valid TOML: cannot overwrite a value",
    ),
    "bad key": ('law = "alpha*d"', 'lwa = "alpha*d"', 's.toml, link[2]: unknown key "lwa"; did you mean "law"?; the keys are'),
    "missing key": ('law = "alpha*d"', "", "s.toml, link[2]: the key `law` is missing"),
    "bad top key": (
        'name = "two', 'nmae = "two',
        's.toml: unknown key "nmae"; did you mean "name"?; the keys are name, signals, host, mass, link',
    ),
    "bad start key": (
        "{ start = 0.02", "{ strat = 0.02",
        's.toml, link[1].coefficients.c: unknown key "strat"; did you mean "start"?',
    ),
    "bad mass key": (
        'mass = "10 g"', "mass = { value = 3.0 }",
        's.toml, mass[1].mass: unknown key "value"; the keys are start, lower',
    ),
    "no table of masses": ("[[mass]]", "[[body]]", 's.toml: unknown key "body"; the keys are name, signals, host, mass, link'),
    "name that is a number": ('name = "m2"', "name = 2", "s.toml, mass[1].name: expected `str`, got `int`"),
    "mass that is true": ('mass = "10 g"', "mass = true", "s.toml, mass[1].mass: expected `float | str | object`, got `bool`"),
    "coefficient that is true": ("c = 1 }", "c = true }", "s.toml, link[0].coefficients.c: expected a number, a text such as"),
    "coefficient that is a list": ("c = 1 }", "c = [1] }", "or a table of start, lower, upper, sigma; got [1]"),
    "misspelled unknown": (
        'alpha = "unknown"', 'alpha = "unkonwn"',
        'link[1].coefficients.alpha: \'unkonwn\' cannot be read as a quantity',
    ),
    "unit of another kind": (
        'k = "30 kN/m"', 'k = "30 kg"',
        "s.toml, link[0].coefficients.k: '30 kg' is in kg: expected a number in N/m",
    ),
    "NaN": ("c = 1 }", "c = nan }", "s.toml, link[0].coefficients.c: the value of a coefficient must be a number, got nan"),
    "bounds that exclude the start": (
        "lower = 0.0 }", "lower = 1.0 }",
        "s.toml, link[1].coefficients.c: the start 0.02 is outside the bounds 1.0 to inf",
    ),
    "prior without a start": (
        "{ start = 0.02, lower = 0.0 }", "{ sigma = 0.1 }",
        "s.toml, link[1].coefficients.c: a coefficient that is known to within sigma needs a start",
    ),
    "prior of no width": (
        "{ start = 0.02, lower = 0.0 }", "{ start = 0.02, sigma = 0 }",
        "s.toml, link[1].coefficients.c: the standard deviation sigma must be positive, got 0",
    ),
    "negative mass": ('"10 g"', '"-10 g"', 's.toml, mass[1] "m2": the mass must be positive, got -0.01 kg'),
    "bad law": ('"alpha*d"', '"alpha*d +"', 's.toml, link[2] "second": invalid law: '),
    "missing coefficient": (
        '{ k = "30 kN/m", c = 1 }', '{ k = 1 }',
        's.toml, link[0] "spring": coefficients of the law k*d + c*v are missing: add c = "unknown"',
    ),
    "extra coefficient": (
        "c = 1 }", "c = 1, e = 2 }",
        's.toml, link[0] "spring": unknown coefficient e; the law k*d + c*v has the coefficients',
    ),
    "one end": ('["m2", "base"]', '["m2"]', 's.toml, link[2] "second": `between` must name two ends, got [\'m2\']'),
    "unknown end": ('["m2", "base"]', '["m3", "base"]', 's.toml, link "second": unknown end "m3"'),
    "shared with nothing": (
        "=nes.alpha", "=nes.alhpa",
        's.toml, second.alpha: "=nes.alhpa" refers to an unknown coefficient; did you mean "nes.alpha"?',
    ),
    "mass that nothing holds": (
        'name = "m2"\nmass', 'name = "m4"\nmass = 1\n[[mass]]\nname = "m2"\nmass',
        's.toml, mass "m4": no link has it as an end; add a link or remove the mass',
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_wrong_is_said_with_its_place(case: str) -> None:
    old, new, message = REFUSED[case]
    assert old in EXAMPLE
    with pytest.raises(StructureError, match=re.escape(message)):
        parse_structure(EXAMPLE.replace(old, new), "s.toml")


def test_files_that_cannot_be_read_are_said_and_a_record_is_recognised(tmp_path: Path) -> None:
    with pytest.raises(StructureError, match=r"none\.toml: there is no such file$"):
        read_structure(tmp_path / "none.toml")
    (tmp_path / "latin.toml").write_bytes('name = "Träger"'.encode("latin-1"))
    with pytest.raises(StructureError, match=r"latin\.toml: is not UTF-8 text \(byte 10\); save it as UTF-8"):
        read_structure(tmp_path / "latin.toml")
    with pytest.raises(StructureError, match=r"there is no structure\.toml in this folder"):
        read_structure(tmp_path)
    for name, content, asked in (
        ("run.csv", b"time,x:m1\n0,1\n", True),
        ("run.mat", b"MATLAB 5.0 \xff\xfe", True),
        ("chain.toml", b"mass = = 1", False),
        ("chain.toml", b"\xff", False),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(StructureError) as error:
            read_structure(tmp_path / name)
        assert ("was it exchanged with a record?" in str(error.value)) == asked
