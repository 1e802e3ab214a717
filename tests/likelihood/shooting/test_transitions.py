"""Sensitivities by transitions over half steps: those that are marched, and their declared order."""

from __future__ import annotations

import numpy as np
import pytest
from problems import rubbing_trio, truth

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.likelihood.shooting.acting_forces import ActingForces
from linkwise.likelihood.shooting.flow import Inputs, Trajectories, flow
from linkwise.likelihood.shooting.system import System
from linkwise.likelihood.shooting.tangent_forces import CandidateForces, Single
from linkwise.likelihood.shooting.tangents import tangents
from linkwise.likelihood.shooting.transitions import carried

STEP, STEPS, SCALE = 3e-3, 6, np.repeat([1e-4, 1e-1], 3)
ENDS = np.array([-1, 0]), np.array([1, 2])  # of two candidates, one of them on a single mass
NOTHING = Inputs()


@pytest.fixture(scope="module")
def problem() -> tuple[System, Floats, Floats]:
    """With two unknown masses and a coefficient that links on both sides of a mass share; states of some nodes."""
    three = rubbing_trio()
    unknown = three.unknown("all", "mass:m2", "mass:m3")
    record = lw.simulate(
        three,
        duration=0.3,
        rate=1.0 / STEP,
        sensors=("x", "v"),
        release={"v:m1": 1.0, "x:m3": 0.005},
        base="0",
    )
    nodes = np.concatenate([[record.channel(f"{kind}:m{i}")[::STEPS] for i in (1, 2, 3)] for kind in "xv"])
    return System.of(unknown), truth(three, unknown), nodes[:, :-1]


def orbit_in(problem: tuple[System, Floats, Floats], steps: int) -> tuple[Trajectories, Floats]:
    """The motion in so many steps a sample, and their durations."""
    system, theta, nodes = problem
    step = np.full(nodes.shape[1], STEP / steps)
    return flow(system.at(theta), nodes, step, STEPS * steps, NOTHING), step


def candidates_along(orbit: Trajectories) -> CandidateForces:
    """Forces that follow elongations of links, in N."""
    return CandidateForces(*ENDS, 100.0 * orbit.links[:, 0, :2], 100.0 * orbit.middle_links[:, 0, :2])


def ends_by_transitions(problem: tuple[System, Floats, Floats], steps: int) -> Floats:
    """(2 n, P, K) of x and v at the ends, in so many whole steps a sample."""
    (system, theta, _), (fine, half) = problem, orbit_in(problem, 2 * steps)
    orbit, step = fine.thinned(2), 2.0 * half
    candidates, mechanics = candidates_along(orbit), system.at(theta)
    acting = ActingForces.along(mechanics, fine, step, theta, candidates, inputs=NOTHING)
    *_, last = carried(mechanics, step, SCALE, acting, len(SCALE) + len(theta) + len(ENDS[0]))
    return in_their_units(last.transpose(1, 2, 0).reshape(2, 3, -1, len(step)), step)


def ends_by_march(problem: tuple[System, Floats, Floats], steps: int) -> Floats:
    """The same, marched."""
    (system, theta, _), (orbit, step) = problem, orbit_in(problem, steps)
    candidates = candidates_along(orbit)
    *_, last = tangents(system.at(theta), orbit, step, SCALE, theta, candidates, inputs=NOTHING)
    return in_their_units(last.state, step)


def in_their_units(state: Single, step: Floats) -> Floats:
    return np.asarray(np.concatenate([state[0], state[1] / step]) / SCALE[:, None, None], dtype=float)


def test_columns_of_states_are_those_that_are_marched_in_half_steps(
    problem: tuple[System, Floats, Floats],
) -> None:
    """The same numerics, in single precision."""
    ours, marched = (
        ends[:, : len(SCALE)] for ends in (ends_by_transitions(problem, 1), ends_by_march(problem, 2))
    )
    assert np.abs(ours - marched).max() < 1e-5 * np.abs(marched).max()


def test_all_columns_have_their_declared_order(problem: tuple[System, Floats, Floats]) -> None:
    """Those of parameters and of candidates as well, of order 4 by Simpson's rule; one that is wrong keeps its error."""
    exact = ends_by_march(problem, 16)
    size = np.sqrt(np.mean(exact**2, axis=(0, 2)))
    errors = [
        np.sqrt(np.mean((ends_by_transitions(problem, steps) - exact) ** 2, axis=(0, 2))) / size
        for steps in (1, 2)
    ]
    assert exact.shape[1] == len(SCALE) + len(problem[1]) + 2
    assert np.max(errors[1]) < 0.01
    orders = np.log2(errors[0] / errors[1])  # 4 in the displacements, 3 in the rates
    assert np.median(orders) > 3.0 and np.min(orders) > 2.5
