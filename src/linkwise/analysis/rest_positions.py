"""Static equilibria of a structure, whether they are stable, and starts between wells.

Links between the same two ends act as one bond. If the bonds form no cycle, the forces balance only if each bond is at rest by
itself, so the equilibria are exactly the products of the rest points of the bonds. Otherwise damped Newton iterations start
from every product of rest points. The base is at zero.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, islice, pairwise, product
from math import prod
from typing import overload

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from linkwise.analysis.potential_wells import RestPoint, rest_points, wells
from linkwise.arrays import Bools, Floats
from linkwise.errors import StructureError
from linkwise.model.link import Link, require_rest_at_zero
from linkwise.model.structure import Structure, Weights, refuse_rig

_LIMIT = 4096  # default for the most start points or equilibria
_STEPS = 200  # of Newton's method, which converges only linearly where the stiffness vanishes
_HALVINGS = 30
_AT_REST = 1e-11  # residual force over the largest stiffness times the size of the structure's rest positions
_NEUTRAL = 1e-9  # eigenvalues of the stiffness below this fraction of the largest count as zero
_ELEMENTS = 4_000_000  # of the stiffness matrices held in memory at once


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """A static equilibrium.

    Attributes
    ----------
    x : array of shape (n,)
        Displacements in m.
    stable : bool
        Whether the tangent stiffness has no negative eigenvalue.
    energy : float
        Sum of the potentials of the links in J.
    neutral : int
        Number of zero eigenvalues of the tangent stiffness: rigid-body motions, and directions without stiffness.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.analysis.equilibria(lw.bnes_chain(2))[0].x.round(6).tolist()
    [0.0, -0.01]
    """

    x: Floats
    stable: bool
    energy: float
    neutral: int


@dataclass(frozen=True, eq=False)
class Equilibria(Sequence[Equilibrium]):
    """The equilibria of a structure, a sequence: stable ones first, then by energy.

    Attributes
    ----------
    points : tuple of Equilibrium
        The equilibria.
    complete : bool
        Whether there are no others.
    note : str
        What limits the list; empty if nothing does.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.analysis.equilibria(lw.bnes_chain(2))
    >>> len(found), len(found.stable), found.complete
    (3, 2, True)
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
        """The stable equilibria."""
        return tuple(point for point in self.points if point.stable)


@dataclass(frozen=True)
class _Bond:
    """All links that stretch alike, each with its sign; `weights` are those of masses and modes in the elongation."""

    weights: Weights
    links: tuple[tuple[Link, float], ...]

    @property
    def key(self) -> Hashable:
        """Equal for bonds with equal force laws."""
        return tuple((link.law, tuple(link.values.values()), sign) for link, sign in self.links)

    def force(self, d: Floats) -> Floats:
        forces = (sign * link.force(sign * d, states=link.zero_states) for link, sign in self.links)
        return sum(forces, np.zeros(np.shape(d)))

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
    """Static equilibria of a structure.

    Parameters
    ----------
    structure : Structure
        A structure whose coefficients have values. States of links with memory are 0, where they must rest.
    start : array of shape (n,) or (S, n), optional
        Displacements in m from which to search; by default all combinations of the rest points of the links.
    reach : tuple of two floats, optional
        Range of elongations in m in which the rest points of the links are searched; by default unlimited.
    limit : int, optional
        Largest number of equilibria or start points; those with more wells come first.

    Returns
    -------
    Equilibria
        The equilibria; its `note` says what limits the list.

    Raises
    ------
    StructureError
        If a coefficient has no value, a state of a link does not rest at 0, `start` does not have n finite displacements, or
        `limit` is less than 1.

    Examples
    --------
    >>> import linkwise as lw
    >>> points = lw.analysis.equilibria(lw.bnes_chain(2))
    >>> len(points), len(points.stable)
    (3, 2)
    """
    refuse_rig(structure, "equilibria and modes")
    require_rest_at_zero(structure.links, "equilibria and modes")
    if limit < 1:
        raise StructureError(f"limit must be at least 1, got {limit}")
    network = _Network.of(structure)
    if start is not None:
        starts = np.atleast_2d(np.asarray(start, dtype=float))
        if starts.ndim != 2 or starts.shape[1] != structure.size or not np.isfinite(starts).all():
            message = f"`start` must have {structure.size} finite displacements in m, one for each mass"
            raise StructureError(message)
        size, note = float(np.abs(starts).max()), "searched from the given start points only"
        return _from_starts(network, starts, size, note)
    rests = _bond_rests(network.bonds, reach)
    count = prod(len(rest) or 1 for rest in rests)
    many = str(count) if count < 10**6 else f"1e{len(str(count)) - 1}"
    used = f"only {limit} of {many} combinations of rest points were used, wells first"
    cut = used if count > limit else ""
    choices = list(islice(_wells_first(rests), limit))
    places = np.array([[point.d if point else 0.0 for point in choice] for choice in choices])
    places = places.reshape(len(choices), -1)
    if rests and network.free == structure.size - len(rests):
        return _of_products(network, rests, choices, places, cut)
    weights = _rest_weights(rests)[:, None]
    starts = np.linalg.lstsq(weights * network.incidence.T, weights * places.T, rcond=None)[0].T
    searched = (
        f"the links form a cycle, so Newton's method searched from {len(starts)} combinations of rest points"
    )
    note = "; ".join(filter(None, [searched, cut]))
    return _from_starts(network, starts, float(np.abs(places).max(initial=0.0)), note)


@dataclass(frozen=True, eq=False)
class _Network:
    """The bonds of a structure, and how much masses and modes have part in their elongations, (n, bonds)."""

    bonds: Sequence[_Bond]
    incidence: Floats

    @classmethod
    def of(cls, structure: Structure) -> _Network:
        """Links by what stretches them; ground and base are one support. Links without elastic force are left out."""
        members: dict[Weights, list[tuple[Link, float]]] = {}
        probe = np.concatenate([-np.logspace(-9, 3, 49), [0.0], np.logspace(-9, 3, 49)])
        for link, column in zip(structure.links, structure.topology.columns, strict=True):
            weights = tuple(sorted(column))
            turned = tuple((mass, -part) for mass, part in weights)
            with np.errstate(all="ignore"):
                elastic = bool(np.any(link.force(probe, states=link.zero_states) != 0.0))
            if elastic:
                own, sign = (turned, -1.0) if turned in members else (weights, 1.0)
                members.setdefault(own, []).append((link, sign))
        incidence = np.zeros((structure.size, len(members)))
        for bond, weights in enumerate(members):
            for mass, part in weights:
                incidence[mass, bond] = part
        return cls([_Bond(weights, tuple(links)) for weights, links in members.items()], incidence)

    @property
    def free(self) -> int:
        """Number of groups of masses that are connected to each other but not to the ground; each has a rigid-body motion."""
        ground = len(self.incidence)
        masses = [[mass for mass, _ in bond.weights] for bond in self.bonds]
        chains = [[ground, *ends] if len(ends) == 1 else ends for ends in masses]
        joined = [pair for chain in chains for pair in pairwise(chain)]
        first, second = ([pair[end] for pair in joined] for end in (0, 1))
        graph = csr_array((np.ones(len(joined)), (first, second)), shape=(ground + 1, ground + 1))
        return int(connected_components(graph, directed=False)[0]) - 1

    def each(self, quantity: Callable[[_Bond, Floats], Floats], x: Floats) -> Floats:
        """(S, bonds) a quantity of every bond at displacements (S, n) in m."""
        d = x @ self.incidence
        for column, bond in enumerate(self.bonds):
            d[:, column] = quantity(bond, d[:, column])
        return d

    def residual(self, x: Floats) -> Floats:
        """Force (S, n) in N of the links on each mass, with reversed sign."""
        return self.each(_Bond.force, x) @ self.incidence.T

    def stiffness(self, x: Floats) -> Floats:
        """Tangent stiffness (S, n, n) in N/m."""
        return (self.incidence * self.each(_Bond.slope, x)[:, None]) @ self.incidence.T


def _bond_rests(bonds: Sequence[_Bond], reach: tuple[float, float] | None) -> list[tuple[RestPoint, ...]]:
    lo, hi = (None, None) if reach is None else reach
    known: dict[Hashable, tuple[RestPoint, ...]] = {}  # equal bonds are searched once
    for bond in bonds:
        try:
            if bond.key not in known:
                known[bond.key] = rest_points(bond.force, bond.slope, lo, hi)
        except StructureError as error:
            raise StructureError(f"{error.message} (`reach`)", f'link "{bond.links[0][0].name}"') from None
    return [known[bond.key] for bond in bonds]


def _wells_first(rests: Sequence[tuple[RestPoint, ...]]) -> Iterator[tuple[RestPoint | None, ...]]:
    """Every choice of one rest point for each bond (None where it has none), those with fewer maxima first."""
    wells = [tuple(point for point in rest if point.well) for rest in rests]
    maxima = [tuple(point for point in rest if not point.well) for rest in rests]
    forced = [index for index, rest in enumerate(rests) if not wells[index] and rest]
    free = [index for index in range(len(rests)) if wells[index] and maxima[index]]
    for count in range(len(free) + 1):
        for chosen in combinations(free, count):
            at_maximum = {*chosen, *forced}
            allowed = (maxima[i] if i in at_maximum else wells[i] for i in range(len(rests)))
            yield from product(*(points or (None,) for points in allowed))


def _rest_weights(rests: Sequence[tuple[RestPoint, ...]]) -> Floats:
    """Weight (bonds,) of the rest point of each bond against the others: the root of its stiffness there."""
    stiffest = [max((abs(point.stiffness) for point in rest), default=0.0) for rest in rests]
    largest = max(stiffest, default=0.0) or 1.0
    return np.sqrt(np.maximum(np.array(stiffest) / largest, [1e-12 if rest else 0.0 for rest in rests]))


def _of_products(
    network: _Network,
    rests: Sequence[tuple[RestPoint, ...]],
    choices: Sequence[tuple[RestPoint | None, ...]],
    places: Floats,
    cut: str,
) -> Equilibria:
    """The products of rest points. By Sylvester's law of inertia B diag(k) B' has as many negative eigenvalues as k."""
    restless = [bond.links[0][0].name for bond, rest in zip(network.bonds, rests, strict=True) if not rest]
    if restless:
        note = f'there is no equilibrium: the force of link "{restless[0]}" vanishes nowhere'
        return Equilibria((), True, note)
    free = len(network.incidence) - len(rests)
    spread = np.linalg.pinv(network.incidence.T) if free else np.linalg.inv(network.incidence.T)
    x = places @ spread.T
    energy = network.each(_Bond.potential, x).sum(axis=1)
    points = []
    for row, choice in enumerate(choices):
        k = np.array([point.stiffness for point in choice if point])
        flat = int(np.sum(np.abs(k) <= _NEUTRAL * np.abs(k).max()))
        stable = all(point.well for point in choice if point)
        points.append(Equilibrium(x[row], stable, float(energy[row]), free + flat))
    return Equilibria(_stable_first(points), not cut, "; ".join(filter(None, [cut, _rigid_body_note(free)])))


def _from_starts(network: _Network, starts: Floats, size: float, note: str) -> Equilibria:
    """Newton's method from every row of `starts`; `size` in m is the scale of displacements."""
    chunk = max(1, _ELEMENTS // len(network.incidence) ** 2)
    chunks = (starts[first : first + chunk] for first in range(0, len(starts), chunk))
    ends, converged = zip(*(_newton(network, chunk, size) for chunk in chunks), strict=True)
    x, done = np.concatenate(ends), np.concatenate(converged)
    size = max(size, float(np.abs(x[done]).max(initial=0.0)))
    distinct: list[Floats] = []
    for candidate in x[done]:
        if not any(np.abs(candidate - previous).max() <= 1e-6 * size for previous in distinct):
            distinct.append(candidate)
    points = []
    for place in distinct:
        values = np.linalg.eigvalsh(network.stiffness(place[None])[0])
        threshold = _NEUTRAL * np.abs(values).max()
        energy = float(network.each(_Bond.potential, place[None]).sum())
        stable, neutral = bool(np.all(values >= -threshold)), int(np.sum(np.abs(values) <= threshold))
        points.append(Equilibrium(place, stable, energy, neutral))
    failed = f"{int(np.sum(~done))} of {len(done)} searches did not converge" if not done.all() else ""
    notes = "; ".join(filter(None, [note, failed, _rigid_body_note(network.free)]))
    return Equilibria(_stable_first(points), False, notes)


def _newton(network: _Network, x: Floats, size: float) -> tuple[Floats, Bools]:
    """End (S, n) of each search, and whether (S,) forces balance there. Steps are halved until the residual decreases."""
    x = x.copy()
    done = np.zeros(len(x), dtype=bool)
    active = np.arange(len(x))
    for _ in range(_STEPS):
        residual, stiffness = network.residual(x[active]), network.stiffness(x[active])
        largest, widest = np.abs(stiffness).max(axis=(1, 2)), np.maximum(size, np.abs(x[active]).max(axis=1))
        balanced = np.abs(residual).max(axis=1) <= _AT_REST * largest * widest
        done[active[balanced]] = True
        going = ~balanced & np.isfinite(residual).all(axis=1) & np.isfinite(largest)
        active, residual, stiffness = active[going], residual[going], stiffness[going]
        if active.size == 0:
            break
        step = -np.einsum("sij,sj->si", np.linalg.pinv(stiffness, rcond=1e-12, hermitian=True), residual)
        norm = np.linalg.norm(residual, axis=1)
        scale = np.ones(len(active))
        for _ in range(_HALVINGS):
            with np.errstate(all="ignore"):  # a step that overflows is halved
                tried = np.linalg.norm(network.residual(x[active] + scale[:, None] * step), axis=1)
            worse = ~(tried < norm)
            if not worse.any():
                break
            scale[worse] *= 0.5
        x[active] += scale[:, None] * step
    return x, done


def _stable_first(points: Sequence[Equilibrium]) -> tuple[Equilibrium, ...]:
    """Stable ones first, then by energy, then by displacement; energies equal up to rounding count as equal."""
    unit = max((abs(point.energy) for point in points), default=0.0) * 1e-9 or 1.0
    return tuple(sorted(points, key=lambda one: (not one.stable, round(one.energy / unit), tuple(one.x))))


def _rigid_body_note(free: int) -> str:
    motions = f"{free} rigid-body motion{'s' if free > 1 else ''} without elastic resistance"
    return f"{motions}; displacements are those with the least sum of squares" if free else ""


_GRID = 65  # elongations between the outer wells, among which the force is largest
_SLOW = 1e-6  # of the largest force between the wells: less is none


def hilltop_finding(structure: Structure, x: Floats) -> str:
    """A sentence on links that start on a hilltop at the displacements `x` (n,) of masses, and which start them in wells.

    Empty where there are none. The base is taken to start at 0.
    """
    places = {"ground": 0.0, "base": 0.0} | dict(zip(structure.mass_names, map(float, x), strict=True))
    links = [link for link in structure.links if set(link.between) <= set(places)]
    d = {link.name: places[link.between[0]] - places[link.between[1]] for link in links}
    tops = [link for link in links if _is_hilltop(link, d[link.name])]
    releases = {}
    for link in tops:
        moved = _moved_mass(structure, link)
        if moved is None:
            continue
        bottoms = np.array(wells(link))[::-1]
        well = float(bottoms[np.argmin(np.abs(bottoms - d[link.name]))])
        first, second = link.between
        places[moved] = places[second] + well if moved == first else places[first] - well
        releases[moved] = places[moved]
    if not releases:
        return ""
    names = ", ".join(link.name for link in tops)
    starts = ", ".join(f"x:{mass}={place:.4g}" for mass, place in releases.items())
    several = len(tops) > 1
    return (
        f"{names} start{'' if several else 's'} on the top of {'their barriers' if several else 'its barrier'} between two "
        f"wells, where the least disturbance decides what follows; to start in {'wells' if several else 'a well'}, add the "
        f"release {starts}."
    )


def _is_hilltop(link: Link, d: float) -> bool:
    """Whether a link has no force at an elongation in m between two of its wells, and none of these is there."""
    try:
        places = wells(link)
    except StructureError:  # a periodic law, or one whose coefficients have no values
        return False
    if len(places) < 2 or not places[0] < d < places[-1]:
        return False
    force = np.abs(link.force(np.linspace(places[0], places[-1], _GRID), states=link.zero_states)).max()
    near = min(abs(d - place) for place in places) < _SLOW * (places[-1] - places[0])
    return not near and bool(abs(link.force(d, states=link.zero_states)) < _SLOW * force)


def _moved_mass(structure: Structure, link: Link) -> str | None:
    """The mass that a release moves: that of fewer links, else the lighter one."""
    weights = dict(zip(structure.mass_names, structure.mass_values, strict=True))
    ends = [end for end in link.between if end in weights]
    count = {end: sum(end in other.between for other in structure.links) for end in ends}
    return min(ends, key=lambda end: (count[end], float(weights[end])), default=None)
