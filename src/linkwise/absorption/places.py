"""Motion of masses and of points of hosts in several structures of one shape, energy in hosts, and what dissipates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.model.host import Host
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
            numbers[link.name] for link in host.parts()[1]
        ]
        for host in structure.hosts
    }
    return hosts | {name: [number] for name, number in numbers.items() if name not in structure.modes}


def host_energy(structure: Structure, host: Host, x: Floats, v: Floats) -> Floats:
    """(N,) J: kinetic and potential energy of the modes of a host, from the motion (N, n) of masses and modes."""
    energy = np.zeros(len(x))
    for mode in host.coordinates:
        number, link = structure.mass_names.index(mode), structure.link(mode)
        energy += 0.5 * v[:, number] ** 2 + link.potential(x[:, number])
    return energy


def mean_host_energies(structures: Sequence[Structure], x: Floats, v: Floats) -> Floats:
    """(H, W) J: mean energies over the samples in the hosts of W structures of one shape, `x` and `v` (N, n, W)."""
    means = np.zeros((len(structures[0].hosts), len(structures)))
    for run, structure in enumerate(structures):
        for row, host in enumerate(structure.hosts):
            means[row, run] = host_energy(structure, host, x[..., run], v[..., run]).mean()
    return means
