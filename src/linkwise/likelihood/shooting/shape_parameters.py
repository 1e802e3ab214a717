"""Shapes of hosts among the parameters: how points, and with them links, forces and sensors, change with the modes' shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.model.names import SHAPE
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel


@dataclass(frozen=True, eq=False)
class ShapeParameters:
    """h parameters that are shapes of modes at points.

    Attributes
    ----------
    columns, points, modes : array of int, shape (h,)
        Which parameters they are, the numbers of the points from 0, and the numbers of the modes among the masses.
    start : array of shape (k, n)
        How points move with the shapes that the structure states.
    sides : array of shape (k, L)
        1 where a point is the first end of a link, -1 where it is the second; links in the order of the system.
    """

    columns: Indices
    points: Indices
    modes: Indices
    start: Floats
    sides: Floats

    @classmethod
    def of(cls, structure: Structure, order: Indices) -> ShapeParameters | None:
        """The shapes among the parameters of a structure, `order` (L,) being that of the links; None without any."""
        shapes = [
            (column, structure.points.index(_point(structure, *member)), -1 - member[0])
            for column, parameter in enumerate(structure.parameters)
            for member in parameter.members
            if member[0] < 0 and member[1].startswith(SHAPE)
        ]
        if not shapes:
            return None
        columns, points, modes = np.array(shapes, dtype=int).T
        ends = [structure.links[number].between for number in order.tolist()]
        sides = [[float(a == point) - float(b == point) for a, b in ends] for point in structure.points]
        start = np.array([structure.topology.row(name) for name in structure.points])
        return cls(columns, points, modes, start, np.array(sides))

    def change(self, theta: Floats) -> Floats:
        """(k, n) by which the rows of points differ from `start` at parameters theta (p,)."""
        change = np.zeros_like(self.start)
        change[self.points, self.modes] = theta[self.columns] - self.start[self.points, self.modes]
        return change


def _point(structure: Structure, index: int, key: str) -> str:
    host, _, _ = structure.mass_names[-1 - index].partition(".")
    return f"{host}.{key.removeprefix(SHAPE)}"


def held_where_unseen(structure: Structure, channels: Sequence[Channel]) -> Structure:
    """The structure with shapes known at points that have no link, force or sensor: nothing determines them.

    Parameters
    ----------
    structure : Structure
        The structure.
    channels : sequence of Channel
        Channels of the record.

    Returns
    -------
    Structure
        The structure; the same where every uncertain shape is at a point that is used.
    """
    used = {end for link in structure.links for end in link.between}
    used |= {channel.place for channel in channels}
    hosts = tuple(
        replace(
            host,
            modes=tuple(
                replace(
                    mode,
                    shape_sigma={
                        point: sigma
                        for point, sigma in mode.shape_sigma.items()
                        if f"{host.name}.{point}" in used
                    },
                )
                for mode in host.modes
            ),
        )
        for host in structure.hosts
    )
    return structure if hosts == structure.hosts else replace(structure, hosts=hosts)
