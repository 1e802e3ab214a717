"""The force of a link along the motion of a record: identified, measured where a load cell shows it, and its work."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import StructureError
from linkwise.estimates.estimate import Estimate


@dataclass(frozen=True, eq=False)
class ForceLoop:
    """Force of a link at the N samples of the first record.

    Attributes
    ----------
    d, v, identified : array of shape (N,)
        Elongation in m, rate in m/s and identified force in N.
    measured : array of shape (N,) or None
        The force in N that a load cell showed, less its offset.
    step : float
        Sampling interval in s.
    """

    d: Floats
    v: Floats
    identified: Floats
    measured: Floats | None
    step: float

    @property
    def largest(self) -> float:
        """The largest force in N."""
        shown = self.identified if self.measured is None else np.concatenate([self.identified, self.measured])
        return float(np.nanmax(np.abs(shown)))

    @property
    def cycles(self) -> int:
        """Complete cycles: from one time the elongation rises through the middle of its range to the next."""
        return max(len(self._rises) - 1, 0)

    @property
    def energy(self) -> float:
        """Work in J done on the link a cycle, or over the record where there is no complete cycle."""
        power = self.identified * self.v * self.step
        if not self.cycles:
            return float(np.nansum(power))
        return float(np.nansum(power[self._rises[0] : self._rises[-1]])) / self.cycles

    @property
    def energy_text(self) -> str:
        """What it dissipates, in words."""
        if not self.cycles:
            return f"work done on it over the record: {self.energy:.4g} J"
        many = f"mean of {self.cycles} cycles" if self.cycles > 1 else "of one cycle"
        return f"energy dissipated a cycle: {self.energy:.4g} J ({many})"

    @property
    def _rises(self) -> list[int]:
        low, high = float(np.nanmin(self.d)), float(np.nanmax(self.d))
        middle, band = 0.5 * (low + high), 0.05 * (high - low)
        rises, armed = [], False
        for number, value in enumerate(self.d.tolist()):
            if value < middle - band:
                armed = True
            elif armed and value >= middle:
                rises.append(number)
                armed = False
        return rises


def force_loop(estimate: Estimate, name: str) -> ForceLoop:
    """The force of an identified link along the motion of the first record.

    Raises StructureError if there is no such link, or the force in it is not known along the motion.
    """
    link = estimate.link(name).link
    motion, count = estimate.motion, len(estimate.record)
    index = [candidate.name for candidate in motion.structure.links].index(name)
    d, v = motion.d[:count, index], motion.v[:count, index]
    if motion.identified_force is not None:
        force = motion.identified_force[:count, index]
    elif not link.law.states:
        force = link.force(d, v)
    else:
        raise StructureError(
            "the force of a link with memory is not known without its states", f'link "{name}"'
        )
    measured = None if motion.measured_force is None else motion.measured_force[:count, index]
    return ForceLoop(d, v, np.asarray(force), measured, estimate.record.step)


def has_loop(estimate: Estimate, name: str) -> bool:
    """Whether the force of a link forms loops that are known: of links with memory and of those on a rig."""
    index = [link.name for link in estimate.structure.links].index(name)
    forces = estimate.motion.identified_force
    return forces is not None and bool(np.isfinite(forces[:, index]).any())
