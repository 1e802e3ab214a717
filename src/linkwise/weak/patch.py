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

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.weak.displacements import MeasuredDisplacements, differences
from linkwise.weak.layout import PatchLayout, StructureLayout
from linkwise.weak.noise_bias import noise_bias
from linkwise.weak.terms import LawTerms, law_terms
from linkwise.weak.weak_form import PHI_2
from linkwise.weak.window import Window


@dataclass(frozen=True, eq=False)
class Patch:
    """The equations of the masses of `layout`, one a window: `signs` (m, q) times the terms' numbers times `rows` (q, R) is
    zero.

    The number of a term is its parameter, if it has one, plus `fixed` (q,). `products` (q, q) are sums of the products of
    the rows, `moments` the same without the bias of noise. `valid` (R,) is 1 for windows without a missing sample; `rows`
    are zero in others. `slopes` (q, K) are slopes by d of the terms' functions at the centre of every
    `PatchContext.slope_stride`-th window.
    """

    layout: PatchLayout
    fixed: Floats
    rows: Floats
    products: Floats
    moments: Floats
    valid: Floats
    slopes: Floats

    @property
    def masses(self) -> Indices:
        """(m,)"""
        return self.layout.masses

    @property
    def signs(self) -> Floats:
        """(m, q)"""
        return self.layout.signs

    @property
    def windows(self) -> float:
        """How many windows are valid."""
        return float(self.valid.sum())

    def numbers(self, values: Floats) -> Floats:
        """(q,) the terms' numbers at the parameters (p,)."""
        return np.append(values, 0.0)[self.layout.coefficients.parameter] + self.fixed

    def residual(self, values: Floats) -> Floats:
        """(m, R) what the equations leave at the parameters (p,)."""
        return np.asarray((self.signs * self.numbers(values)) @ self.rows)

    def largest(self, numbers: Floats | float = 1.0) -> Floats:
        """(m,) the sum of squares of the largest term of each mass."""
        return np.asarray(np.max(np.abs(self.signs) * self.products.diagonal() * np.square(numbers), axis=1))


@dataclass(frozen=True, eq=False)
class PatchContext:
    """What all patches are cut from.

    `filtered` (3, n + 2, R) are the displacements of the masses, the base and the ground under the kernels of `window`;
    `forces` the negative applied forces (R,) under phi by mass; `values` (p,) those of the parameters, NaN where they have
    none. Every `slope_stride`-th window tells `Patch.slopes`.
    """

    structure_layout: StructureLayout
    values: Floats
    motion: MeasuredDisplacements
    window: Window
    filtered: Floats
    forces: Mapping[int, Floats]
    slope_stride: int

    def patch(self, masses: Sequence[int], valid: Floats) -> Patch:
        """The patch of `masses` (m,) in windows weighted by `valid` (R,)."""
        layout = self.structure_layout.layout(masses, (mass for mass in masses if mass in self.forces))
        ends, noise = self.structure_layout.ends, self.motion.noise_variance
        atoms = law_terms(
            self.structure_layout,
            layout,
            self.values,
            elongations=lambda links: differences(self.motion.displacements, ends[links]),
            rates=self._rates,
            variance=lambda links: noise[ends[links]].sum(axis=1),
        )
        rows = self._rows(layout, atoms)
        if not valid.all():
            rows *= valid
        products = rows @ rows.T
        slope = _straight_slopes(layout, atoms)
        curved = [each for each in atoms if not isinstance(each.slope, float)]
        bias = noise_bias(layout, curved, slope, noise[layout.nodes], self.window, valid)
        present = np.append(self.values, 0.0)[layout.coefficients.parameter]
        return Patch(
            layout=layout,
            fixed=np.where(layout.coefficients.parameter < 0, layout.coefficients.known, 0.0)
            - np.where(layout.increment, present, 0.0),
            rows=rows,
            products=products,
            moments=products - bias,
            valid=valid,
            slopes=self._slopes(slope, curved),
        )

    def _rates(self, d: Floats) -> Floats:
        """(m, N) v from d (m, N), held at the edges."""
        single = Window(self.window.half, 1, self.window.step)
        inner = single.filter(d, single.slope)[0]
        return np.pad(inner, ((0, 0), (self.window.half, self.window.half)), mode="edge")

    def _rows(self, layout: PatchLayout, atoms: Sequence[LawTerms]) -> Floats:
        """(q, R): the terms in all windows."""
        rows = np.empty((len(layout.kernel), self.filtered.shape[2]))
        for each in atoms:
            kernel, sign, first = each.part.kernel, each.part.sign, each.derivatives[0]
            if each.part.plain:
                ends = self.structure_layout.ends[each.links]
                rows[each.terms] = differences(self.filtered[kernel], ends if sign > 0.0 else ends[:, ::-1])
            elif isinstance(first, float):
                rows[each.terms] = sign * first * self.window.kernels[kernel].sum()
            else:
                rows[each.terms] = self.window.filter(first, sign * self.window.kernels[kernel : kernel + 1])[
                    0
                ]
        forces = len(rows) - len(layout.forced)
        rows[forces - len(layout.masses) : forces] = self.filtered[PHI_2, layout.masses]
        for row, mass in enumerate(layout.forced, start=forces):
            rows[row] = self.forces[mass]
        return rows

    def _slopes(self, straight: Floats, curved: Sequence[LawTerms]) -> Floats:
        """(q, K): slopes of the terms' functions at the centres of every `slope_stride`-th window."""
        centres = (
            self.window.half + np.arange(0, self.filtered.shape[2], self.slope_stride) * self.window.stride
        )
        slopes = np.repeat(straight[:, None], len(centres), axis=1)
        for each in curved:
            slopes[each.terms] = each.part.sign * np.asarray(each.slope)[:, centres]
        return slopes


def _straight_slopes(layout: PatchLayout, atoms: Sequence[LawTerms]) -> Floats:
    """(q,) slopes of the terms by d where they are constant, 0 for others; that of inertia is by x."""
    slopes = np.zeros(len(layout.kernel))
    for each in atoms:
        if isinstance(each.slope, float):
            slopes[each.terms] = each.part.sign * each.slope
    forces = len(slopes) - len(layout.forced)
    slopes[forces - len(layout.masses) : forces] = 1.0
    return slopes
