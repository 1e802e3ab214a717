"""The energy balance of a simulation: what was put in, and where it went.

    kinetic + sum of potential + sum of dissipated = put in,   dissipated' = (f(d, v) - f(d, 0)) v per link

Powers are integrated along the very orbit that was simulated, by Gauss-Legendre quadrature over panels that end at output
times and at the integrator's own steps (with them at impulses, at knots of sampled inputs and where a law bends). A step is a
seventh of the radius of convergence, so 6 nodes leave an error below rounding; polynomials of order 5 that drive a mass make
the power one of order 11, for which they are exact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from linkwise.analysis.energy import kinetic_energy, potential_energy
from linkwise.arrays import Floats
from linkwise.records.truth import EnergyBalance
from linkwise.simulation.link_forces import LinkForces
from linkwise.simulation.run import RunLog, RunOptions, integrate
from linkwise.simulation.schedule import RunSchedule

_NOTHING = 1e-13  # of the run: edges closer than that are one, apart by rounding


class QuadratureRule(NamedTuple):
    """Times and weights of a quadrature; `sample` is the first output time at or after each, which it counts for."""

    times: Floats
    weights: Floats
    sample: NDArray[np.int64]


def energy_balance(
    schedule: RunSchedule, displacement: Floats, velocity: Floats, run: RunLog
) -> EnergyBalance:
    """The balance at the schedule's output times, of the motion (N, n) that `run` gave there."""
    structure, base = schedule.structure, schedule.excitation.base
    steps: list[float] = []
    manner = RunOptions(repeated=run, log=steps)
    integrate(schedule, schedule.times[-1:], lambda first, states: None, manner)
    rule = _rule(schedule, steps)
    forces = LinkForces(structure, schedule.excitation)
    size, links = structure.size, len(structure.links)
    gained = np.zeros((len(schedule.times), links + 1))  # dissipated per link, put in

    def receive(first: int, states: Floats) -> None:
        part = slice(first, first + len(states))
        time = rule.times[part]
        power = _powers(forces, time, states[:, :size], states[:, size:]) * rule.weights[part, None]
        sample = rule.sample[part]
        starts = np.flatnonzero(np.diff(sample, prepend=-1))
        gained[sample[starts]] += np.add.reduceat(power, starts, axis=0)
        # a blow lifts the kinetic energy by m J (v - J/2), with v the velocity after it
        for stop, jump in schedule.jumps.items():
            for row in np.flatnonzero(time == schedule.stops[stop]):
                lift = structure.mass_values * jump[size:] * (states[row, size:] - 0.5 * jump[size:])
                gained[sample[row], links] += lift.sum()

    integrate(schedule, rule.times, receive, RunOptions(repeated=run))
    where = None if base is None else base.value(schedule.times)
    potential = potential_energy(structure, displacement, where)
    x, v = schedule.start[None, :size], schedule.start[None, size:]
    at_start = potential_energy(structure, x, None if base is None else base.value(np.zeros(1))).sum()
    gained = np.cumsum(gained, axis=0)
    return EnergyBalance(
        supplied=gained[:, links] + at_start + kinetic_energy(structure, v)[0],
        kinetic=kinetic_energy(structure, velocity),
        potential=potential,
        dissipated=np.ascontiguousarray(gained[:, :links]),
    )


def _rule(schedule: RunSchedule, steps: list[float]) -> QuadratureRule:
    """Panels between everything that must not lie inside one; impulses with weight 0."""
    edges = np.unique(np.concatenate([[0.0], schedule.times, schedule.stops, steps]))
    width = np.diff(edges)
    real = width > _NOTHING * schedule.end
    middle, width = 0.5 * (edges[1:] + edges[:-1])[real], width[real]
    nodes, node_weights = np.polynomial.legendre.leggauss(6)
    times = (middle[:, None] + 0.5 * width[:, None] * nodes).ravel()
    weights = (0.5 * width[:, None] * node_weights).ravel()
    struck = schedule.stops[sorted(schedule.jumps)]
    times, weights = np.concatenate([times, struck]), np.concatenate([weights, np.zeros(len(struck))])
    order = np.argsort(times, kind="stable")
    times, weights = times[order], weights[order]
    sample = np.searchsorted(schedule.times, times, side="left")
    return QuadratureRule(times, weights, sample.clip(max=len(schedule.times) - 1))


def _powers(forces: LinkForces, time: Floats, x: Floats, v: Floats) -> Floats:
    """(M, L + 1) W: what every link dissipates, and last what forces and base put in."""
    lost = forces.lost(time, x, v)
    power = np.zeros((len(time), lost.shape[1] + 1))
    power[:, :-1] = lost
    if forces.excitation.forces:
        power[:, -1] = np.einsum("ti,ti->t", forces.applied(time), v)
    base = forces.excitation.base
    if base is not None:
        pulled = forces.links(*forces.elongations(time, x, v)) @ forces.structure.base_incidence
        power[:, -1] += pulled * base.derivative(time)
    return power
