"""Memory as a term: which link has it, by which law, and that nothing else is taken for it."""

from __future__ import annotations

import json
from typing import Any

import pytest
from structures import link, named, structure

import linkwise as lw
from linkwise.discovery.memory import MemorySelection, select_memory
from linkwise.discovery.terms import link_with_memory, memory_laws, offered_memory, plain_terms

MASSES = {"m1": 1.0, "m2": 1.2}
HYSTERETIC = {"k": 800.0, "c": 1.0, "F": 6.0, "x0": 0.004, "s": 0.6}


def pair(second: lw.Link) -> lw.Structure:
    """A mass on a linear spring, and another on it by a second link."""
    return structure(MASSES, link("m1-ground", "m1-ground", "k*d + c*v", k=2000.0, c=1.0), second)


def hysteretic() -> lw.Structure:
    return pair(named("m2-m1", "m2-m1", "bouc-wen", **HYSTERETIC))


def plain(law: str, **values: float) -> lw.Structure:
    return pair(link("m2-m1", "m2-m1", law, **values))


def noisy(subject: lw.Structure, seed: int, duration: float = 6.0) -> lw.Record:
    force = "9*sin(17*t) + 7*sin(31*t + 1) + 6*sin(53*t + 2)"
    record = lw.simulate(subject, forces={"m2": force}, duration=duration, rate=200.0, sensors=("x",))
    return record.with_noise(40.0, seed=seed)


@pytest.fixture(scope="module")
def found() -> lw.Discovery:
    """Memory that nobody offered."""
    return lw.discover(noisy(hysteretic(), 71), MASSES)


def test_finds_the_link_that_has_memory(found: lw.Discovery) -> None:
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
    for name, value in HYSTERETIC.items():
        coefficient = found.estimate.coefficient(f"m2-m1.{name}")
        error = coefficient.standard_error
        assert error is not None and abs(coefficient.value - value) < 5.0 * error  # chance: 3e-6 each


@pytest.mark.parametrize(
    ("law", "values", "seed"),
    [
        ("bouc-wen", {**HYSTERETIC, "F": 0.6}, 75),
        ("zener", {"k": 800.0, "k1": 60.0, "c1": 2.0}, 76),
    ],
    ids=["slip", "relaxation"],
)
def test_finds_a_small_memory_by_what_it_leaves(law: str, values: dict[str, float], seed: int) -> None:
    """It leaves 1.6 or 0.6 % of the forces: too little to try laws on every link, but the residuals show which."""
    found = lw.discover(noisy(pair(named("m2-m1", "m2-m1", law, **values)), seed), MASSES)
    kept = [(each.link, each.law, each.certain) for each in found.memory if each.kept]
    assert kept == [("m2-m1", law, True)] and found.trusted
    assert {link.name for link in found.structure.links} == {"m1-ground", "m2-m1"}


def test_says_so_in_text_and_data(found: lw.Discovery) -> None:
    text = str(found)
    assert "m2-m1 has memory: bouc-wen." in text and "of memory" in text
    (plain_data,) = json.loads(json.dumps(lw.report.discovery_of(found)["memory"]))
    assert plain_data["link"] == "m2-m1" and plain_data["decision"] == "certain"
    assert plain_data["coefficients"] == ["m2-m1.F", "m2-m1.s", "m2-m1.x0"]


def test_draws_a_link_with_memory(found: lw.Discovery) -> None:
    assert lw.plot.graph(found).get_title("left")


def test_takes_memory_into_a_stated_link() -> None:
    known = structure(MASSES, link("leg", "m1-ground", "k*d + c*v"), link("joint", "m2-m1", "k*d + c*v"))
    found = lw.discover(noisy(hysteretic(), 72), known, terms="linear, bouc-wen")
    assert [(each.link, each.certain) for each in found.memory] == [("joint", True)] and found.trusted
    assert found.memory[0].coefficients == ("joint.F", "joint.s", "joint.x0")
    assert found.structure.link("joint").law.text == "k*d + c*v + F*z"


def test_does_not_take_a_missing_form_for_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """The selection refuses it: memory leaves more than noise there."""
    selected: list[MemorySelection | None] = []

    def recorded(*arguments: Any) -> MemorySelection | None:
        selected.append(select_memory(*arguments))
        return selected[-1]

    monkeypatch.setattr("linkwise.discovery.discover.select_memory", recorded)
    found = lw.discover(
        noisy(plain("k*d + c*v + k3*d**3", k=800.0, c=1.0, k3=4e5), 73, 2.5), MASSES, terms="linear"
    )
    assert selected == [None]
    assert not found.trusted and not any(each.certain for each in found.memory)


def test_says_that_no_memory_was_found() -> None:
    found = lw.discover(noisy(plain("k*d + c*v", k=800.0, c=1.0), 74, 3.0), MASSES, terms="linear, zener")
    assert found.trusted and found.memory == ()
    assert any("no memory was found" in remark for remark in found.remarks)


def test_records_without_memory_do_not_enter_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("linkwise.discovery.discover.select_memory", None)
    assert lw.discover(noisy(plain("k*d + c*v", k=800.0, c=1.0), 75), MASSES).trusted


def test_terms_beside_states_are_candidates() -> None:
    assert [term.text for term in lw.discovery.parse_terms("bouc-wen")] == ["d", "v"]
    assert offered_memory("cubic, bouc-wen, iwan(3), friction") == ("bouc-wen", "iwan(3)")
    assert offered_memory("linear, stribeck") == ()  # a family of terms, and a law without memory


@pytest.mark.parametrize("name", memory_laws())
def test_parts_with_memory_have_units(name: str) -> None:
    link = link_with_memory("joint", ("a", "b"), name, {"k", "c"})
    assert link.law.units and not {"k", "c"} & set(link.law.coefficients)
    assert all(term in ("d", "v") for term in plain_terms(name))


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
