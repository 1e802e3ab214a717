"""The weak equations of a few neighbouring masses, as one small dense system.

For mass i the equation of motion m x'' + sum_l B_il f_l - w = 0, multiplied by a test function phi and integrated over its
window, is a sum of known functions of the record, each multiplied by one number:

    m_i int phi'' x_i  +  sum_l B_il sum_a c_a int kernel_a h_a(d_l)  -  int phi w_i  =  0

The terms of the links (`LawTerms`) come first, those of inertia and applied forces follow. A term enters the equations of the
masses at both ends of its link with opposite signs, and the bias of products of terms does not depend on the mass, so a patch
of masses needs one set of products.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.weak.displacements import MeasuredDisplacements
from linkwise.weak.eliminated import BalanceChange
from linkwise.weak.layout import StructureLayout
from linkwise.weak.noise_bias import noise_bias
from linkwise.weak.patch_layout import PatchLayout
from linkwise.weak.rate_bias import rate_bias
from linkwise.weak.terms import LawTerms, law_terms
from linkwise.weak.weak_form import INNER, PHI_2, WeakPart, none_alone
from linkwise.weak.window import Window


@dataclass(frozen=True, eq=False)
class Patch:
    """The equations of some masses, one for each window: signs (m, q) times coefficients times rows (q, R) is zero.

    The coefficient of a term is its parameter, if it has one, plus `fixed`.

    Attributes
    ----------
    layout : PatchLayout
        The terms.
    fixed : array of shape (q,)
        Known parts of the coefficients.
    rows : array of shape (q, R)
        The terms in all windows; zero in windows with missing samples.
    products : array of shape (q, q)
        Products of the rows, summed over windows; 0 between different terms that are tested alone.
    moments : array of shape (q, q)
        The products without the bias due to noise.
    valid : array of shape (R,)
        1 for windows without a missing sample, 0 for others.
    slopes : array of shape (q, K)
        Slopes of the terms with respect to d at the centre of every `PatchContext.slope_stride`-th window.
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
        """(m,) indices of the masses."""
        return self.layout.masses

    @property
    def signs(self) -> Floats:
        """(m, q) signs of the terms in the equations."""
        return self.layout.signs

    @property
    def windows(self) -> float:
        """Number of valid windows."""
        return float(self.valid.sum())

    def numbers(self, values: Floats) -> Floats:
        """Coefficients of the terms.

        Parameters
        ----------
        values : array of shape (p,)
            The parameters.

        Returns
        -------
        array of shape (q,)
            The coefficients.
        """
        return np.append(values, 0.0)[self.layout.coefficients.parameter] + self.fixed

    def residual(self, values: Floats) -> Floats:
        """Residuals of the equations.

        Parameters
        ----------
        values : array of shape (p,)
            The parameters.

        Returns
        -------
        array of shape (m, R)
            The residuals, in units of the rows.
        """
        return np.asarray((self.signs * self.numbers(values)) @ self.rows)

    def largest(self, numbers: Floats | float = 1.0) -> Floats:
        """Sum of squares of the largest term of each mass.

        Parameters
        ----------
        numbers : array of shape (q,) or float, optional
            Coefficients of the terms.

        Returns
        -------
        array of shape (m,)
            The sums.
        """
        return np.asarray(np.max(np.abs(self.signs) * self.products.diagonal() * np.square(numbers), axis=1))


@dataclass(frozen=True, eq=False)
class PatchContext:
    """Data that all patches of a record share.

    Attributes
    ----------
    structure_layout : StructureLayout
        Layout of the structure.
    values : array of shape (p,)
        Present values of the parameters; NaN where they have none.
    motion : MeasuredDisplacements
        Displacements and their noise.
    window : Window
        The test functions.
    rate_window : Window
        What smooths the rates that laws act by.
    filtered : array of shape (K, n + 2, R)
        Displacements of masses, base and ground under the kernels.
    forces : mapping of int to array of shape (K', R)
        Negative applied forces under phi, by mass, and under the phi behind that where a state is eliminated.
    slope_stride : int
        Stride in windows of `Patch.slopes`.
    alone : callable
        Whether the terms of a part are tested one at a time, so that nobody asks for their products with each other.
    """

    structure_layout: StructureLayout
    values: Floats
    motion: MeasuredDisplacements
    window: Window
    rate_window: Window
    filtered: Floats
    forces: Mapping[int, Floats]
    slope_stride: int
    alone: Callable[[WeakPart], bool] = none_alone

    @cached_property
    def elongation_variance(self) -> Floats:
        """(L,) variances in m^2 of the noise in the elongations of the links."""
        return self.structure_layout.elongation_variance(self.motion)

    @cached_property
    def floored_elongation_variance(self) -> Floats:
        """(L,) the same, with `MeasuredDisplacements.floored_variance`."""
        return self.structure_layout.elongation_variance(self.motion, floored=True)

    def patch(self, masses: Sequence[int], valid: Floats) -> Patch:
        """Equations of some masses.

        Parameters
        ----------
        masses : sequence of int
            Indices of the m masses.
        valid : array of shape (R,)
            Weights of the windows.

        Returns
        -------
        Patch
            The equations.
        """
        layout = self.structure_layout.layout(masses, (mass for mass in masses if mass in self.forces))
        evaluated, slope = self.evaluated(layout)
        rows = self._rows(layout, evaluated)
        if not valid.all():
            rows *= valid
        products = self._products(rows, layout)
        bias = self.bias(layout, evaluated, slope, valid)
        present = np.append(self.values, 0.0)[layout.coefficients.parameter]
        return Patch(
            layout=layout,
            fixed=np.where(layout.coefficients.parameter < 0, layout.coefficients.known, 0.0)
            - np.where(layout.increment, present, 0.0),
            rows=rows,
            products=products,
            moments=products - bias,
            valid=valid,
            slopes=self._slopes(layout, slope, evaluated),
        )

    def bias(
        self, layout: PatchLayout, evaluated: Sequence[LawTerms], slope: Floats, valid: Floats
    ) -> Floats:
        """Bias of the products of all terms due to noise.

        Parameters
        ----------
        layout : PatchLayout
            The q terms.
        evaluated : sequence of LawTerms
            Those of laws, at the samples under the windows.
        slope : array of shape (q,)
            Slopes of all terms where they are constant, 0 for others.
        valid : array of shape (R,)
            Weights of the windows.

        Returns
        -------
        array of shape (q, q)
            The bias.
        """
        change = self._change(layout)
        whole, terms, slopes = layout, [*evaluated], slope
        if change is not None:
            whole, slopes = change.layout, np.append(slope, slope[change.twins])
            terms += change.terms(evaluated)
        noise = self.motion.covariance(layout.nodes)
        curved = [of_law for of_law in terms if not isinstance(of_law.slope, float)]
        bias = noise_bias(whole, curved, slopes, noise, self.window, valid, self.alone)
        bias += rate_bias(
            whole, terms, slopes, noise, self.window, valid, self.rate_window.slope[0], self.alone
        )
        return bias if change is None else change.joined(bias)

    def _change(self, layout: PatchLayout) -> BalanceChange | None:
        """What a change of the a of an eliminated state adds to equations; None where they have no such term."""
        if layout.eliminating.start == layout.eliminating.stop:
            return None
        relaxation = self.structure_layout.relaxation(self.values)
        numbers = layout.coefficients.at(self.values) if len(self.values) else layout.coefficients.known
        numbers = np.where(layout.increment, 0.0, numbers)
        return BalanceChange.of(layout, numbers, {} if relaxation is None else relaxation[1])

    def _products(self, rows: Floats, layout: PatchLayout) -> Floats:
        """(q, q) products of the rows (q, R); zero between different terms that are tested alone."""
        alone = [
            range(terms.terms.start, terms.terms.stop)
            for terms in layout.group_terms
            if self.alone(terms.part)
        ]
        if not alone:
            return rows @ rows.T
        tested = np.concatenate([np.array(some) for some in alone])
        others = np.delete(np.arange(len(rows)), tested)
        products = np.zeros((len(rows), len(rows)))
        products[others] = rows[others] @ rows.T
        products[:, others] = products[others].T
        products[tested, tested] = np.einsum("ij,ij->i", rows, rows)[tested]
        return products

    def evaluated(self, layout: PatchLayout) -> tuple[list[LawTerms], Floats]:
        """Terms of the laws at every sample.

        Parameters
        ----------
        layout : PatchLayout
            The q terms.

        Returns
        -------
        terms : list of LawTerms
            Those of laws.
        slopes : array of shape (q,)
            Slopes of all terms where they are constant, 0 for others.
        """
        displacements, variance = self.motion.displacements, self.elongation_variance
        evaluated = law_terms(
            self.structure_layout,
            layout,
            self.values,
            elongations=lambda links: self.structure_layout.elongations(displacements, links),
            rates=self._rates,
            variance=lambda links: variance[links],
            rate_noise=float(np.linalg.norm(self.rate_window.slope)),
        )
        return evaluated, _constant_slopes(layout, evaluated)

    def _rates(self, d: Floats) -> Floats:
        """(m, N) v from d (m, N), held at the edges."""
        single = replace(self.rate_window, stride=1)
        inner = single.filter(d, single.slope)[0]
        return np.pad(inner, ((0, 0), (single.half, single.half)), mode="edge")

    def _rows(self, layout: PatchLayout, evaluated: Sequence[LawTerms]) -> Floats:
        """(q, R): the terms in all windows."""
        rows, change = self._plain_rows(layout, evaluated), self._change(layout)
        if change is not None:
            under_phi = self._plain_rows(layout, evaluated, INNER)
            rows[layout.eliminating] = change.sums @ under_phi[change.twins]
        return rows

    def _plain_rows(self, layout: PatchLayout, evaluated: Sequence[LawTerms], behind: int = 0) -> Floats:
        """(q, R): the terms under the kernels that stand `behind` those of the equations; 0 where there is none."""
        rows = np.zeros((len(layout.kernel), self.filtered.shape[2]))
        for terms in evaluated:
            kernel, sign, first = terms.part.kernel + behind, terms.signed[0], terms.derivatives[0]
            if kernel >= len(self.filtered):
                continue
            if terms.part.plain:
                rows[terms.terms] = self.structure_layout.elongations(self.filtered[kernel], terms.links)
                rows[terms.terms] *= sign
            elif isinstance(first, float):
                rows[terms.terms] = sign * first * self.window.kernels[kernel].sum()
            else:
                rows[terms.terms] = self.window.filter(
                    first, sign * self.window.kernels[kernel : kernel + 1]
                )[0]
        forces = len(rows) - len(layout.forced)
        rows[forces - len(layout.masses) : forces] = self.filtered[PHI_2 + behind, layout.masses]
        for row, mass in enumerate(layout.forced, start=forces):
            rows[row] = self.forces[mass][behind // INNER]
        return rows

    def _slopes(self, layout: PatchLayout, constant: Floats, evaluated: Sequence[LawTerms]) -> Floats:
        """(q, K): slopes of the terms' functions at the centres of every `slope_stride`-th window."""
        curved = [terms for terms in evaluated if not isinstance(terms.slope, float)]
        centres = (
            self.window.half + np.arange(0, self.filtered.shape[2], self.slope_stride) * self.window.stride
        )
        slopes = np.repeat(constant[:, None], len(centres), axis=1)
        for terms in curved:
            slopes[terms.terms] = terms.signed[1] * np.asarray(terms.slope)[:, centres]
        change = self._change(layout)
        if change is not None:
            slopes[layout.eliminating] = change.slopes(slopes)
        return slopes


def _constant_slopes(layout: PatchLayout, evaluated: Sequence[LawTerms]) -> Floats:
    """(q,) slopes of the terms by d where they are constant, 0 for others; that of inertia is by x."""
    slopes = np.zeros(len(layout.kernel))
    for terms in evaluated:
        if isinstance(terms.slope, float):
            slopes[terms.terms] = terms.part.sign * terms.slope
    forces = len(slopes) - len(layout.forced)
    slopes[forces - len(layout.masses) : forces] = 1.0
    return slopes
