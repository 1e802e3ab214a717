"""Discovery where no combination of the terms on offer is the true law: the structure is right, and the error is told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy
from problems import chain_record
from random_force import random_force
from structures import link, oscillator, structure

import linkwise as lw
from linkwise.discovery import inexact
from linkwise.discovery.selection import Penalty, QuadraticModel

RATE, DURATION = 400.0, 10.0
CHAIN = structure(
    {"m1": 1.0, "m2": 0.8},
    link("m1-ground", "m1-ground", "k*d + c*v + k3*d**3 + q*v*abs(v)", k=1500.0, c=1.5, k3=1e5, q=3.0),
    link("m2-m1", "m2-m1", "k*d + c*v + k3*d**3 + q*v*d**2", k=900.0, c=1.0, k3=8e4, q=1500.0),
)


def wide_force(rng: np.random.Generator) -> lw.model.Sampled:
    """8 N root mean square from 1 to 20 Hz."""
    return random_force(rng, DURATION, RATE, rms=8.0, highest=20.0, band_limited=True)


def test_the_structure_is_found_with_a_model_error() -> None:
    """Each link has a term of damping, 1 to 5 % of its force, that no candidate has."""
    chain = CHAIN
    seed = 11
    rng = np.random.default_rng(seed)
    forces = {mass: wide_force(rng) for mass in chain.mass_names}
    record = lw.simulate(chain, forces=forces, duration=DURATION, rate=RATE).with_noise(30.0, seed=seed)
    discovery = lw.discover(record, {"m1": 1.0, "m2": 0.8})
    assert {frozenset(link.between) for link in discovery.structure.links} == {
        frozenset(link.between) for link in chain.links
    }
    assert discovery.trusted and lw.Verdict.MODEL_ERROR_NEEDED in discovery.verdicts
    assert 0.0 < discovery.estimate.model_error < 0.05
    stiffness = {term.name: term.decision for term in discovery.terms}
    assert (
        stiffness["m1-ground.k"] is lw.discovery.Decision.CERTAIN
        and stiffness["m2-m1.k3"] is lw.discovery.Decision.CERTAIN
    )
    assert not [term for term in discovery.terms if term.kept and term.certain and term.term == "d**2"]


def test_a_servo_axis_has_no_spring_beyond_doubt(shared_data: Path) -> None:
    data = scipy.io.loadmat(shared_data / "emps.mat")
    force = data["vir"].ravel() * float(data["gtau"].item())
    record = lw.Record.from_arrays(data["t"].ravel(), {"x:m1": data["qm"].ravel(), "force:m1": force})
    third = record[: len(record) // 3]
    discovery = lw.discover(
        third, {"m1": "unknown"}, terms="1, d, d**2, d**3, v, v*abs(v), sign(v), stribeck(0.01)"
    )
    # published, with 1 % for the scatter of five pieces of the record, which that of thirds is below
    assert discovery.estimate.coefficient("m1.mass").value == pytest.approx(95.109, rel=0.01)
    selected = {term.term for term in discovery.terms if term.kept}
    assert {"1", "v", "sign(v)"} <= selected
    assert not [term for term in discovery.terms if term.kept and term.certain and term.term.startswith("d")]


def test_an_unknown_mass_and_a_constant_force_are_found() -> None:
    rig = oscillator("k*d + c*v + f0", mass=2.5, name="spring", k=2000.0, c=3.0, f0=1.2)
    force = wide_force(np.random.default_rng(5))
    record = lw.simulate(rig, forces={"m1": force}, duration=DURATION, rate=RATE).with_noise(40.0, seed=5)
    discovery = lw.discover(record, {"m1": "unknown"}, terms="1, cubic")
    assert discovery.trusted
    assert {term.term for term in discovery.terms if term.kept} == {"1", "d", "v"}
    low, high = discovery.estimate.coefficient("m1.mass").interval or (np.nan, np.nan)
    # the truth
    assert low < 2.5 < high
    assert [
        line for line in str(discovery).splitlines() if line.split()[:1] == ["m1"] and line.endswith("kg")
    ]
    with pytest.raises(lw.StructureError, match="neither an applied force nor another mass sets the scale"):
        lw.discover(record.select(["x:m1"]), {"m1": "unknown"})


def test_a_constant_force_acts_from_the_ground_only() -> None:
    candidates = lw.discovery.parse_terms("1, d, v")
    assert [term.coefficient for term in candidates] == ["f0", "k", "c"]
    record = chain_record(2, duration=2.0).with_noise(40.0, seed=1)
    discovery = lw.discover(record, {"m1": 1.0, "m2": 0.01}, terms="1, cubic")
    assert discovery.trusted
    assert not [term for term in discovery.terms if term.term == "1" and "ground" not in term.between]
    assert not [term for term in discovery.terms if term.term == "1" and term.kept]


def test_a_search_that_takes_too_many_steps_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stop with play, which no term on offer is: the search goes on to a second subset unless steps run out."""
    law = "k*d + c*v + q*(max(d - 0.02, 0) + min(d + 0.02, 0))"
    stop = oscillator(law, k=987.0, c=6.0, q=600.0)
    force = wide_force(np.random.default_rng(7301))
    record = lw.simulate(stop, forces={"m1": force}, duration=6.0, rate=RATE).with_noise(40.0, seed=7301)
    settled = lw.discover(record, {"m1": 1.0})
    monkeypatch.setattr(inexact, "_MOST_STEPS", 0)
    cut = lw.discover(record, {"m1": 1.0})
    assert lw.Verdict.SEARCH_UNSETTLED not in settled.verdicts and cut.rounds < settled.rounds
    assert not cut.trusted and lw.Verdict.SEARCH_UNSETTLED in cut.verdicts


def test_a_term_that_few_blocks_want_is_dropped_but_not_a_link() -> None:
    """Scores of size 10 each: of the first two terms, of one link, one scatters five times as much between blocks."""
    penalty = Penalty(term=20.0, link=30.0, pair=np.array([0, 0, 1, -1]), stated=frozenset())
    quadratic = QuadraticModel(("a", "b", "c", "mass"), np.eye(4), np.full(4, 10.0))
    uneven = np.diag([1.0, 25.0, 25.0, 25.0])
    assert inexact._without_uneven(quadratic, penalty, [0, 1, 2, 3]) == [0, 1, 2, 3]
    by_blocks = replace(quadratic, by_blocks=(uneven,))
    assert inexact._without_uneven(by_blocks, penalty, [0, 1, 2, 3]) == [0, 2, 3]
    assert inexact._without_uneven(by_blocks, penalty, [0, 2, 3]) == [0, 2, 3]
