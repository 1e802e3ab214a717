"""Dampers and friction with a negative coefficient beyond its interval are named."""

from __future__ import annotations

import numpy as np
from problems import chain_record
from structures import oscillator

import linkwise as lw

RIG = oscillator("k*d + c*v + fc*tanh(v/0.01)", name="spring", k=1000.0, c=2.0, fc=-0.5)


def test_negative_friction_is_named_where_the_link_as_a_whole_dissipates() -> None:
    clean = lw.simulate(RIG, release={"x:m1": 0.1}, duration=4.0, rate=500.0)
    fit = lw.identify(clean.with_noise(40.0, seed=3), RIG.unknown("all"))
    high = (fit.coefficient("spring.fc").interval or (np.nan, np.nan))[1]
    assert fit.trusted and high < 0.0
    assert [line for line in fit.findings if line.startswith("spring.fc is negative")]
    assert not [line for line in fit.findings if line.startswith(("spring.c is", "spring.k is"))]


def test_negative_stiffness_of_a_bistable_link_is_not_named(chain: lw.Structure) -> None:
    record = chain_record(2, duration=2.0).with_noise(30.0, seed=3)
    fit = lw.identify(record, chain.unknown("nes"))
    assert fit.coefficient("nes1.alpha").value < 0.0
    assert not [line for line in fit.findings if "is negative" in line]
