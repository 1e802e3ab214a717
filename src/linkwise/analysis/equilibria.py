"""Static equilibria of a structure, and whether they are stable.

Links between the same two ends act as one bond. Where the bonds close no circle, the forces balance only if every bond is at
rest by itself, so the equilibria are the products of the bonds' rest points: all of them, exactly. Otherwise Newton's method,
damped, starts from every product of rest points. The base is at its zero.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, islice, product
from math import prod
from typing import overload

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from linkwise.analysis.wells import RestPoint, rest_points
from linkwise.arrays import Bools, Floats
from linkwise.errors import StructureError
from linkwise.model.link import Link
from linkwise.model.structure import Structure

_LIMIT = 4096  # starts, or equilibria listed, unless told otherwise
_STEPS = 200  # of Newton's method: it converges linearly where the stiffness vanishes
_HALVINGS = 30
_AT_REST = 1e-11  # residual force over the largest stiffness times the size of the structure's rest positions
_NEUTRAL = 1e-9  # an eigenvalue of the stiffness below this part of the largest is taken for zero
_ELEMENTS = 4_000_000  # of the stiffness matrices that are held at a time


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """Displacements `x` (n,) in m at which all forces balance; `energy` in J is the sum of the links' potentials.

    `stable`: the tangent stiffness has no negative eigenvalue. `neutral` counts its zero ones: rigid motions of what floats,
    and directions in which only a damper acts or the stiffness vanishes at that point.
    """

    x: Floats
    stable: bool
    energy: float
    neutral: int


@dataclass(frozen=True, eq=False)
class Equilibria(Sequence[Equilibrium]):
    """The equilibria found, stable ones first, of rising energy.

    `complete` says that there can be no others; `note` says in words what limits the list (nothing: an empty text).
    """

    points: tuple[Equilibrium, ...]
    complete: bool
    note: str

    def __len__(self) -> int:
        return len(self.points)

    @overload
    def __getitem__(self, index: int) -> Equilibrium: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Equilibrium, ...]: ...

    def __getitem__(self, index: int | slice) -> Equilibrium | tuple[Equilibrium, ...]:
        return self.points[index]

    @property
    def stable(self) -> tuple[Equilibrium, ...]:
        """Those in which the structure can rest."""
        return tuple(point for point in self.points if point.stable)


@dataclass(frozen=True)
class _Bond:
    """All links between two nodes, with the sign of each against the first."""

    nodes: tuple[int, int]
    links: tuple[tuple[Link, float], ...]

    @property
    def key(self) -> Hashable:
        """Equal for bonds of equal force."""
        return tuple((link.law, tuple(link.values.values()), sign) for link, sign in self.links)

    def force(self, d: Floats) -> Floats:
        return sum((sign * link.force(sign * d) for link, sign in self.links), np.zeros(np.shape(d)))

    def slope(self, d: Floats) -> Floats:
        return sum((link.stiffness(sign * d) for link, sign in self.links), np.zeros(np.shape(d)))

    def potential(self, d: Floats) -> Floats:
        return sum((link.potential(sign * d) for link, sign in self.links), np.zeros(np.shape(d)))


def equilibria(
    structure: Structure,
    start: ArrayLike | None = None,
    *,
    reach: tuple[float, float] | None = None,
    limit: int = _LIMIT,
) -> Equilibria:
    """The static equilibria of `structure`.

    `start` (n,) or (S, n): search from these displacements in m only. `reach`: the range of elongations in m in which the rest
    points of the links are looked for (default: anywhere). At most `limit` are listed or started from, the wells first; the
    result says where that cut something off. Raises StructureError for a coefficient without a value.
    """
    bonds = _bonds(structure)
    incidence = _incidence(bonds, structure.size)
    if start is not None:
        starts = np.atleast_2d(np.asarray(start, dtype=float))
        if starts.ndim != 2 or starts.shape[1] != structure.size or not np.isfinite(starts).all():
            raise StructureError(f"a start is {structure.size} finite displacements in m, one for each mass")
        return _from_starts(
            bonds, incidence, starts, float(np.abs(starts).max()), "searched from the given starts only"
        )
    rests = _rests(bonds, reach)
    count = prod(len(rest) or 1 for rest in rests)
    many = str(count) if count < 10**6 else f"1e{len(str(count)) - 1}"
    cut = (
        f"{many} combinations of rest points, of which only {limit} were used, wells first"
        if count > limit
        else ""
    )
    choices = list(islice(_wells_first(rests), limit))
    places = np.array([[point.d if point else 0.0 for point in choice] for choice in choices]).reshape(
        len(choices), -1
    )
    if bonds and _free(bonds, structure.size) == structure.size - len(bonds):
        return _of_tree(bonds, incidence, rests, choices, places, cut)
    weights = _weights(bonds, rests)
    starts = np.linalg.lstsq(weights[:, None] * incidence.T, weights[:, None] * places.T, rcond=None)[0].T
    searched = f"the links close a circle, so Newton's method searched from {len(starts)} combinations of rest points"
    note = "; ".join(filter(None, [searched, cut]))
    return _from_starts(bonds, incidence, starts, float(np.abs(places).max(initial=0.0)), note)


def _bonds(structure: Structure) -> list[_Bond]:
    """The links by the pair of nodes they join; ground and base are one node. Links without any elastic force are left out."""
    index = {name: node for node, name in enumerate(structure.mass_names)}
    ground = structure.size
    found: dict[tuple[int, int], list[tuple[Link, float]]] = {}
    probe = np.concatenate([-np.logspace(-9, 3, 49), [0.0], np.logspace(-9, 3, 49)])
    for link in structure.links:
        first, second = (index.get(end, ground) for end in link.between)
        with np.errstate(all="ignore"):
            elastic = bool(np.any(link.force(probe) != 0.0))
        if elastic:
            nodes, sign = ((second, first), -1.0) if (second, first) in found else ((first, second), 1.0)
            found.setdefault(nodes, []).append((link, sign))
    return [_Bond(nodes, tuple(links)) for nodes, links in found.items()]


def _incidence(bonds: Sequence[_Bond], size: int) -> Floats:
    """(n, bonds) incidence of the bonds."""
    incidence = np.zeros((size + 1, len(bonds)))
    for column, bond in enumerate(bonds):
        incidence[bond.nodes[0], column] += 1.0
        incidence[bond.nodes[1], column] -= 1.0
    return incidence[:size]


def _free(bonds: Sequence[_Bond], size: int) -> int:
    """How many groups of masses hang on to one another but not on to the ground: each has a rigid motion."""
    first, second = ([bond.nodes[end] for bond in bonds] for end in (0, 1))
    graph = csr_array((np.ones(len(bonds)), (first, second)), shape=(size + 1, size + 1))
    return int(connected_components(graph, directed=False)[0]) - 1


def _rests(bonds: Sequence[_Bond], reach: tuple[float, float] | None) -> list[tuple[RestPoint, ...]]:
    lo, hi = (None, None) if reach is None else reach
    known: dict[Hashable, tuple[RestPoint, ...]] = {}  # a thousand equal sinks are searched once
    for bond in bonds:
        try:
            if bond.key not in known:
                known[bond.key] = rest_points(bond.force, bond.slope, lo, hi)
        except StructureError as error:
            raise StructureError(f"{error.message} (`reach`)", f'link "{bond.links[0][0].name}"') from None
    return [known[bond.key] for bond in bonds]


def _wells_first(rests: Sequence[tuple[RestPoint, ...]]) -> Iterator[tuple[RestPoint | None, ...]]:
    """Every choice of one rest point a bond (None where it has none), those with fewer tops first."""
    low = [tuple(point for point in rest if point.well) for rest in rests]
    high = [tuple(point for point in rest if not point.well) for rest in rests]
    forced = [index for index, rest in enumerate(rests) if not low[index] and rest]
    free = [index for index in range(len(rests)) if low[index] and high[index]]
    for tops in range(len(free) + 1):
        for chosen in combinations(free, tops):
            up = {*chosen, *forced}
            yield from product(*[(high[i] if i in up else low[i]) or (None,) for i in range(len(rests))])


def _weights(bonds: Sequence[_Bond], rests: Sequence[tuple[RestPoint, ...]]) -> Floats:
    """(bonds,) how firmly a bond holds its rest point against the others: the root of its stiffness there."""
    stiffest = [max((abs(point.stiffness) for point in rest), default=0.0) for rest in rests]
    largest = max(stiffest, default=0.0) or 1.0
    return np.sqrt(np.maximum(np.array(stiffest) / largest, [1e-12 if rest else 0.0 for rest in rests]))


def _of_tree(
    bonds: Sequence[_Bond],
    incidence: Floats,
    rests: Sequence[tuple[RestPoint, ...]],
    choices: Sequence[tuple[RestPoint | None, ...]],
    places: Floats,
    cut: str,
) -> Equilibria:
    """The products of rest points. By Sylvester's law of inertia B diag(k) B' has as many negative eigenvalues as k."""
    restless = [bond.links[0][0].name for bond, rest in zip(bonds, rests, strict=True) if not rest]
    if restless:
        return Equilibria((), True, f'there is none: the force of link "{restless[0]}" vanishes nowhere')
    free = incidence.shape[0] - len(bonds)
    spread = np.linalg.pinv(incidence.T) if free else np.linalg.inv(incidence.T)
    x = places @ spread.T
    energy = np.sum([bond.potential(places[:, column]) for column, bond in enumerate(bonds)], axis=0)
    points = []
    for row, choice in enumerate(choices):
        k = np.array([point.stiffness for point in choice if point])
        flat = int(np.sum(np.abs(k) <= _NEUTRAL * np.abs(k).max()))
        stable = all(point.well for point in choice if point)
        points.append(Equilibrium(x[row], stable, float(energy[row]), free + flat))
    return Equilibria(_sorted(points), not cut, "; ".join(filter(None, [cut, _floating(free)])))


def _from_starts(
    bonds: Sequence[_Bond], incidence: Floats, starts: Floats, size: float, note: str
) -> Equilibria:
    """Newton's method from every row of `starts`; `size` in m is what displacements are measured by."""
    n = incidence.shape[0]
    chunk = max(1, _ELEMENTS // n**2)
    ends, settled = [], []
    for first in range(0, len(starts), chunk):
        x, done = _newton(bonds, incidence, starts[first : first + chunk], size)
        ends.append(x)
        settled.append(done)
    x, done = np.concatenate(ends), np.concatenate(settled)
    size = max(size, float(np.abs(x[done]).max(initial=0.0)))
    distinct: list[Floats] = []
    for candidate in x[done]:
        if not any(np.abs(candidate - other).max() <= 1e-6 * size for other in distinct):
            distinct.append(candidate)
    points = []
    for place in distinct:
        stiffness = _stiffness(bonds, incidence, place[None])[0]
        values = np.linalg.eigvalsh(stiffness)
        threshold = _NEUTRAL * np.abs(values).max()
        d = place @ incidence
        energy = sum(float(bond.potential(d[column])) for column, bond in enumerate(bonds))
        points.append(
            Equilibrium(
                place, bool(np.all(values >= -threshold)), energy, int(np.sum(np.abs(values) <= threshold))
            )
        )
    lost = f"{int(np.sum(~done))} of {len(done)} starts did not settle" if not done.all() else ""
    free = _free(bonds, n)
    return Equilibria(_sorted(points), False, "; ".join(filter(None, [note, lost, _floating(free)])))


def _newton(bonds: Sequence[_Bond], incidence: Floats, x: Floats, size: float) -> tuple[Floats, Bools]:
    """(S, n) the end of each search and (S,) whether the forces balance there. Steps are halved until the residual falls."""
    x = x.copy()
    done = np.zeros(len(x), dtype=bool)
    active = np.arange(len(x))
    for _ in range(_STEPS):
        residual = _residual(bonds, incidence, x[active])
        stiffness = _stiffness(bonds, incidence, x[active])
        largest = np.abs(stiffness).max(axis=(1, 2))
        balanced = np.abs(residual).max(axis=1) <= _AT_REST * largest * np.maximum(
            size, np.abs(x[active]).max(axis=1)
        )
        done[active[balanced]] = True
        going = ~balanced & np.isfinite(residual).all(axis=1) & np.isfinite(largest)
        active, residual, stiffness = active[going], residual[going], stiffness[going]
        if active.size == 0:
            break
        step = -np.einsum("sij,sj->si", np.linalg.pinv(stiffness, rcond=1e-12, hermitian=True), residual)
        norm = np.linalg.norm(residual, axis=1)
        scale = np.ones(len(active))
        for _ in range(_HALVINGS):
            with np.errstate(all="ignore"):  # a step too far may overflow; it is halved then
                tried = np.linalg.norm(_residual(bonds, incidence, x[active] + scale[:, None] * step), axis=1)
            worse = ~(tried < norm)
            if not worse.any():
                break
            scale[worse] *= 0.5
        x[active] += scale[:, None] * step
    return x, done


def _residual(bonds: Sequence[_Bond], incidence: Floats, x: Floats) -> Floats:
    """(S, n) the force of the links on each mass, sign reversed."""
    d = x @ incidence
    forces = np.stack([bond.force(d[:, column]) for column, bond in enumerate(bonds)], axis=1) if bonds else d
    return forces @ incidence.T


def _stiffness(bonds: Sequence[_Bond], incidence: Floats, x: Floats) -> Floats:
    """(S, n, n) tangent stiffness."""
    d = x @ incidence
    slopes = np.stack([bond.slope(d[:, column]) for column, bond in enumerate(bonds)], axis=1) if bonds else d
    return (incidence[None] * slopes[:, None, :]) @ incidence.T


def _sorted(points: Sequence[Equilibrium]) -> tuple[Equilibrium, ...]:
    """Stable first, then by energy, then by displacement; energies that differ by rounding count as equal."""
    unit = max((abs(point.energy) for point in points), default=0.0) * 1e-9 or 1.0
    return tuple(
        sorted(points, key=lambda point: (not point.stable, round(point.energy / unit), tuple(point.x)))
    )


def _floating(free: int) -> str:
    if not free:
        return ""
    return (
        f"{free} rigid motion{'s' if free > 1 else ''} that no elastic link resists: "
        "displacements are given up to it, with the least sum of squares"
    )
