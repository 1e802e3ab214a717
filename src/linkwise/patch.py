"""The weak equations of a few masses that lie together, as one small dense system.

For mass i the equation of motion m x'' + sum_l B_il f_l - w = 0, multiplied by a test function phi and integrated over its
window, is a sum of known functions of the record, each times one number:

    m_i int phi'' x_i  +  sum_l B_il sum_a c_a int kernel_a h_a(d_l)  -  int phi w_i  =  0

The terms of the links are `atoms`; inertia and applied forces follow them. A term serves the masses at both ends of its link,
with opposite signs, and what noise does to the products of terms does not depend on the mass either. So a patch of masses
has one set of products, and a structure of any size is a row of patches.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from linkwise.atoms import Atoms, Unknowns, link_atoms
from linkwise.motion import SeenMotion, differences
from linkwise.noisebias import Straight, noise_bias
from linkwise.structure import Structure
from linkwise.weakform import PHI, PHI_2
from linkwise.window import Window

Floats = NDArray[np.float64]
Places = NDArray[np.intp]

_GROUND = -1


@dataclass(frozen=True, eq=False)
class Patch:
    """The equations of `masses` (m,), one a window: `signs` (m, q) times the terms' numbers times `rows` (q, R) is zero.

    The number of a term is parameter number `parameter` (q,), none where that is -1, plus `fixed` (q,). `products` (q, q) are
    sums of the products of the rows, `moments` the same without the bias of noise. `valid` (R,) is 1 for windows without a
    missing sample; `rows` are zero in others. `slopes` (q, K) are what the terms' functions have by d, kernel `kernel` (q,)
    aside, at the centre of every `Scene.every`-th window. `links` (l,) hold the masses, `holds` (m, l) is their incidence and
    `others` (m, l) what they hold on to at the other end (-1, the ground, for links that do not hold the mass).
    """

    masses: Places
    links: Places
    holds: Floats
    others: Places
    kernel: Places
    signs: Floats
    parameter: Places
    fixed: Floats
    rows: Floats
    products: Floats
    moments: Floats
    valid: Floats
    slopes: Floats

    @property
    def windows(self) -> float:
        """How many windows are valid."""
        return float(self.valid.sum())

    def numbers(self, values: Floats) -> Floats:
        """(q,) the terms' numbers at the parameters (p,)."""
        return np.append(values, 0.0)[self.parameter] + self.fixed

    def residual(self, values: Floats) -> Floats:
        """(m, R) what the equations leave at the parameters (p,)."""
        return np.asarray((self.signs * self.numbers(values)) @ self.rows)

    @property
    def asks(self) -> bool:
        """Whether the equations hold a parameter."""
        return len(self.asked) > 0

    @cached_property
    def asked(self) -> Places:
        """The terms with a parameter."""
        return np.flatnonzero(self.parameter >= 0)

    def largest(self, numbers: Floats | float = 1.0) -> Floats:
        """(m,) the sum of squares of the largest term of each mass."""
        return np.asarray(np.max(np.abs(self.signs) * self.products.diagonal() * np.square(numbers), axis=1))


@dataclass(frozen=True, eq=False)
class Scene:
    """What all patches are cut from.

    `ends` (L, 2) are the indices of the links' ends, -1 the ground and -2 the base; `smooth` (3, n + 2, R) their displacements
    under the kernels of `window`; `pushes` the negative applied forces (R,) under phi by mass; every `every`-th window tells
    `Patch.slopes`.
    """

    structure: Structure
    unknowns: Unknowns
    motion: SeenMotion
    window: Window
    ends: Places
    smooth: Floats
    pushes: Mapping[int, Floats]
    every: int

    def patch(self, masses: Places, links: Places, valid: Floats) -> Patch:
        """The patch of `masses` (m,), which `links` (l,) hold, in windows weighted by `valid` (R,)."""
        atoms = link_atoms(
            self.structure,
            links,
            self.unknowns,
            elongations=lambda which: self.motion.between(self.ends[which]),
            rates=self._rates,
            variance=lambda which: self.motion.noise[self.ends[which]].sum(axis=1),
        )
        forced = [mass for mass in masses.tolist() if mass in self.pushes]
        kernel = np.repeat(
            [*(each.part.kernel for each in atoms), PHI_2, PHI],
            [*(len(each.links) for each in atoms), len(masses), len(forced)],
        )
        signs, holds, covariance = self._incidence(atoms, masses, links, forced)
        rows = self._rows(atoms, masses, forced, len(kernel))
        if not valid.all():
            rows *= valid
        products = rows @ rows.T
        placed = list(zip(_slices(atoms), atoms, strict=True))
        curved = [(place, each) for place, each in placed if not isinstance(each.slope, float)]
        straight = Straight(kernel, _straight_slopes(atoms, len(masses), len(forced)), covariance)
        bias = noise_bias(straight, curved, self.window, valid, self.motion.ends.shape[1])
        parameter, fixed = self._numbers(atoms, masses.tolist(), len(forced))
        return Patch(
            masses=masses,
            links=links,
            holds=holds,
            others=np.where(holds == 0.0, _GROUND, self.ends[links].sum(axis=1) - masses[:, None]),
            kernel=kernel,
            signs=signs,
            parameter=parameter,
            fixed=fixed,
            rows=rows,
            products=products,
            moments=products - bias,
            valid=valid,
            slopes=self._slopes(straight.slope, curved),
        )

    def _incidence(
        self, atoms: Sequence[Atoms], masses: Places, links: Places, forced: Sequence[int]
    ) -> tuple[Floats, Floats, Floats]:
        """The signs (m, q) of the terms in the equations of the masses, those of the links (m, l), and the covariance (q, q)
        of the noises in the displacements between the terms' ends.
        """
        ends = np.concatenate(
            [
                *(self.ends[each.links] for each in atoms),
                np.stack([masses, np.full(len(masses), _GROUND)], axis=1),
                np.full((len(forced), 2), _GROUND),
                self.ends[links],
            ]
        )
        nodes, at = np.unique(ends, return_inverse=True)
        every, at = np.arange(len(ends)), at.reshape(ends.shape)
        incidence = np.zeros((len(ends), len(nodes)))
        incidence[every, at[:, 0]] += 1.0
        incidence[every, at[:, 1]] -= 1.0
        terms = incidence[: len(ends) - len(links)]
        covariance = (terms * self.motion.noise[nodes]) @ terms.T
        signs, holds = np.split(incidence[:, np.searchsorted(nodes, masses)].T.copy(), [len(terms)], axis=1)
        signs[:, len(terms) - len(forced) :] = masses[:, None] == np.array(forced, dtype=int)
        return signs, holds, covariance

    def _rates(self, d: Floats) -> Floats:
        """(m, N) v from d (m, N), held at the edges."""
        single = Window(self.window.half, 1, self.window.step)
        inner = single.filter(d, single.slope)[0]
        return np.pad(inner, ((0, 0), (self.window.half, self.window.half)), mode="edge")

    def _rows(self, atoms: Sequence[Atoms], masses: Places, forced: Sequence[int], count: int) -> Floats:
        """(count, R): the atoms, the inertia of all masses, the forces."""
        rows = np.empty((count, self.smooth.shape[2]))
        for place, each in zip(_slices(atoms), atoms, strict=True):
            kernel, first = each.part.kernel, each.chain[0]
            if each.part.plain:
                ends = self.ends[each.links]
                rows[place] = differences(
                    self.smooth[kernel], ends if each.part.sign > 0.0 else ends[:, ::-1]
                )
            elif isinstance(first, float):
                rows[place] = each.part.sign * first * self.window.kernels[kernel].sum()
            else:
                kernels = each.part.sign * self.window.kernels[kernel : kernel + 1]
                rows[place] = self.window.filter(first, kernels)[0]
        first_force = count - len(forced)
        rows[first_force - len(masses) : first_force] = self.smooth[PHI_2, masses]
        for row, mass in enumerate(forced, start=first_force):
            rows[row] = self.pushes[mass]
        return rows

    def _numbers(self, atoms: Sequence[Atoms], masses: Sequence[int], forces: int) -> tuple[Places, Floats]:
        """(q,) parameters and (q,) fixed numbers of the terms."""
        places = [self.unknowns.places.get((-1 - mass, "mass"), (-1, None))[0] for mass in masses]
        known = [
            self.unknowns.mass(self.structure.masses, mass) if place < 0 else 0.0
            for mass, place in zip(masses, places, strict=True)
        ]
        parameter = np.concatenate([*(each.parameter for each in atoms), places, np.full(forces, -1)])
        fixed = np.concatenate([*(each.fixed for each in atoms), known, np.ones(forces)])
        return parameter.astype(np.intp), fixed

    def _slopes(self, straight: Floats, curved: Sequence[tuple[slice, Atoms]]) -> Floats:
        """(q, K): slopes of the terms' functions at the centres of every `every`-th window."""
        centres = self.window.half + np.arange(0, self.smooth.shape[2], self.every) * self.window.stride
        slopes = np.repeat(straight[:, None], len(centres), axis=1)
        for place, each in curved:
            slopes[place] = each.part.sign * np.asarray(each.slope)[:, centres]
        return slopes


def _slices(atoms: Sequence[Atoms]) -> list[slice]:
    """Where each of the atoms stands among the terms."""
    stops = np.cumsum([len(each.links) for each in atoms], dtype=int).tolist()
    return [slice(start, stop) for start, stop in zip([0, *stops], stops, strict=False)]


def _straight_slopes(atoms: Sequence[Atoms], masses: int, forces: int) -> Floats:
    """(q,) slopes by d of the terms where they are constant, 0 for others; that of inertia is by x."""
    slopes = [each.part.sign * each.slope if isinstance(each.slope, float) else 0.0 for each in atoms]
    return np.asarray(np.repeat([*slopes, 1.0, 0.0], [*(len(each.links) for each in atoms), masses, forces]))
