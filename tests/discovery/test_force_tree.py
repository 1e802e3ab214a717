"""The tree that a search without measured displacements starts from: accelerations tell it from the leaves on."""

from __future__ import annotations

import numpy as np
import pytest
from judged import graph, masses, terms
from random_force import random_force
from structures import row_of_masses

import linkwise as lw
from linkwise.discovery.candidates import candidates_for
from linkwise.discovery.screened_records import tree_of_forces

RATE = 1000.0


def pairs(record: lw.Record, given: dict[str, float | str] | lw.Structure) -> set[frozenset[str]]:
    """The ends of the links of the tree of a record."""
    candidates = candidates_for([record], given, "cubic")
    chosen = {candidates.by_name[name].pair for name in tree_of_forces([record], candidates)}
    return {frozenset(candidates.pairs[number].between) for number in chosen}


def released(n: int, kind: str) -> lw.Record:
    chain = lw.bnes_chain(n)
    return lw.simulate(chain, release={"v:m1": 3.0}, duration=3.0, rate=RATE, sensors=(kind,))


@pytest.mark.parametrize(
    ("n", "kind", "decibel"), [(4, "v", 30.0), (4, "v", 20.0), (6, "v", 30.0), (6, "a", 30.0)]
)
def test_the_tree_of_a_chain_is_that_of_its_links(n: int, kind: str, decibel: float) -> None:
    """Sinks of a hundredth of the mass hang on masses whose own link is told before theirs."""
    clean, chain = released(n, kind), lw.bnes_chain(n)
    for seed in range(2041, 2045):
        assert pairs(clean.with_noise(decibel, seed=seed), masses(chain)) == graph(chain)


def test_a_link_to_a_moving_base_is_one_of_the_tree() -> None:
    law = "k*d + c*v"
    storeys = row_of_masses([1.0, 0.5], low=(law, {"k": 4e3, "c": 1.0}), high=(law, {"k": 2e3, "c": 0.5}))
    on_base = lw.parse_structure(lw.model.format_structure(storeys).replace("ground", "base"))
    shaking = random_force(np.random.default_rng(3), 3.0, RATE, rms=0.01, band_limited=True)
    clean = lw.simulate(on_base, base=shaking, duration=3.0, rate=RATE, sensors=("v",))
    assert "x:base" in clean.channels
    assert pairs(clean.with_noise(40.0, seed=5), masses(on_base)) == graph(on_base)


def test_nothing_is_told_where_accelerations_do_not_determine_forces() -> None:
    record, chain = released(4, "v").with_noise(30.0, seed=2041), lw.bnes_chain(4)
    assert pairs(record, masses(chain))
    assert not pairs(record, masses(chain) | {"m2": "unknown"})
    stated = chain.unknown("nes")
    assert not pairs(record, stated)


def test_velocities_alone_give_the_chain_of_four() -> None:
    """The first tree came from integrated velocities and was wrong; two of six such records ended in another tree."""
    chain = lw.bnes_chain(4)
    discovery = lw.discover(released(4, "v").with_noise(30.0, seed=2001), masses(chain))
    assert terms(discovery.structure) == terms(chain)
    assert discovery.trusted and discovery.rounds == 2
