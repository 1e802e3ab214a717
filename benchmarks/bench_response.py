"""Response curves: 200 points of two and of ten masses, and a band, against the times asked and SciPy: `make benchmark`."""

from __future__ import annotations

from time import process_time

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.response.continuation import follow, solve, turned
from linkwise.response.options import Drive
from linkwise.response.shooting import Shooting, driven_phase

POINTS = 200


def shooting(masses: int) -> Shooting:
    chain = lw.bnes_chain(masses)
    drive, bounds = Drive("force", "m1"), (120.0, 230.0)
    integrator = driven_phase(chain, drive)
    assert integrator is not None
    return Shooting(chain, drive, 0.3, bounds, integrator)


def scipy_turn(masses: int, start: Floats) -> float:
    """Processor time in s of a turn with all derivatives by differences, as SciPy's solve_ivp makes them to 1e-10."""
    chain, omega, size = lw.bnes_chain(masses), 150.0, masses
    incidence = chain.incidence.toarray()
    stiff, cubic, viscous = (
        np.array(
            [next((link.values[name] for name in names if name in link.values), 0.0) for link in chain.links]
        )
        for names in (("k", "alpha"), ("beta", "k3"), ("c",))
    )

    def rate(t: float, state: Floats) -> Floats:
        d, v = state[:size] @ incidence, state[size:] @ incidence
        net = -incidence @ (stiff * d + cubic * d**3 + viscous * v)
        net[0] += 0.3 * np.cos(omega * t)
        return np.concatenate([state[size:], net / chain.mass_values])

    started = process_time()
    solve_ivp(rate, (0.0, 2 * np.pi / omega), start, method="DOP853", rtol=1e-10, atol=1e-12)
    return (process_time() - started) * (2 * size + 2)  # the motion, and one for each column of the Jacobian


@pytest.mark.parametrize(("masses", "most"), [(2, 0.5), (10, 10.0)])
def test_two_hundred_points_take_a_moment(masses: int, most: float) -> None:
    equations = shooting(masses)
    at_rest = lw.analysis.equilibria(equations.structure).stable[0].x
    start = solve(equations, np.concatenate([at_rest, np.zeros(masses), [120.0]]))  # compiles
    assert start is not None
    longest = 0.04
    started = process_time()
    rising = turned(start, np.eye(len(start.unknowns))[-1])
    points, _ = follow(equations, rising, equations.bounds, lambda point: False, longest=longest, most=POINTS)
    seconds = process_time() - started
    turns = sum(point.corrections for point in points)
    by_scipy = scipy_turn(masses, start.unknowns[:-1])
    ratio = by_scipy * turns / seconds
    print(
        f"\n{masses} masses: {len(points)} points in {seconds:.2f} s ({turns} turns with derivatives); solve_ivp of SciPy "
        f"would take {by_scipy * 1e3:.0f} ms a turn, {ratio:.0f} times as long"
    )
    assert seconds * POINTS / len(points) < most
    assert ratio > 20.0


def test_a_band_of_a_hundred_draws() -> None:
    chain = lw.bnes_chain(2)
    record = lw.simulate(chain, release={"v:m1": 1.0}, duration=3.0, rate=1000.0).with_noise(30.0, seed=1)
    fit = lw.identify(record, chain.unknown("nes"), method="weak")
    lw.respond(chain, force={"m1": 0.3}, hz=(20.0, 20.1), starts=0)
    times, points = [], 0
    for answer in (chain, fit):
        started = process_time()
        response = lw.respond(answer, force={"m1": 0.3}, hz=(20.0, 36.0), starts=0)
        times.append(process_time() - started)
        points = sum(len(branch.hz) for level in response.levels for branch in level.branches)
    print(f"\n{points} points: {times[0]:.1f} s, with a band of 100 draws {times[1]:.1f} s")
    assert times[1] - times[0] < 15.0
