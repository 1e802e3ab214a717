"""Modal coordinates of hosts from displacements of their points: y = S q, by weighted least squares (METHODS section 11)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.errors import IdentificationError
from linkwise.model.host import Host
from linkwise.model.structure import Structure

_INDEPENDENT = 1e-4  # of the largest singular value of shapes of unit length: sensors that tell less of a mode tell noise


@dataclass(frozen=True, eq=False)
class MeasuredModes:
    """What channels tell of masses and modes.

    Attributes
    ----------
    weights : array of shape (n + 2, C)
        Weights of the channels in the displacements of masses and modes, the base and the ground.
    surplus_rows : tuple of array of shape (k, C)
        For each host with more channels than modes: sums of its channels in which no mode is seen, and that are white noise
        of unit variance.
    """

    weights: Floats
    surplus_rows: tuple[Floats, ...]

    def surplus(self, displacements: Floats, missing: Bools | None) -> float:
        """Mean square of what channels show beyond the modes over that expected from noise, of the worst host.

        Parameters
        ----------
        displacements : array of shape (C, N)
            What the channels show.
        missing : array of bool, shape (C - 2, N), or None
            Samples that are missing.

        Returns
        -------
        float
            The ratio; 1 where no host has more channels than modes.
        """
        whole = slice(None) if missing is None else ~missing.any(axis=0)
        shown = [np.mean((rows @ displacements[:, whole]) ** 2) for rows in self.surplus_rows]
        return float(np.nan_to_num(max(shown, default=1.0), nan=1.0))


def measured_modes(structure: Structure, has_channel: Bools, variance: Floats) -> MeasuredModes:
    """What displacement channels tell of masses and of modes of hosts.

    Parameters
    ----------
    structure : Structure
        The structure, with hosts.
    has_channel : array of bool, shape (C,)
        Whether there is a channel, for each of its `places`, the base and the ground.
    variance : array of shape (C,)
        Variances of the noise of the channels in m^2.

    Returns
    -------
    MeasuredModes
        The weights of the channels.

    Raises
    ------
    IdentificationError
        If the channels of a host do not tell its modes, or a shape is not known.
    """
    _require_known_shapes(structure)
    topology, places = structure.topology, structure.places
    states = len(topology.states)
    weights, surplus = np.zeros((structure.size + states + 2, len(has_channel))), []
    weights[-2 - states :, -2 - states :] = np.eye(states + 2)
    for column, place in enumerate(places[len(structure.points) :], start=len(structure.points)):
        weights[topology.index[place], column] = float(has_channel[column])
    firsts = np.cumsum([0, *(len(host.points) for host in structure.hosts)]).tolist()
    for host, (first, last) in zip(structure.hosts, pairwise(firsts), strict=True):
        columns = first + np.flatnonzero(has_channel[first:last])
        modes = [topology.index[name] for name in host.coordinates]
        shapes = np.array([topology.row(places[column])[modes] for column in columns]).reshape(-1, len(modes))
        _require_told(host, shapes, [places[column] for column in columns])
        deviation = np.sqrt(np.maximum(variance[columns], np.finfo(float).tiny))
        left, values, right = np.linalg.svd(shapes / deviation[:, None])
        own = left[:, : len(modes)]
        weights[np.ix_(modes, columns)] = (right.T / values) @ own.T / deviation
        if len(columns) > len(modes):
            rows = np.zeros((len(columns) - len(modes), len(has_channel)))
            rows[:, columns] = left[:, len(modes) :].T / deviation
            surplus.append(rows)
    return MeasuredModes(weights, tuple(surplus))


def _require_told(host: Host, shapes: Floats, places: list[str]) -> None:
    """IdentificationError where the shapes (c, r) of r modes at c measured places are not independent."""
    length = np.linalg.norm(shapes, axis=0)
    values = np.linalg.svd(shapes / np.where(length > 0.0, length, 1.0), compute_uv=False)
    independent = int(np.sum(values > _INDEPENDENT * values.max(initial=0.0)))
    lacking = shapes.shape[1] - independent
    if lacking:
        raise IdentificationError(
            f'the weak form needs the modal coordinates of host "{host.name}": its {shapes.shape[1]} modes take as many '
            f"displacements of points at which they differ, and the record has {independent} "
            f"({', '.join(f'x:{place}' for place in places) or 'no x:POINT'}), so {lacking} more "
            f'{"is" if lacking == 1 else "are"} needed; keep fewer modes, or use method "ml", which takes fewer sensors'
        )


def _require_known_shapes(structure: Structure) -> None:
    """IdentificationError where a shape is unknown, or known to within: the coordinates would depend on it."""
    for host in structure.hosts:
        for name, mode in zip(host.coordinates, host.modes, strict=True):
            if mode.shape_sigma:
                raise IdentificationError(
                    f"the shape of {name} is not known exactly at {', '.join(mode.shape_sigma)}, and the weak form takes "
                    'modal coordinates from shapes: use method "ml", or state shapes as numbers'
                )
