"""Basins of attraction: at which rest position free motion ends, over a plane of initial states."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from linkwise.analysis.linear_modes import modes
from linkwise.analysis.rest_positions import equilibria
from linkwise.arrays import Floats, Indices
from linkwise.display import JudgedView, align_columns
from linkwise.errors import SimulationError, StructureError, expect
from linkwise.model.link import refuse_memory
from linkwise.model.structure import Structure, refuse_rig
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.records.channel import Channel
from linkwise.records.channel_units import unit_in
from linkwise.response.options import shown_channels
from linkwise.response.shooting import channel_rows, free_phase
from linkwise.simulation.energy import kinetic_energy, potential_energy
from linkwise.verdict import UNGRADED, Basis, Verdict

_TURNS = 10  # periods of the slowest mode between two looks at the energy
_FEW = 0.01  # of all motions: such as begin on top of a barrier
_LOOKS = 400  # after which a motion is not decided


@dataclass(frozen=True, eq=False, repr=False)
class Basins(JudgedView):
    """The result of `basins`; printed, the share of each rest position.

    Attributes
    ----------
    structure : Structure
        The structure.
    plane : tuple of two str
        The channels whose initial values vary.
    values : tuple of two arrays, (A,) and (B,)
        These values.
    rests : array of shape (W, n)
        The stable rest positions in m.
    ends : array of int, shape (A, B)
        The number of the rest position where each motion ends, from 0; -1 where it has too much energy to tell.
    basis : Basis
        The answer that the structure comes from.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.response.basins(lw.bnes_chain(2), {"x:m2": (-0.02, 0.02), "v:m2": (-0.5, 0.5)}, points=6)
    >>> found.shares.round(1).tolist()
    [0.5, 0.5]
    """

    structure: Structure
    plane: tuple[Channel, Channel]
    values: tuple[Floats, Floats]
    rests: Floats
    ends: Indices
    basis: Basis = UNGRADED

    @property
    def shares(self) -> Floats:
        """The part of the plane that ends at each rest position, shape (W,)."""
        return np.array([float(np.mean(self.ends == number)) for number in range(len(self.rests))])

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether all motions but few came to rest."""
        few = float(np.mean(self.ends < 0)) <= _FEW
        return (Verdict.MOTIONS_FOLLOWED if few else Verdict.MOTIONS_CUT_SHORT,)

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data.

        Returns
        -------
        dict
            "plane" with the values of both channels, "rests" with their shares, and "ends".
        """
        names = [f"x:{name}" for name in self.structure.mass_names]
        return {
            "method": "basins",
            "structure": self.structure.name,
            **self._judgement(),
            "plane": dict(zip(self.plane, (values.tolist() for values in self.values), strict=True)),
            "rests": [
                {"x": dict(zip(names, rest, strict=True)), "share": share}
                for rest, share in zip(self.rests.tolist(), self.shares.tolist(), strict=True)
            ],
            "ends": self.ends.tolist(),
        }

    def __str__(self) -> str:
        return "\n".join([*basins_headline(self), *align_columns(basins_rows(self))])


def basins_headline(result: Basins) -> tuple[str, ...]:
    """What was computed, in a sentence or two."""
    ranges = [
        f"{name} from {values[0]:g} to {values[-1]:g} {unit_in(result.structure, name)}"
        for name, values in zip(result.plane, result.values, strict=True)
    ]
    open_share = float(np.mean(result.ends < 0))
    sentence = f"Free motion of {result.structure.name} from {' and '.join(ranges)}."
    return (sentence, *([f"{100 * open_share:.3g} % did not come to rest."] if open_share else []))


def basins_rows(result: Basins) -> list[tuple[str, ...]]:
    """The share of each rest position, and where it is."""
    names = result.structure.mass_names
    rows = [("rest", "share", *(f"x:{name}, {unit_in(result.structure, f'x:{name}')}" for name in names))]
    for number, (rest, share) in enumerate(zip(result.rests, result.shares, strict=True), start=1):
        rows.append((f"{number}", f"{100 * share:.3g} %", *(f"{x:.4g}" for x in rest.tolist())))
    return rows


def basins(
    structure: Structure,
    plane: Mapping[str, tuple[float, float]],
    *,
    points: int = 31,
    progress: Progress = silent,
) -> Basins:
    """Find at which rest position free motion ends, over a plane of two initial states.

    A motion has ended once its energy is below that of every unstable equilibrium, so that it cannot leave its well.

    Parameters
    ----------
    structure : Structure
        The structure, every coefficient a number or a start.
    plane : mapping of str to tuple of two floats
        Two displacements or velocities with the ends of their ranges, such as ``{"x:m2": (-0.02, 0.02), "v:m2": (-2, 2)}``.
        All others begin at zero.
    points : int
        Values of each.
    progress : Progress
        Called with a `ProgressReport` as rows are done.

    Returns
    -------
    Basins
        Where each motion ends, and the share of each rest position.

    Raises
    ------
    SimulationError
        If the plane is not one of two states.
    StructureError
        If there is no stable equilibrium, or a law has memory or is not smooth.
    TypeError
        If `structure` has another type.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.response.basins(lw.bnes_chain(2), {"x:m2": (-0.02, 0.02), "v:m2": (-0.5, 0.5)}, points=4)
    >>> found.ends.shape
    (4, 4)
    """
    expect("basins(structure, plane): structure", structure, Structure)
    expect("basins(structure, plane): plane", plane, Mapping)
    refuse_rig(structure, "basins")
    refuse_memory(structure.links, "basins")
    if len(plane) != 2 or points < 2:
        message = f"basins need two states and at least 2 values of each, got {len(plane)} and {points}"
        raise SimulationError(message, arguments=("plane",))
    channels = shown_channels(structure, tuple(plane), "a state of the plane", ("plane",))
    for name, (low, high) in plane.items():
        if not -np.inf < low < high < np.inf:
            message = (
                f"{name} must go from a finite value to a higher one, in SI units, got {low:g} to {high:g}"
            )
            raise SimulationError(message, arguments=("plane",))
    rows = channel_rows(structure, channels)
    if np.count_nonzero(rows) != len(rows):
        message = "basins start from states of masses or modes; a point of a host moves as its modes do"
        raise SimulationError(message)
    first, second = (np.linspace(low, high, points) for low, high in plane.values())
    rests, end = _motion_to_rest(structure)
    ends = np.empty((points, points), dtype=np.intp)
    for row, value in enumerate(first):
        progress(ProgressReport(row / points, "free motion"))
        for column, other in enumerate(second):
            ends[row, column] = end(rows[0] * value + rows[1] * other)
    return Basins(structure, (channels[0], channels[1]), (first, second), rests, ends)


def _motion_to_rest(structure: Structure) -> tuple[Floats, Callable[[Floats], int]]:
    """The stable rest positions (W, n) of a structure, and what gives the number of that where free motion from a state (2n,)
    ends, -1 where that is not decided.

    Raises StructureError for a structure without a stable equilibrium, and for laws with kinks.
    """
    equilibrium = equilibria(structure)
    if not equilibrium.stable:
        raise StructureError("no stable equilibrium was found, so motion has nowhere to end")
    integrator, size = free_phase(structure, structure.shape_key[1]), structure.size
    frequencies = modes(structure, equilibrium.stable[0].x).frequencies
    omega = 2.0 * np.pi * float(frequencies[frequencies > 0.0].min())
    barrier = min((point.energy for point in equilibrium if not point.stable), default=np.inf)
    rests = np.array([point.x for point in equilibrium.stable])
    phases: Floats = 2.0 * np.pi * np.arange(_TURNS + 1, dtype=float)

    def end(state: Floats) -> int:
        for _ in range(_LOOKS):
            energy = float(potential_energy(structure, state[:size], 0.0).sum())
            energy += float(kinetic_energy(structure, state[None, size:])[0])
            if not np.isfinite(energy):
                return -1
            if energy < barrier:  # the lowest one
                apart = structure.elongations(rests - state[:size], np.zeros(len(rests)))
                return int(np.linalg.norm(apart, axis=1).argmin())
            state = integrator.motion(state, omega, phases)[-1]
        return -1

    return rests, end
