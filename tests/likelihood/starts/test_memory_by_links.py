"""Starts of links with memory, one link after another, from accelerations of all masses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import present
from structures import named, structure

import linkwise as lw
from linkwise.likelihood.starts.memory_by_links import memory_starts_by_links
from linkwise.signals.base_frame import framed

W = 2.0 * np.pi * 3.0
TRUE = {"k": 0.5 * W**2, "c": 0.04 * W, "F": 0.009 * W**2, "x0": 0.012, "s": 0.6}
BASE = "0.2*sin(2.8*t) + 0.02*sin(8*t + 1) + 0.01*sin(14*t + 2) + 0.002*sin(26*t)"


def frame() -> lw.Structure:
    lower, upper = named("lower", "m1-base", "bouc-wen", **TRUE), named("upper", "m2-m1", "bouc-wen", **TRUE)
    return structure({"m1": 1.0, "m2": 1.0}, lower, upper)


@pytest.mark.parametrize("shared", [False, True], ids=["own", "shared"])
def test_storeys_are_found_from_their_forces(shared: bool) -> None:
    """Their slowest motion is below any frequency that a filter could leave without the drift."""
    asked = frame().unknown("all")
    if shared:
        lower, upper = asked.links
        same = {key: lw.Coefficient.shared(f"lower.{key}") for key in upper.coefficients}
        asked = replace(asked, links=(lower, replace(upper, coefficients=same)))
    record = lw.simulate(frame(), duration=5.0, rate=100.0, base=BASE, sensors=["a", "a:base"])
    record = replace(record.with_noise(40.0, seed=31), simulated=None)
    valleys = memory_starts_by_links(framed(record, asked).record, asked, {})
    is_force = np.array([p.name.partition(".")[2] in ("k", "F") for p in asked.parameters])
    true = np.array([present(frame().coefficient(p.name).value) for p in asked.parameters])
    off = [np.abs(np.log2(np.maximum(valley.values / true, 1e-9)))[is_force].max() for valley in valleys]
    # the search for the maximum of the likelihood, which tries all starts, converges from twice and from half of the values
    assert len(asked.parameters) == (5 if shared else 10) and min(off) < 1.0
