"""Hosts that are free to move: identified where displacements tell their place, refused where nothing does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from structures import host, link, structure

import linkwise as lw
from linkwise.likelihood.starts.rigid_motions import require_placed

TRUE = {"k": 500.0, "k3": 5e6, "c": 0.2}


def body(**law: float) -> lw.Structure:
    """A free body with one mode that bends, and a sink on it."""
    free = host("body", (0.0, 20.0), 0.01, {"left": (1.2, 1.5), "mid": (1.2, -1.0)})
    return structure({"sink": 0.05}, link("nes", "sink-body.mid", "k*d + k3*d**3 + c*v", **law), hosts=[free])


def pushed(kind: str) -> lw.Record:
    return lw.simulate(
        body(**TRUE),
        forces={"body.left": "6*sin(2*pi*15*t + 40*t**2)*exp(-t)"},
        duration=1.5,
        rate=500.0,
        sensors=[f"{kind}:{place}" for place in ("body.left", "body.mid", "sink")],
    ).with_noise(40.0, seed=11)


def test_displacements_tell_the_place_of_a_free_body() -> None:
    found = lw.identify(pushed("x"), body(**TRUE).unknown("nes"))
    assert found.trusted
    for name, true in TRUE.items():
        coefficient = found.coefficient(f"nes.{name}")
        assert abs(coefficient.value - true) < 4.0 * np.asarray(coefficient.standard_error)


@pytest.mark.parametrize("kind", ["v", "a"])
def test_what_does_not_tell_its_place_is_refused(kind: str) -> None:
    with pytest.raises(lw.IdentificationError, match="nothing tells the place of rigid motions at 0 Hz"):
        lw.identify(pushed(kind), body(**TRUE).unknown("nes"))


def test_a_damper_to_the_ground_does_not_tell_the_place() -> None:
    body_with_damper = body(**TRUE)
    damped = replace(
        body_with_damper, links=(*body_with_damper.links, link("mount", "body.left-ground", "c*v", c=0.3))
    )
    with pytest.raises(lw.IdentificationError, match="nothing tells the place of rigid motions at 0 Hz"):
        require_placed(pushed("a"), damped)
    held = replace(
        body_with_damper, links=(*body_with_damper.links, link("mount", "body.left-ground", "k*d", k=3.0))
    )
    require_placed(pushed("a"), held)
