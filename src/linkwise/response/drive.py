"""What keeps a structure in steady motion: a harmonic force on a mass, or a harmonic motion of the base."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.display import near_miss
from linkwise.errors import SimulationError
from linkwise.expression import Expression
from linkwise.expression.parser import parse
from linkwise.model.link import BASE, refuse_signals
from linkwise.model.structure import Structure

FORCE = "force"
_DISPLACEMENTS = {  # of the place that is driven, as what is harmonic is size*cos(omega*t)
    FORCE: "size*cos(omega*t)",
    "x": "size*cos(omega*t)",
    "v": "size/omega*sin(omega*t)",
    "a": "-size/omega**2*cos(omega*t)",
}
_ORDERS = {"x": 0, "v": 1, "a": 2}


@dataclass(frozen=True)
class Drive:
    """A harmonic force on a place, or the harmonic displacement, velocity or acceleration of the base.

    Parameters
    ----------
    kind : {"force", "x", "v", "a"}
        What is harmonic: a force in N (N m on what turns), or the motion of the base, in m, m/s or m/s2.
    place : str
        A mass, a point of a host, or "base".

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.response.Drive("force", "m1").unit
    'N'
    """

    kind: str
    place: str

    @property
    def unit(self) -> str:
        """The unit of its size."""
        return {FORCE: "N", "x": "m", "v": "m/s", "a": "m/s2"}[self.kind]

    @property
    def order(self) -> int:
        """Which derivative of the displacement of the base is harmonic; 0 for a force."""
        return _ORDERS.get(self.kind, 0)

    @property
    def expression(self) -> Expression:
        """The force, or the displacement of the base, over t, with symbols size and omega."""
        return parse(_DISPLACEMENTS[self.kind], ("t",))

    def base(self, size: float, omega: float, phases: Floats) -> tuple[Floats, Floats]:
        """Give the motion of the base.

        Parameters
        ----------
        size : float
            Amplitude of what is harmonic, in its unit.
        omega : float
            Angular frequency in rad/s.
        phases : array of shape (M,)
            Phases of the excitation in rad.

        Returns
        -------
        tuple of two arrays of shape (M,)
            Displacement in m and velocity in m/s; zero under a force.
        """
        if self.kind == FORCE:
            return np.zeros(len(phases)), np.zeros(len(phases))
        size = size / omega**self.order
        turned = phases - 0.5 * np.pi * self.order
        return size * np.cos(turned), -size * omega * np.sin(turned)

    def check(self, structure: Structure) -> None:
        """Check that a structure can be driven so.

        Parameters
        ----------
        structure : Structure
            The structure.

        Raises
        ------
        SimulationError
            If it has no such place.
        StructureError
            If a law names a signal.
        """
        refuse_signals(structure.links, "responses", "put its mean into the law as a coefficient")
        if self.kind == FORCE:
            places = (*structure.places, *structure.modes.intersection(structure.mass_names))
            if self.place not in places:
                raise SimulationError(
                    f"unknown mass {self.place!r} in a force{near_miss(self.place, structure.places)}; the masses and points "
                    f"are {', '.join(structure.places)}",
                    mass=self.place,
                )
        elif self.place != BASE or not np.any(structure.base_incidence):
            raise SimulationError(
                'the motion of the base is given, but no link has "base" as an end; write "base" instead of "ground" in '
                "`between`"
            )
