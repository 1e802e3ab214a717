"""What the links of a structure exert over a given motion, links of one law evaluated together."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.arrays import Floats
from linkwise.expression import Program, symbols
from linkwise.model.excitation import Excitation
from linkwise.model.law import Law
from linkwise.model.structure import Structure
from linkwise.simulation.shape import power_lost


@dataclass(frozen=True, eq=False)
class LinkForces:
    """The forces in a structure under an excitation; time on axis 0 of all arrays."""

    structure: Structure
    excitation: Excitation

    @cached_property
    def _groups(self) -> list[tuple[Law, list[int], dict[str, Floats]]]:
        """Per law: the numbers of its links and the value of each coefficient in them."""
        members: dict[Law, list[int]] = {}
        for number, link in enumerate(self.structure.links):
            members.setdefault(link.law, []).append(number)
        values = [link.values for link in self.structure.links]
        return [
            (law, numbers, {name: np.array([values[k][name] for k in numbers]) for name in law.coefficients})
            for law, numbers in members.items()
        ]

    def links(self, d: Floats, v: Floats) -> Floats:
        """(M, L) force of every link in N at elongations and rates (M, L)."""
        force = np.empty(d.shape)
        for law, numbers, values in self._groups:
            force[:, numbers] = law.force(d[:, numbers], v[:, numbers], values)
        return force

    def lost(self, time: Floats, x: Floats, v: Floats) -> Floats:
        """(M, L) power in W that every link turns into heat, (f(d, v) - f(d, 0)) v."""
        needed = any("d" in program.inputs for program, _, _ in self._losses)
        d, rate = self.elongations(time, x, v) if needed else (None, self._rates(time, v))
        power = np.empty(rate.shape)
        for program, numbers, values in self._losses:
            motion = {"v": rate[:, numbers], **({} if d is None else {"d": d[:, numbers]})}
            power[:, numbers] = program(*({**motion, **values}[name] for name in program.inputs))[0]
        return power

    @cached_property
    def _losses(self) -> list[tuple[Program, list[int], dict[str, Floats]]]:
        """As `_groups`, with the power lost."""
        losses = []
        for law, numbers, values in self._groups:
            loss = power_lost(law.expression)
            losses.append((Program([loss], symbols(loss)), numbers, values))
        return losses

    def _rates(self, time: Floats, v: Floats) -> Floats:
        base = self.excitation.base
        return self.structure.elongations(v, None if base is None else base.derivative(time))

    def elongations(self, time: Floats, x: Floats, v: Floats) -> tuple[Floats, Floats]:
        """(M, L) elongations in m and rates in m/s at displacements and velocities (M, n)."""
        base = self.excitation.base
        return self.structure.elongations(x, None if base is None else base.value(time)), self._rates(time, v)

    def applied(self, time: Floats) -> Floats:
        """(M, n) forces in N that the excitation applies to the masses."""
        names = self.structure.mass_names
        forces = np.zeros((len(time), len(names)))
        for name, drive in self.excitation.forces.items():
            forces[:, names.index(name)] = drive.value(time)
        return forces

    def accelerations(self, time: Floats, x: Floats, v: Floats) -> Floats:
        """(M, n) accelerations in m/s^2 at displacements and velocities (M, n)."""
        links = self.links(*self.elongations(time, x, v))
        net = self.applied(time) - (self.structure.incidence @ links.T).T
        return np.ascontiguousarray(net / self.structure.mass_values)
