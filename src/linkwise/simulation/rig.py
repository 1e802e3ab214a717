"""Links alone on a rig, simulated beside a mass at rest: the integrator moves masses, and a rig has none."""

from __future__ import annotations

from dataclasses import dataclass, replace

from linkwise.model.law import Law
from linkwise.model.link import GROUND, Link, Mass
from linkwise.model.structure import Structure
from linkwise.records.truth import EnergyBalance
from linkwise.simulation.motion import SimulatedMotion

_MASS, _SPRING = "mass at rest", "spring at rest"


@dataclass(frozen=True)
class _MovedStructure(Structure):
    """A structure of links between base and ground, and of masses that these do not move."""

    def _check_ends(self) -> None:
        """All ends are those of the rig, which was checked, and of the mass at rest."""


def with_mass_at_rest(structure: Structure) -> Structure:
    """The structure of a rig, and a mass on a spring that nothing moves behind its links; others as they are."""
    if not structure.on_rig:
        return structure
    spring = Link(_SPRING, (_MASS, GROUND), Law.parse("k*d"), {"k": 1.0})
    return _MovedStructure(structure.name, (Mass(_MASS, 1.0),), (*structure.links, spring))


@dataclass(frozen=True, eq=False)
class RigDiagnostics:
    """Energies and horizon of the links on a rig, from the motion beside the mass at rest."""

    motion: SimulatedMotion

    @property
    def energy(self) -> EnergyBalance:
        """The balance without the spring at rest."""
        energy = self.motion.energy
        return replace(energy, potential=energy.potential[:, :-1], dissipated=energy.dissipated[:, :-1])

    @property
    def horizon(self) -> float | None:
        """Time in s past which the states cannot be trusted; None where they can throughout."""
        return self.motion.horizon
