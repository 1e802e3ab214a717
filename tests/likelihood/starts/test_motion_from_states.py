"""Motion that the measured states of links tell."""

from __future__ import annotations

import numpy as np
import pytest
from structures import named, structure

import linkwise as lw
from linkwise.likelihood.starts.motion_from_states import motion_from_states


@pytest.mark.parametrize("order", [("lower", "upper"), ("upper", "lower")])
def test_voltages_tell_the_motion_of_a_chain_whatever_the_order_of_its_links(order: tuple[str, str]) -> None:
    values = {"k": 800.0, "c": 0.5, "theta": 2e-3, "C": 5e-6, "R": 5e4}
    ends = {"lower": "m1-ground", "upper": "m2-m1"}
    chain = structure({"m1": 1.0, "m2": 0.5}, *(named(name, ends[name], "piezo", **values) for name in order))
    force = {"m1": "5*sin(20*t) + 4*sin(31*t)"}
    record = lw.simulate(chain, forces=force, duration=3.0, rate=300.0, sensors=["state", "v"])
    x, v = np.zeros((2, len(record))), np.zeros((2, len(record)))
    sigma = {name: 1e-6 * float(record.channel(name).std()) for name in record.channels}
    assert sorted(motion_from_states(record, chain, sigma, x, v)) == [0, 1]
    for name, velocity in zip(("v:m1", "v:m2"), v, strict=True):
        shown = record.channel(name)
        error = (velocity - shown)[20:-20]  # away from the ends, where smoothing has fewer samples
        # of a sine of 5 Hz in 60 samples a period, whose rate a smoothing polynomial gives
        assert np.abs(error).max() < 1e-3 * np.abs(shown).max()
