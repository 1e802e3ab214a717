"""Starts of linear links are moved to where the motion neither grows nor is too fast to be followed."""

from __future__ import annotations

import numpy as np
import pytest
from structures import host, link, structure

import linkwise as lw
from linkwise.likelihood.starts.linear_part import LinearPart
from linkwise.likelihood.starts.stable_starts import stable_starts

WING = host("wing", (5.0, 9.0), 0.01, {"tip": (0.1, 0.2), "mid": (0.15, -0.1)})
RATE = 100.0


def joined(law: str) -> lw.Structure:
    return structure({}, link("joint", "wing.mid-ground", law), hosts=(WING,))


def started(law: str, k: float, c: float, stated: dict[str, float] | None = None) -> tuple[float, float]:
    asked = joined(law)
    values = stable_starts(LinearPart.of(asked), {"joint.k": k, "joint.c": c}, stated or {}, RATE)
    return values["joint.k"], values["joint.c"]


def eigenvalues(k: float, c: float) -> np.ndarray:
    part = LinearPart.of(joined("k*d + c*v"), np.array([[k, c]]))
    return np.linalg.eigvals(np.block([[np.zeros((2, 2)), np.eye(2)], [-part.stiffness, -part.damping]]))


@pytest.mark.parametrize(("k", "c"), [(-1e6, 3.0), (300.0, -50.0), (-1e9, -1e9), (1e12, 3.0), (300.0, 1e12)])
def test_a_start_that_runs_away_or_is_too_stiff_is_moved(k: float, c: float) -> None:
    before, after = eigenvalues(k, c), eigenvalues(*started("k*d + c*v", k, c))
    assert before.real.max() > 0.0 or np.abs(before).max() > 20.0 * RATE
    assert after.real.max() < 0.0
    assert np.abs(after).max() < 20.0 * RATE


def test_other_starts_stay_as_they_are() -> None:
    assert started("k*d + c*v", 300.0, 2.0) == (300.0, 2.0)
    assert started("k*d + c*v", 300.0, -2.0, {"joint.c": -2.0}) == (300.0, -2.0)
    assert started("k*sin(d) + c*v", -1e6, -2.0) == (-1e6, -2.0)


def test_coefficients_within_a_law_are_moved_alike() -> None:
    k, c = started("2*k*d - c*v", 100.0, 5.0)
    assert (k, c) == pytest.approx((100.0, 0.0), abs=1e-9)
