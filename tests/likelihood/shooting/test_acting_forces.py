"""What acts on sensitivities carried by transitions: the same as on those that are marched."""

from __future__ import annotations

import numpy as np
import pytest
from problems import rubbing_trio, truth

import linkwise as lw
from linkwise.likelihood.shooting.acting_forces import Accelerations, ActingForces
from linkwise.likelihood.shooting.flow import Inputs, flow
from linkwise.likelihood.shooting.system import System
from linkwise.likelihood.shooting.tangent_forces import CandidateForces, Single
from linkwise.likelihood.shooting.tangents import tangent_forces

STEP, STEPS, SEGMENTS = 3e-3, 4, 5
FORCES = Inputs(), np.array([-1, 0]), np.array([1, 2])


def spread(unknowns: Accelerations, point: int, shape: tuple[int, int]) -> Single:
    """(n, P, K) h^2 a at a point."""
    own = unknowns.at(point)
    out = np.zeros((shape[0] * shape[1], len(own)), np.float32)
    out[unknowns.places] = 2.0 * own.T
    return out.reshape(*shape, -1)


@pytest.mark.parametrize("unknown", [("all", "mass:m2", "mass:m3"), ("mass:m2",)])
def test_unknowns_accelerate_masses_as_in_a_march(unknown: tuple[str, ...]) -> None:
    """Coefficients that links on both sides of a mass share, masses, and forces between masses and on one alone."""
    three = rubbing_trio()
    asked = three.unknown(*unknown)
    record = lw.simulate(
        three,
        duration=0.1,
        rate=1.0 / STEP,
        sensors=("x", "v"),
        release={"v:m1": 1.0, "x:m3": 0.005},
        base="0",
    )
    nodes = np.concatenate([[record.channel(f"{kind}:m{i}")[:SEGMENTS] for i in (1, 2, 3)] for kind in "xv"])
    inputs, first, second = FORCES
    mechanics, unit = (
        System.of(asked).at(truth(three, asked)),
        np.arange(2.0, 2.0 + len(asked.parameters), dtype=float),
    )
    half = np.full(SEGMENTS, 0.5 * STEP)
    fine = flow(mechanics, nodes, half, 2 * STEPS, inputs)
    orbit = fine.thinned(2)
    candidates = CandidateForces(first, second, orbit.links[:, 0, :2], orbit.middle_links[:, 0, :2])
    acting = ActingForces.along(mechanics, fine, 2.0 * half, unit, candidates, inputs=inputs)
    both = tangent_forces(mechanics, orbit, 2.0 * half, unit, candidates, inputs=inputs)
    n, P = 3, 6 + len(unit) + len(first)
    at_rest = np.zeros((2, len(mechanics.gain.T), P, SEGMENTS), np.float32)
    no_states = np.empty((0, P, SEGMENTS), np.float32)
    for place in range(2 * STEPS + 1):
        pulls, forces = np.zeros_like(at_rest[0]), both[place % 2]
        forces(place // 2, at_rest, no_states, pulls, no_states)
        marched = np.einsum("nl,lpk->npk", mechanics.gain, pulls)
        forces.inertia(place // 2, marched)
        ours = spread(acting.accelerations, place, (n, P))
        assert np.abs(ours - marched).max() < 1e-5 * np.abs(marched).max()
    assert acting.steps == STEPS


def test_pairs_that_are_nearly_all_are_filled_up() -> None:
    """With a weight of zero, which changes nothing."""
    rng = np.random.default_rng(3)
    forces, weights = rng.normal(size=(1, 2, 3)).astype(np.float32), rng.normal(size=(2, 3))
    few, nearly_all = (
        Accelerations.of(forces, (np.array([1, 0, 1]), np.array([2, 1, 0])), np.arange(3), weights, shape)
        for shape in ((2, 9), (2, 3))
    )
    assert len(few.places) == 3 and len(nearly_all.places) == 6
    ours, filled = spread(few, 0, (2, 9)), spread(nearly_all, 0, (2, 3))
    assert np.array_equal(ours[:, :3], filled) and not ours[:, 3:].any()


def test_slopes_are_those_of_all_partial_derivatives() -> None:
    three = rubbing_trio()
    asked = three.unknown("all")
    mechanics = System.of(asked).at(truth(three, asked))
    d, v = np.random.default_rng(1).normal(size=(2, 4, len(mechanics.gain.T), 5))
    nothing = np.empty((4, 0, 5))
    partials = mechanics.partials(d, v, nothing)
    by_d, by_v = mechanics.slopes(d, v, nothing)
    assert np.array_equal(by_d, partials.by_d) and np.array_equal(by_v, partials.by_v)
