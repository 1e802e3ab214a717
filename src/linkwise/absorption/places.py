"""Motion of masses and of points of hosts in several structures of one shape, and what dissipates in a structure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.model.structure import Structure


def place_motion(structures: Sequence[Structure], x: Floats, places: Sequence[str]) -> Floats:
    """(N, P, W) m: motion of P masses or points in W structures, from that (N, n, W) of their masses and modes."""
    moved = np.zeros((len(x), len(places), x.shape[2]))
    for structure, runs in moving_alike(structures):
        topology = structure.topology
        for row, place in enumerate(places):
            for number, part in topology.weights(topology.index[place]):
                moved[:, row, runs] += part * x[:, number, runs]
    return moved


def moving_alike(structures: Sequence[Structure]) -> Iterator[tuple[Structure, slice]]:
    """A structure and the runs that move by its shapes: all of them, or each by itself if shapes of hosts differ."""
    if have_equal_shapes(structures):
        yield structures[0], slice(None)
        return
    for run, structure in enumerate(structures):
        yield structure, slice(run, run + 1)


def have_equal_shapes(structures: Sequence[Structure]) -> bool:
    """Whether the shapes of hosts are the same in all structures of one shape."""
    shapes = [[mode.shape for host in structure.hosts for mode in host.modes] for structure in structures]
    return all(shape == shapes[0] for shape in shapes)


def dissipators(structure: Structure) -> dict[str, list[int]]:
    """What dissipates, by name, with the numbers of its links: hosts by all their modes, then every other link."""
    numbers = {link.name: number for number, link in enumerate(structure.links)}
    hosts = {
        host.name if host.name not in numbers else f"{host.name} (modes)": [
            numbers[name] for name in host.coordinates
        ]
        for host in structure.hosts
    }
    return hosts | {name: [number] for name, number in numbers.items() if name not in structure.modes}
