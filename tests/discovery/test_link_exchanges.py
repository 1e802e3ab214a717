"""Links whose terms belong to another link of the same mass."""

from __future__ import annotations

import numpy as np
from problems import chain_record

import linkwise as lw
from linkwise.discovery.candidates import candidates_for
from linkwise.discovery.rivals import link_exchange_remarks, link_exchanges
from linkwise.discovery.selection import Penalty, QuadraticModel, Selection

NAMES = ("m1-ground.k", "m2-m1.k", "m2-ground.k", "m2-ground.k3", "m2-m1.k3")
POOL = candidates_for([chain_record(2, duration=0.1)], {"m1": 1.0, "m2": 0.01}, "d, d**3")


def shared(lean: float) -> Selection:
    """A spring of m2 at m1, and a cubic one at the ground whose column leans on that of one at m1."""
    h = np.eye(5)
    h[1, 2] = h[2, 1] = h[3, 4] = h[4, 3] = lean
    cubic = np.array([0.0, 0.0, 0.0, 30.0, 0.0])
    g = h @ (np.array([90.0, 40.0, 1.0, 0.0, 0.0]) + cubic)
    quadratic, penalty = QuadraticModel(NAMES, h, g), Penalty.of(POOL, NAMES, 4000)
    chosen = frozenset(NAMES[:4])
    return Selection(chosen, POOL.structure(NAMES[:4]), None, quadratic, penalty, True, 1)  # type: ignore[arg-type]


def test_a_link_that_another_of_its_mass_may_hold_is_told() -> None:
    (exchange,) = link_exchanges(shared(0.999), POOL)
    assert (exchange.link, exchange.rival, exchange.terms) == ("m2-ground", "m2-m1", (2, 3))
    (remark,) = link_exchange_remarks([exchange])
    assert remark.startswith("This record hardly distinguishes the link m2-ground from m2-m1")


def test_links_that_a_record_tells_apart_are_not() -> None:
    assert link_exchanges(shared(0.9), POOL) == ()


def test_a_link_beside_another_of_its_mass_is_in_doubt_where_noise_hides_which() -> None:
    """The sink, by half a second at 8 dB: a cubic spring to the ground beside a spring to the primary explains it as well."""
    study = lw.read_study("reach")
    subject = study.subject("1 sink, 0.5 s, 687.5 Hz")
    record = subject.simulate(8).select(["x:m1", "x:m2"]).with_noise(8.0, seed=7008)
    discovery = lw.discover(record, {mass.name: mass.mass.value or 0.0 for mass in subject.structure.masses})
    assert {link.name for link in discovery.structure.links} == {"m1-ground", "m2-m1", "m2-ground"}
    assert discovery.trusted and "m2-ground" in discovery.in_doubt
