"""Modes and equivalents of links are tuned from where they are, at a bound or not."""

from __future__ import annotations

import numpy as np
from structures import host, link, structure

import linkwise as lw
from linkwise.likelihood.starts.linear_part import LinearPart
from linkwise.likelihood.starts.mode_tuning import _tuned
from linkwise.signals.noise import channel_noise


def test_equivalents_that_rounding_took_past_their_bounds_are_tuned() -> None:
    """The search ended with an error of its own about the bounds."""
    spring = link("spring", "beam.tip-ground", "k*d + k3*d**3", k=50.0, k3=1e4)
    beam = structure({}, spring, hosts=[host("beam", (3.0,), 0.02, {"tip": (1.0,)})])
    record = lw.simulate(
        beam,
        forces={"beam.tip": "sin(10*t) + sin(23*t)"},
        duration=3.0,
        rate=100.0,
        sensors=["a:beam.tip"],
    ).with_noise(40.0, seed=1)
    unknown = beam.unknown("spring")
    free = LinearPart.of(unknown)
    (least, _), _ = free.bounds(0, record.rate)
    past = LinearPart.of(unknown, np.array([[least * (1.0 + 1e-12), 0.0]]))
    _, tuned = _tuned(record, unknown, channel_noise(record), past, 0.1, free.equivalent_units(record))
    assert tuned.equivalent[0, 0] > least
