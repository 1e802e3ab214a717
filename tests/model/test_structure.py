"""The structure: what it accepts, what it refuses and in which words, sharing, incidence."""

import copyreg
import math
import pickle
import re
from collections.abc import Callable
from types import MappingProxyType

import numpy as np
import pytest
from present import present, some

from linkwise.errors import StructureError
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.structure import BASE, GROUND, Link, Mass, Structure

NUMBER, UNKNOWN, SHARED = Coefficient.number, Coefficient.unknown, Coefficient.shared


def spring(name: str, first: str, second: str, **coefficients: Coefficient) -> Link:
    """A spring with a damper, "k*d + c*v", of 100 N/m and 2 N s/m unless told otherwise."""
    return Link(
        name, (first, second), Law.parse("k*d + c*v"), {"k": NUMBER(100.0), "c": NUMBER(2.0), **coefficients}
    )


def mass(name: str, kilograms: float = 1.0) -> Mass:
    return Mass(name, NUMBER(kilograms))


def pair(k1: Coefficient, k2: Coefficient) -> Structure:
    """Two masses in a row above the ground, the stiffnesses given."""
    return Structure(
        "pair", (mass("a"), mass("b")), (spring("low", "a", GROUND, k=k1), spring("high", "b", "a", k=k2))
    )


@pytest.fixture
def mixed() -> Structure:
    """Three masses; links to ground, mass and base in both directions; one sharing, one unknown with bounds."""
    return Structure(
        "mixed",
        (mass("m1"), mass("m2", 2.0), Mass("m3", UNKNOWN(0.5))),
        (
            spring("s1", "m1", GROUND, k=UNKNOWN(50.0, lower=0.0), c=NUMBER(3.0)),
            spring("s2", "m2", "m1", k=SHARED("s1.k")),
            spring("s3", BASE, "m3", k=SHARED("s2.k"), c=UNKNOWN()),
            spring("s4", "m3", BASE),
        ),
    )


def test_incidence_has_the_sign_of_every_end_and_elongations_are_first_less_second(mixed: Structure) -> None:
    np.testing.assert_array_equal(mixed.incidence.toarray(), [[1, -1, 0, 0], [0, 1, 0, 0], [0, 0, -1, 1]])
    np.testing.assert_array_equal(mixed.base_incidence, [0, 0, 1, -1])
    x, base = np.array([[1.0, 2.0, 4.0], [0.5, 0.0, -1.0]]), np.array([10.0, 0.25])
    expected = [[1.0, 1.0, 6.0, -6.0], [0.5, -0.5, 1.25, -1.25]]
    d = mixed.elongations(x, base)
    np.testing.assert_array_equal(d, expected)
    assert d.flags.c_contiguous
    np.testing.assert_array_equal(mixed.elongations(x[0], 10.0), expected[0])
    message = r'"s3": has the base as an end, but the motion of the base is not'
    with pytest.raises(StructureError, match=message):
        mixed.elongations(np.zeros((4, 3)))
    with pytest.raises(StructureError, match=r"^x must have the shape \(N, 3\) or \(3,\), got \(4, 2\)$"):
        mixed.elongations(np.zeros((4, 2)), np.zeros(4))


def test_sharing_resolves_and_counts_once(mixed: Structure) -> None:
    assert [parameter.name for parameter in mixed.parameters] == ["s1.k", "s3.c", "m3.mass"]
    first, _, weight = mixed.parameters
    assert first.members == ((0, "k"), (1, "k"), (2, "k"))
    assert (first.unit, first.start, first.lower, first.upper) == ("N/m", 50.0, 0.0, math.inf)
    assert (weight.members, weight.unit, weight.lower) == (((-3, "mass"),), "kg", 0.0)
    assert mixed.coefficient("s3.k") == UNKNOWN(50.0, lower=0.0)
    assert mixed.link("s3").coefficients["k"].value == 50.0


def test_filling_in_unknowns_gives_numbers_and_a_changed_value_keeps_sharing(mixed: Structure) -> None:
    filled = mixed.with_values({"s1.k": 70.0, "s3.c": 0.5, "m3.mass": 0.4})
    assert filled.parameters == ()
    assert [link.values["k"] for link in filled.links] == [70.0, 70.0, 70.0, 100.0]
    coefficients = [c for link in filled.links for c in link.coefficients.values()]
    assert all(c == NUMBER(present(c.value)) for c in some(coefficients))
    np.testing.assert_array_equal(filled.mass_values, [1.0, 2.0, 0.4])
    assert mixed.coefficient("s1.k").value == 50.0, "the structure itself must not change"
    changed = pair(NUMBER(5.0), SHARED("low.k")).with_values({"high.k": 6.0})
    assert [link.values["k"] for link in changed.links] == [6.0, 6.0]
    assert changed.link("high").coefficients["k"].same_as == "low.k"


MANY = Structure(
    "", tuple(mass(f"m{i}") for i in range(20)), tuple(spring(f"s{i}", f"m{i}", GROUND) for i in range(20))
)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda mixed: mixed.with_values({"s1.kk": 1.0}), r'"s1.kk"; did you mean "s1.k"\?; the coefficients are "s1.k"'),
        (lambda mixed: mixed.unit_of("m3"), r'unknown coefficient "m3"; did you mean "m3.mass"\?'),
        (lambda mixed: mixed.with_values({"s1.k": 1.0, "s2.k": 2.0}),
         r's2.k: is equal to "s1.k", for which another value is given'),
        (lambda mixed: mixed.with_values({"s1.k": math.nan}), r"s1.k: the value of a coefficient must be a number, got nan"),
        (lambda mixed: mixed.with_values({"m3.mass": -1.0}), r'mass "m3": the mass must be positive, got -1.0 kg'),
        (lambda mixed: mixed.unknown("nes"),
         r'"nes" is not a link, a prefix of link names or a coefficient; the links are "s1", "s2", "s3", "s4"'),
        (lambda mixed: mixed.unknown(), r"expected at least one of"),
        (lambda mixed: mixed.unknown("mass:m4"), r'unknown mass "m4".*; the masses are "m1", "m2", "m3"'),
        (lambda mixed: mixed.link("s44"), r'unknown link "s44"; did you mean "s4"\?; the links are "s1", "s2"'),
        (lambda mixed: MANY.link("zzz"), r'"s8", "s9", \.\.\., "s19"$'),
    ],
)  # fmt: skip
def test_unknown_names_list_others(
    mixed: Structure, ask: Callable[[Structure], object], message: str
) -> None:
    with pytest.raises(StructureError, match=message):
        ask(mixed)


@pytest.mark.parametrize(
    ("which", "free"),
    [
        (("all",), {"s1.k", "s1.c", "s2.c", "s3.c", "s4.k", "s4.c", "m3.mass"}),
        (("s4",), {"s1.k", "s3.c", "s4.k", "s4.c", "m3.mass"}),
        (("s4.c", "mass:m1"), {"s1.k", "s3.c", "s4.c", "m1.mass", "m3.mass"}),
        (("s.c",), {"s1.k", "s1.c", "s2.c", "s3.c", "s4.c", "m3.mass"}),
    ],
)
def test_unknown_chooses_by_name_and_mass(mixed: Structure, which: tuple[str, ...], free: set[str]) -> None:
    assert {parameter.name for parameter in mixed.unknown(*which).parameters} == free


def test_unknown_leaks_neither_value_nor_start_but_keeps_bounds(mixed: Structure) -> None:
    freed = mixed.unknown("s1", "s3", "s4", "mass:m3")
    assert all(parameter.start is None for parameter in some(freed.parameters))
    assert freed.coefficient("s1.k").lower == 0.0
    with pytest.raises(StructureError, match=r'link "s1": coefficient k is unknown and has no start value'):
        _ = freed.link("s1").values
    with pytest.raises(StructureError, match=r'mass "m3": is unknown and has no start value'):
        _ = freed.mass_values


def test_unknown_frees_the_leader_of_a_shared_coefficient_and_an_exact_name_is_no_beginning() -> None:
    freed = pair(NUMBER(5.0), SHARED("low.k")).unknown("high")
    assert {parameter.name for parameter in freed.parameters} == {"low.k", "high.c"}
    links = (spring("nes1", "a", GROUND), spring("nes10", "a", GROUND))
    freed = Structure("", (mass("a"),), links).unknown("nes1")
    assert {parameter.name for parameter in freed.parameters} == {"nes1.k", "nes1.c"}


def test_structures_compare_hash_and_pickle_and_cannot_be_changed(mixed: Structure) -> None:
    again = pickle.loads(pickle.dumps(mixed))
    assert again == mixed
    assert hash(again) == hash(mixed)
    assert mixed != mixed.unknown("s4")
    link = Link("s", ("a", GROUND), Law.parse("k*d + c*v"), {"c": NUMBER(1.0), "k": NUMBER(2.0)})
    assert list(link.coefficients) == ["k", "c"]
    with pytest.raises(TypeError):
        link.coefficients["k"] = NUMBER(3.0)  # type: ignore[index]
    assert type(pickle.loads(pickle.dumps(link)).coefficients) is MappingProxyType
    assert MappingProxyType not in copyreg.dispatch_table  # whose pickles are not ours to define


A, B = mass("a"), mass("b")
LOW = spring("low", "a", GROUND)
LAW = Law.parse("k*d + c*v")

REFUSED: dict[str, tuple[Callable[[], object], str]] = {
    "no mass at all": (lambda: Structure("", (), ()), "a structure needs at least one mass"),
    "zero mass": (lambda: mass("a", 0.0), 'mass "a": the mass must be positive, got 0.0 kg'),
    "mass that is NaN": (lambda: mass("a", math.nan), "the value of a coefficient must be a number, got nan"),
    "infinite mass": (lambda: mass("a", math.inf), "a coefficient must be a finite number, got inf"),
    "negative start of a mass": (lambda: Mass("a", UNKNOWN(-1.0)),
        'mass "a": the start of the unknown mass must be positive, got -1.0 kg'),
    "mass bounded to nothing": (lambda: Mass("a", UNKNOWN(upper=-1.0)),
        'mass "a": the upper bound must be positive, got -1.0 kg'),
    "number that is true": (lambda: NUMBER(True), "the value of a coefficient must be a number, got True"),
    "number that is a word": (lambda: NUMBER("ten"),  # type: ignore[arg-type]
        "the value of a coefficient must be a number, got 'ten'"),
    "known without value": (lambda: Coefficient(None, True), 'a known coefficient needs a value; write "unknown" if'),
    "bounds upside down": (lambda: UNKNOWN(lower=2.0, upper=1.0), "the lower bound 2.0 must be below the upper bound 1.0"),
    "reserved name": (lambda: mass("ground"), 'mass: "ground" is reserved as an end of links'),
    "empty name": (lambda: mass(""), "mass: a mass needs a name, got ''"),
    "name with a bracket": (lambda: mass("m[1]"), "mass: 'm[1]' is not a valid name"),
    "name of a path": (lambda: spring("../s", "a", GROUND), "link: '../s' is not a valid name"),
    "two masses of a name": (lambda: Structure("", (A, A), (LOW,)),
        'mass "a": the name is used 2 times; names must be unique'),
    "two links of a name": (lambda: Structure("", (A,), (LOW, LOW)),
        'link "low": the name is used 2 times; names must be unique'),
    "link to itself": (lambda: spring("low", "a", "a"), 'link "low": both ends are "a"; a link needs two different ends'),
    "ground to base": (
        lambda: Structure("", (A,), (LOW, spring("rig", BASE, GROUND))),
        'link "rig": at least one end must be a mass, got "base" and "ground"; a link between these needs a structure '
        "without masses, a rig",
    ),
    "unknown end": (lambda: Structure("", (A, mass("beam")), (LOW, spring("up", "baem", "a"))),
        'link "up": unknown end "baem"; did you mean "beam"?; an end is "ground", "base" or one of the masses "a", "beam"'),
    "missing coefficient": (lambda: Link("low", ("a", GROUND), LAW, {"k": NUMBER(1.0)}),
        'link "low": coefficients of the law k*d + c*v are missing: add c = "unknown" (or a number)'),
    "extra coefficient": (lambda: spring("low", "a", GROUND, kk=NUMBER(1.0)),
        'link "low": unknown coefficient kk; the law k*d + c*v has the coefficients k, c; did you mean "k"?'),
    "shared in a circle": (lambda: pair(SHARED("high.k"), SHARED("low.k")),
        "low.k: circular sharing, low.k = high.k = low.k: give one of them a number"),
    "shared with itself": (lambda: pair(SHARED("low.k"), NUMBER(1.0)), "circular sharing, low.k = low.k"),
    "shared across units": (lambda: pair(NUMBER(1.0), SHARED("low.c")),
        'high.k: is in N/m and cannot be equal to "low.c" in N s/m'),
    "full name used twice": (
        lambda: Structure("", (A,), (Link("a", ("a", GROUND), Law.parse("mass*d"), {"mass": NUMBER(1.0)}),)),
        '"a.mass" names both a mass and a coefficient of a link; rename the mass or the link'),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_is_refused_in_words(case: str) -> None:
    build, message = REFUSED[case]
    with pytest.raises(StructureError, match=re.escape(message)):
        build()
