"""Memory as a term: which link has it, by which law, and that nothing else is taken for it."""

import json

import pytest
from structures import HARDENING, link, named, structure
from within import assert_within, of

import linkwise as lw

MASSES = {"m1": 1.0, "m2": 1.2}
HYSTERETIC = {"k": 800.0, "c": 1.0, "F": 6.0, "x0": 0.004, "s": 0.6}


def pair(second: lw.Link) -> lw.Structure:
    """A mass on a linear spring, and another on it by a second link."""
    return structure(MASSES, link("m1-ground", "m1-ground", "k*d + c*v", k=2000.0, c=1.0), second)


def hysteretic() -> lw.Structure:
    return pair(named("m2-m1", "m2-m1", "bouc-wen", **HYSTERETIC))


def plain(law: str, **values: float) -> lw.Structure:
    return pair(link("m2-m1", "m2-m1", law, **values))


def noisy(subject: lw.Structure, seed: int, duration: float = 4.0) -> lw.Record:
    force = "9*sin(17*t) + 7*sin(31*t + 1) + 6*sin(53*t + 2)"
    record = lw.simulate(subject, forces={"m2": force}, duration=duration, rate=200.0, sensors=("x",))
    return record.with_noise(40.0, seed=seed)


@pytest.mark.slow
def test_finds_the_link_that_has_memory() -> None:
    """That nobody offered."""
    found = lw.discover(noisy(hysteretic(), 71), MASSES)
    assert {link.name: link.law.text for link in found.structure.links} == {
        "m1-ground": "k*d + c*v",
        "m2-m1": "k*d + c*v + F*z",
    }
    kept, *others = found.memory
    assert (kept.link, kept.law, kept.decision, others) == (
        "m2-m1",
        "bouc-wen",
        lw.discovery.Decision.CERTAIN,
        [],
    )
    assert found.trusted
    assert_within(found.estimate, of("m2-m1", HYSTERETIC), 5.0)
    text = str(found)
    assert "m2-m1 has memory: bouc-wen." in text and "of memory" in text
    (told,) = json.loads(json.dumps(lw.report.result_of(found)["memory"]))
    assert told["link"] == "m2-m1" and told["decision"] == "certain"
    assert told["coefficients"] == ["m2-m1.F", "m2-m1.s", "m2-m1.x0"]
    assert lw.plot.graph(found).get_title("left")


@pytest.mark.slow
def test_finds_a_small_memory_by_what_it_leaves() -> None:
    """It leaves 0.6 % of the forces: too little to try laws on every link, but the residuals show which."""
    joint = named("m2-m1", "m2-m1", "zener", k=800.0, k1=60.0, c1=2.0)
    found = lw.discover(noisy(pair(joint), 76), MASSES)
    kept = [(each.link, each.law, each.certain) for each in found.memory if each.kept]
    assert kept == [("m2-m1", "zener", True)] and found.trusted
    assert {link.name for link in found.structure.links} == {"m1-ground", "m2-m1"}


@pytest.mark.slow
def test_takes_memory_into_a_stated_link() -> None:
    true = structure({"m2": 1.2}, named("joint", "m2-ground", "bouc-wen", **HYSTERETIC))
    known = structure({"m2": 1.2}, link("joint", "m2-ground", "k*d + c*v"))
    found = lw.discover(noisy(true, 72, 3.0), known, terms="linear, bouc-wen")
    assert [(each.link, each.certain) for each in found.memory] == [("joint", True)] and found.trusted
    assert found.memory[0].coefficients == ("joint.F", "joint.s", "joint.x0")
    assert found.structure.link("joint").law.text == "k*d + c*v + F*z"


@pytest.mark.slow
def test_says_that_no_memory_was_found() -> None:
    found = lw.discover(noisy(plain("k*d + c*v", k=800.0, c=1.0), 74, 3.0), MASSES, terms="linear, zener")
    assert found.trusted and found.memory == ()
    assert any("no memory was found" in remark for remark in found.remarks)


@pytest.mark.slow
def test_does_not_take_a_missing_form_for_memory() -> None:
    cubic = structure({"m2": 1.2}, link("m2-ground", "m2-ground", HARDENING, k=800.0, c=1.0, k3=4e5))
    found = lw.discover(noisy(cubic, 73, 2.5), {"m2": 1.2}, terms="linear")
    assert not found.trusted and not any(memory.certain for memory in found.memory)


def test_terms_beside_states_are_candidates() -> None:
    assert [term.text for term in lw.discovery.parse_terms("bouc-wen")] == ["d", "v"]


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ("linear, boucwen", "laws with memory bouc-wen"),
        ("linear, piezo", "electrical state"),
        ("linear, iwan(99)", "1 to 16 branches"),
    ],
)
def test_refuses_names_that_it_does_not_know(terms: str, message: str) -> None:
    with pytest.raises(lw.LinkwiseError, match=message):
        lw.discovery.parse_terms(terms)


@pytest.mark.parametrize(
    "options",
    [
        lw.discovery.DiscoveryOptions(terms="linear, bouc-wen", ambient=["m1"]),
        lw.discovery.DiscoveryOptions(terms="linear, bouc-wen", delays=["x:m2"]),
        lw.discovery.DiscoveryOptions(terms="linear, bouc-wen", admit=["delay"]),
    ],
)
def test_refuses_memory_beside_what_it_does_not_count(options: lw.discovery.DiscoveryOptions) -> None:
    record = noisy(plain("k*d + c*v", k=800.0, c=1.0), 76)
    with pytest.raises(lw.IdentificationError, match="laws with memory"):
        lw.discover(record, MASSES, options)
