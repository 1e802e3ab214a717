"""Forces of links and accelerations of masses over a given motion; links of one law are evaluated together."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.expression import Program, symbols
from linkwise.model.excitation import Excitation
from linkwise.model.law import Law
from linkwise.model.law_programs import dissipated_power
from linkwise.model.structure import Structure


@dataclass(frozen=True, eq=False)
class LinkForces:
    """The forces in a structure under an excitation; time is axis 0 of all arrays."""

    structure: Structure
    excitation: Excitation

    @cached_property
    def _groups(self) -> list[tuple[Law, Indices, dict[str, Floats]]]:
        """For each law the numbers (m,) of its links, and the values (m,) of each coefficient."""
        values = [link.values for link in self.structure.links]
        return [
            (law, numbers, {name: np.array([values[k][name] for k in numbers]) for name in law.coefficients})
            for law, numbers in self.structure.topology.by_law
        ]

    @cached_property
    def _columns(self) -> dict[tuple[int, str], int]:
        """Column of each state of a link in the states (M, S)."""
        return {key: column for column, key in enumerate(self.structure.topology.states)}

    def _states(self, law: Law, numbers: Indices, states: Floats) -> dict[str, Floats]:
        """The states (M, m) by name of links that have one law."""
        return {name: states[:, [self._columns[k, name] for k in numbers.tolist()]] for name in law.states}

    def links(self, d: Floats, v: Floats, states: Floats) -> Floats:
        """Force (M, L) of every link in N at elongations (M, L) in m, rates (M, L) in m/s and states (M, S)."""
        force = np.empty(d.shape)
        for law, numbers, values in self._groups:
            inside = self._states(law, numbers, states)
            force[:, numbers] = law.force(d[:, numbers], v[:, numbers], {**values, **inside})
        return force

    def dissipated_power(self, time: Floats, x: Floats, v: Floats, states: Floats) -> Floats:
        """Power (M, L) in W that every link dissipates, (f(d, v) - f(d, 0)) v; with memory, (f(d, v, s) - f(d, 0, 0)) v."""
        needed = any("d" in program.inputs for _, program, _, _ in self._dissipation)
        d, rate = self.elongations(time, x, v) if needed else (None, self._rates(time, v))
        power = np.empty(rate.shape)
        for law, program, numbers, values in self._dissipation:
            motion = {"v": rate[:, numbers], **({} if d is None else {"d": d[:, numbers]})}
            motion |= self._states(law, numbers, states)
            power[:, numbers] = program(*({**motion, **values}[name] for name in program.inputs))[0]
        return power

    @cached_property
    def _dissipation(self) -> list[tuple[Law, Program, Indices, dict[str, Floats]]]:
        """As `_groups`, with the program of the dissipated power."""
        groups = []
        for law, numbers, values in self._groups:
            power = dissipated_power(law.expression, law.states)
            groups.append((law, Program([power], symbols(power)), numbers, values))
        return groups

    def _rates(self, time: Floats, v: Floats) -> Floats:
        base = self.excitation.base
        return self.structure.elongations(v, None if base is None else base.derivative(time))

    def elongations(self, time: Floats, x: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Elongations (M, L) in m and rates (M, L) in m/s at displacements and velocities (M, n)."""
        base = self.excitation.base
        return self.structure.elongations(x, None if base is None else base.value(time)), self._rates(time, v)

    def applied(self, time: Floats) -> Floats:
        """Applied forces (M, n) in N on the masses."""
        forces = np.zeros((len(time), self.structure.size))
        for name, drive in self.excitation.forces.items():
            forces += drive.value(time)[:, None] * self.structure.topology.row(name)
        return forces

    def accelerations(self, time: Floats, x: Floats, v: Floats, states: Floats) -> Floats:
        """Accelerations (M, n) in m/s^2 at displacements and velocities (M, n) and states (M, S)."""
        links = self.links(*self.elongations(time, x, v), states)
        net = self.applied(time) - (self.structure.incidence @ links.T).T
        return np.ascontiguousarray(net / self.structure.mass_values)
