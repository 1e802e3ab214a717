"""The energy balance of a simulation: energy supplied, stored and dissipated, from forces of links along its orbit.

    kinetic + sum of potential + sum of dissipated = supplied,   dissipated' = (f(d, v) - f(d, 0)) v for each link

With memory it is (f(d, v, s) - f(d, 0, 0)) v: what a state stores counts as dissipated until the state gives it back. So
does, with its sign, what a signal feeds in.

Powers are integrated along the orbit that was simulated, by Gauss-Legendre quadrature over panels that end at output
times and at the steps of the integrator (and so at impulses, knots of sampled inputs and kinks). A step is a seventh of
the radius of convergence, so 6 nodes leave an error below rounding; a driving polynomial of order 5 makes the power one
of order 11, for which they are exact.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats, Indices
from linkwise.expression import Program, symbols
from linkwise.model.excitation import Excitation
from linkwise.model.law import Law, dissipated_power
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.records.record import EnergyBalance
from linkwise.simulation.run import RunLog, RunOptions, RunSchedule, integrate


@dataclass(frozen=True, eq=False)
class LinkForces:
    """The forces in a structure under an excitation; time is axis 0 of all arrays."""

    structure: Structure
    excitation: Excitation

    def variables(
        self, time: Floats, x: Floats, v: Floats, states: Floats
    ) -> Iterator[tuple[Link, dict[str, Floats]]]:
        """Each link with d, v, the states and the signals (M,) of its law."""
        d, rate = self.elongations(time, x, v)
        columns = {key: column for column, key in enumerate(self.structure.topology.states)}
        for k, link in enumerate(self.structure.links):
            of_states = {name: states[:, columns[k, name]] for name in link.law.states}
            signals = {name: self.excitation.signals[name].value(time) for name in link.law.signals}
            yield link, {"d": d[:, k], "v": rate[:, k], **of_states, **signals}

    def links(self, time: Floats, x: Floats, v: Floats, states: Floats) -> Floats:
        """Force (M, L) of every link in N at displacements and velocities (M, n) and states (M, S)."""
        every = self.variables(time, x, v, states)
        return np.stack([link.force(own["d"], own["v"], own) for link, own in every], axis=1)

    def dissipated_power(self, time: Floats, x: Floats, v: Floats, states: Floats) -> Floats:
        """Power (M, L) in W that every link dissipates, (f(d, v) - f(d, 0)) v; with memory, (f(d, v, s) - f(d, 0, 0)) v."""
        powers = []
        for link, variables in self.variables(time, x, v, states):
            program = _dissipation_program(link.law)
            named: dict[str, Floats | float] = {**link.values, **variables}
            power = program(*(named[name] for name in program.inputs))[0]  # a number for a spring
            powers.append(np.broadcast_to(power, time.shape))
        return np.stack(powers, axis=1)

    def elongations(self, time: Floats, x: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Elongations (M, L) in m and rates (M, L) in m/s at displacements and velocities (M, n)."""
        base = self.excitation.base
        places, rates = (None, None) if base is None else (base.value(time), base.derivative(time))
        return self.structure.elongations(x, places), self.structure.elongations(v, rates)

    def applied(self, time: Floats) -> Floats:
        """Applied forces (M, n) in N on the masses."""
        forces = np.zeros((len(time), self.structure.size))
        for name, drive in self.excitation.forces.items():
            forces += drive.value(time)[:, None] * self.structure.topology.row(name)
        return forces

    def accelerations(self, time: Floats, x: Floats, v: Floats, states: Floats) -> Floats:
        """Accelerations (M, n) in m/s^2 at displacements and velocities (M, n) and states (M, S)."""
        links = self.links(time, x, v, states)
        net = self.applied(time) - (self.structure.incidence @ links.T).T
        return np.ascontiguousarray(net / self.structure.mass_values)


@lru_cache(maxsize=128)
def _dissipation_program(law: Law) -> Program:
    """The program of the power that a law dissipates."""
    power = dissipated_power(law.expression, (*law.states, *law.signals))
    return Program([power], symbols(power))


_EQUAL = 1e-13  # of the run: panel ends closer than that are equal up to rounding


def kinetic_energy(structure: Structure, v: ArrayLike) -> Floats:
    """Kinetic energy (N,) in J, from velocities `v` (N, n) in m/s."""
    energy: Floats = 0.5 * np.square(np.asarray(v, dtype=float)) @ structure.mass_values
    return energy


def potential_energy(structure: Structure, x: ArrayLike, base: ArrayLike | None = None) -> Floats:
    """Energy (N, L) in J stored in each link, 0 at zero elongation, from displacements `x` (N, n) and `base` (N,) in m."""
    d = structure.elongations(x, base)
    return np.stack([link.potential(d[..., column]) for column, link in enumerate(structure.links)], axis=-1)


def energy_balance(
    schedule: RunSchedule, displacement: Floats, velocity: Floats, run: RunLog
) -> EnergyBalance:
    """The balance at the output times of a schedule, for the motion (N, n) in m and m/s that `run` gave there."""
    structure, base_at = schedule.structure, schedule.excitation.base_at
    steps: list[float] = []
    integrate(schedule, schedule.times[-1:], options=RunOptions(repeated=run, log=steps))
    times, weights, samples = _quadrature(schedule, steps)
    forces = LinkForces(structure, schedule.excitation)
    size, links = structure.size, len(structure.links)
    gained = np.zeros((len(schedule.times), links + 1))  # dissipated by each link, then supplied

    def receive(first: int, x: Floats, v: Floats, states: Floats) -> None:
        part = slice(first, first + len(x))
        time = times[part]
        power = _link_powers(forces, time, x, v, states) * weights[part, None]
        sample = samples[part]
        starts = np.flatnonzero(np.diff(sample, prepend=-1))
        gained[sample[starts]] += np.add.reduceat(power, starts, axis=0)
        # an impulse that makes a velocity jump by J to v supplies m J (v - J/2)
        for stop, jump in schedule.jumps.items():
            for row in np.flatnonzero(time == schedule.stops[stop]):
                change = jump[size : 2 * size]
                supplied = structure.mass_values * change * (v[row] - 0.5 * change)
                gained[sample[row], links] += supplied.sum()

    integrate(schedule, times, receive, RunOptions(repeated=run))
    x, v = schedule.start[None, :size], schedule.start[None, size : 2 * size]
    at_start = potential_energy(structure, x, base_at(np.zeros(1))).sum()
    gained = np.cumsum(gained, axis=0)
    return EnergyBalance(
        supplied=gained[:, links] + at_start + kinetic_energy(structure, v)[0],
        kinetic=kinetic_energy(structure, velocity),
        potential=potential_energy(structure, displacement, base_at(schedule.times)),
        dissipated=np.ascontiguousarray(gained[:, :links]),
    )


def _quadrature(schedule: RunSchedule, steps: list[float]) -> tuple[Floats, Floats, Indices]:
    """Nodes and weights (Q,) in s of panels between all output times, stops and steps, and the index (Q,) of the output time
    at or after each node; impulses have weight 0.
    """
    edges = np.unique(np.concatenate([[0.0], schedule.times, schedule.stops, steps]))
    width = np.diff(edges)
    nonempty = width > _EQUAL * schedule.end
    middle, width = 0.5 * (edges[1:] + edges[:-1])[nonempty], width[nonempty]
    nodes, node_weights = np.polynomial.legendre.leggauss(6)
    times = (middle[:, None] + 0.5 * width[:, None] * nodes).ravel()
    weights = (0.5 * width[:, None] * node_weights).ravel()
    impulses = schedule.stops[sorted(schedule.jumps)]
    times, weights = np.concatenate([times, impulses]), np.concatenate([weights, np.zeros(len(impulses))])
    order = np.argsort(times, kind="stable")
    times, weights = times[order], weights[order]
    sample = np.searchsorted(schedule.times, times, side="left")
    return times, weights, sample.clip(max=len(schedule.times) - 1)


def _link_powers(forces: LinkForces, time: Floats, x: Floats, v: Floats, states: Floats) -> Floats:
    """Power (M, L + 1) in W: what every link dissipates, then what forces and base supply."""
    supplied = np.einsum("ti,ti->t", forces.applied(time), v)
    if (base := forces.excitation.base) is not None:
        on_base = forces.links(time, x, v, states) @ forces.structure.base_incidence
        supplied += on_base * base.derivative(time)
    return np.column_stack([forces.dissipated_power(time, x, v, states), supplied])
