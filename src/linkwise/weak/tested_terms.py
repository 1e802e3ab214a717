"""Scores of terms of size zero in the weak equations of a patch of masses.

The variance of a score is a sum of squares over time. A part of that of its own normal equation bounds the score from above,
and costs a fraction of the whole; the whole of that equation costs more, and of few scores only; the variance beside the
coefficients of the laws most. Scores that cannot be beyond chance are not computed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array

from linkwise.arrays import Bools, Floats, Indices
from linkwise.weak.equations import WeakEquations
from linkwise.weak.fit import SIGNIFICANT, assemble_blocks, normal_equations, residual_power, significance
from linkwise.weak.layout import StructureLayout
from linkwise.weak.patch import Patch
from linkwise.weak.patch_layout import PatchLayout, TermCoefficients
from linkwise.weak.remainders import Remainders, diagonal_beside, regression
from linkwise.weak.scatter import SlopeStatistics, score_blocks, slopes_along
from linkwise.weak.term_scatter import SingleTerms, linear_scatter, quadratic_scatter

_COLLINEAR = 1e-6  # of its own moment: what is left of a term beside those of the laws
_CANCELLED = 0.1  # of what white noise would give: a smaller variance is the difference of large ones that are not exact


@dataclass(frozen=True, eq=False)
class ScoreTests:
    """The equations of a patch with terms of size zero.

    Attributes
    ----------
    patch : Patch
        The equations, in which the terms of links that are tested have coefficients.
    system : WeakEquations
        All equations of the record.
    values : array of shape (p,)
        The parameters found that are in the equations.
    laws : PatchLayout
        The same links with their laws alone, whose slopes are those of laws with terms of size zero.
    fitted : array of shape (f,)
        The parameters of these.
    columns : array of int, shape (q,)
        The row of the patch that each column is: all of them, and after them once more those on a single mass.
    signs : array of shape (m, q)
        Signs of the columns in the equations.
    parameter : array of int, shape (q,)
        The parameter of each column: first the p that are found, then the t that are tested; -1 for known numbers.
    rows, masses : array of int, shape (t,)
        The row that is tested and, for a term on a single mass, the mass, else -1.
    """

    patch: Patch
    system: WeakEquations
    values: Floats
    laws: PatchLayout
    fitted: Floats
    columns: Indices
    signs: Floats
    parameter: Indices
    rows: Indices
    masses: Indices

    @classmethod
    def of(
        cls, patch: Patch, system: WeakEquations, known: dict[str, float], laws: StructureLayout
    ) -> ScoreTests:
        """The terms that a patch of `system` has beside the parameters that are `known`, which are those of the `laws`."""
        layout, names = patch.layout, system.parameters
        is_estimated = np.array([name in known for name in names], dtype=bool)
        estimated = np.unique(layout.free_parameters[is_estimated[layout.free_parameters]])
        tested = np.unique(layout.free_parameters[~is_estimated[layout.free_parameters]])
        local = np.full(len(names) + 1, -1)
        local[np.concatenate([estimated, tested])] = np.arange(len(estimated) + len(tested))
        parameter = local[layout.coefficients.parameter]
        order = np.argsort(parameter, kind="stable")
        firsts = order[np.searchsorted(parameter[order], len(estimated) + np.arange(len(tested)))]
        own = parameter < len(estimated)
        own[layout.eliminating] = False
        single = np.array(list(_single_terms(layout, own)), dtype=int).reshape(-1, 2)
        alone = np.zeros((len(layout.masses), len(single)))
        alone[single[:, 1], np.arange(len(single))] = 1.0
        return cls(
            patch=patch,
            system=system,
            values=np.array([known[names[number]] for number in estimated], dtype=float),
            laws=laws.layout(layout.masses.tolist(), layout.forced),
            fitted=np.array([known[name] for name in laws.names], dtype=float),
            columns=np.concatenate([np.arange(len(parameter)), single[:, 0]]),
            signs=np.concatenate([layout.signs, alone], axis=1),
            parameter=np.append(parameter, len(estimated) + len(tested) + np.arange(len(single))),
            rows=np.concatenate([firsts, single[:, 0]]),
            masses=np.concatenate([np.full(len(firsts), -1), single[:, 1]]),
        )

    @cached_property
    def terms(self) -> SingleTerms:
        """The terms that are tested."""
        own = self._tested_columns
        return SingleTerms.of(self.columns[own], self.signs[:, own])

    @cached_property
    def _tested_columns(self) -> Indices:
        """(t,) the columns that are tested."""
        own = np.flatnonzero(self.parameter >= len(self.values))
        return own[np.argsort(self.parameter[own], kind="stable")]

    @cached_property
    def _all_values(self) -> Floats:
        """The parameters of the system; 0 for those that are tested."""
        values = np.zeros(len(self.system.parameters))
        parameter = self.patch.layout.coefficients.parameter
        local = self.parameter[: len(parameter)]
        known = (local >= 0) & (local < len(self.values))
        values[parameter[known]] = self.values[local[known]]
        return values

    @cached_property
    def _weights(self) -> Floats:
        """(m,) weights of the masses."""
        return 1.0 / residual_power(self.patch, self._all_values)

    def largest(self, excess: float, uncertain: float, least: float) -> tuple[int, float] | None:
        """The number of the term with the largest score, and that score in standard errors.

        Parameters
        ----------
        excess : float
            Power of the residuals over that expected from noise.
        uncertain : float
            Relative error of the power of the noise.
        least : float
            The square that the score exceeds.

        Returns
        -------
        tuple of (int, float) or None
            None where no score is so large.
        """
        numbers = np.flatnonzero(~(self.bounds(excess, uncertain) <= least))
        if len(numbers):
            numbers = numbers[~(self.bounds(excess, uncertain, numbers) <= least)]
        if not len(numbers):
            return None
        scores = np.nan_to_num(self.scores(numbers, excess, uncertain))
        best = int(np.argmax(np.abs(scores)))
        return (int(numbers[best]), float(scores[best])) if scores[best] ** 2 > least else None

    def bounds(self, excess: float, uncertain: float, numbers: Indices | None = None) -> Floats:
        """What the squares of scores cannot exceed, from a part of the variances of their normal equations.

        Parameters
        ----------
        excess, uncertain : float
            As of `largest`.
        numbers : array of int, shape (s,), optional
            Terms for which it is the whole of these variances; a part for all terms by default.

        Returns
        -------
        array of shape (t,) or (s,)
            The squares.
        """
        if numbers is None:
            return self._beside.squares(excess, uncertain, self._part() + self._quadratic)
        scatter = np.zeros(len(self.rows))
        scatter[numbers] = self._whole(numbers) + self._quadratic[numbers]
        return self._beside.squares(excess, uncertain, scatter)[numbers]

    @cached_property
    def _slopes(self) -> Floats:
        """(2, l, P) mean slopes of the links at every `slope_stride`-th window."""
        windows = np.arange(0, self.system.windows, self.system.slope_stride)
        return slopes_along(self.laws, self.system, self.fitted, windows)[0]

    @cached_property
    def _statistics(self) -> SlopeStatistics:
        """The slopes over the whole record."""
        slopes = slopes_along(self.laws, self.system, self.fitted, self.system.whole.windows)
        return SlopeStatistics(self.system.whole, self._masses, *slopes)

    @cached_property
    def _masses(self) -> Floats:
        """(m,) the masses in kg."""
        return self.patch.layout.inertia.at(self._all_values)

    @cached_property
    def _quadratic(self) -> Floats:
        """(t,) what noise in the terms adds to the variances."""
        subject = self.patch, self.system, self._masses, self._weights
        return quadratic_scatter(*subject, self.terms, self._slopes)

    def _part(self) -> Floats:
        """(t,) parts of the variances of first order, from the points at which the slopes are."""
        system, every, rows = self.system, self.patch.rows, self.terms.rows
        chosen = every if len(rows) == len(every) else every[rows]
        sums = system.window.some_adjoint(chosen, system.thinning, system.slope_stride)
        subject = self.patch, system, self._masses, self._weights
        return linear_scatter(*subject, self.terms, self._slopes, sums)

    def _whole(self, numbers: Indices) -> Floats:
        """The variances of first order of some of the terms."""
        chosen = self.terms.chosen(numbers)
        sums = self.system.whole.adjoint(self.patch.rows[chosen.rows])
        subject = self.patch, self.system, self._masses, self._weights
        return linear_scatter(*subject, chosen, self._statistics.mean, sums)

    @cached_property
    def _beside(self) -> Remainders:
        """What the coefficients of the laws leave of the terms."""
        p = len(self.values)
        known, columns, own = np.flatnonzero(self.parameter < p), self.columns, self._tested_columns
        numbers = np.append(self.values, 0.0)[self.parameter[known]] + self.patch.fixed[columns[known]]
        chosen = np.zeros((len(known), p + 1))
        chosen[np.arange(len(known)), self.parameter[known]] = 1.0
        chosen = chosen[:, :p]  # the last for known numbers
        shared = (self.signs[:, known].T * self._weights) @ self.signs
        squares = self._weights @ self.signs[:, own] ** 2
        sums = []
        for matrix in (self.patch.moments, self.patch.products):
            weighted = matrix[columns[known][:, None], columns] * shared
            diagonal = matrix[columns[own], columns[own]] * squares
            slope = -numbers @ weighted
            of_known = chosen.T @ weighted
            sums.append(
                (of_known[:, known] @ chosen, of_known[:, own], diagonal, slope[known] @ chosen, slope[own])
            )
        (_, _, power, *_), biased = sums[1], sums[1]
        scale, unit = (
            1.0 / np.sqrt(np.maximum(values, np.finfo(float).tiny))
            for values in (biased[0].diagonal(), power)
        )
        (normal, coupled, diagonal, slope, score), (added, also, whole, slope_biased, score_biased) = (
            (
                of_known * np.outer(scale, scale),
                beside * np.outer(scale, unit),
                own * unit**2,
                pull * scale,
                push * unit,
            )
            for of_known, beside, own, pull, push in sums
        )
        beside = regression(normal, coupled)
        left = diagonal_beside(diagonal, coupled, normal, beside)
        bias = diagonal_beside(whole - diagonal, also - coupled, added - normal, beside)
        score = score - slope @ beside
        windows = round(self.system.windows / self.system.window.overlap)
        tested = (left > _COLLINEAR) & (diagonal > 0.0)
        tested &= significance(np.where(tested, left, 1.0), bias, windows) > SIGNIFICANT
        return Remainders(score, score_biased - slope_biased @ beside - score, left, diagonal, unit, tested)

    def scores(self, numbers: Indices, excess: float, uncertain: float) -> Floats:
        """Scores of some of the terms in standard errors; 0 for terms that the laws have already.

        They scatter as the `excess` of the residuals says, and as the power of the noise is `uncertain`, a relative error.
        """
        patch = self._within(numbers)
        p, count = len(self.values), len(self.values) + len(numbers)
        theta = np.append(self.values, np.zeros(len(numbers)))
        weights = [self._weights]
        moments, right = (_dense(array) for array in normal_equations([patch], weights, count))
        blocks = score_blocks([(patch, self._statistics)], weights, self.system)
        scatter = _dense(assemble_blocks(((which, block[0]) for which, block in blocks), count))
        biased, right_biased = (
            _dense(array) for array in normal_equations([patch], weights, count, bias=1.0)
        )
        scale = 1.0 / np.sqrt(np.maximum(biased.diagonal(), np.finfo(float).tiny))
        moments, scatter, biased = (matrix * np.outer(scale, scale) for matrix in (moments, scatter, biased))
        slope, slope_biased = (
            scale * sums - matrix @ (theta / scale)
            for sums, matrix in ((right, moments), (right_biased, biased))
        )
        beside = regression(moments[:p, :p], moments[:p, p:])
        across = np.concatenate([-beside, np.eye(count - p)])
        left, bias, variance = (
            np.einsum("ij,ij->j", across, matrix @ across) for matrix in (moments, biased - moments, scatter)
        )
        tested = (left > _COLLINEAR) & (moments.diagonal()[p:] > 0.0) & (scatter.diagonal()[p:] > 0.0)
        white = np.where(tested, left * scatter.diagonal()[p:], 0.0) / np.where(
            tested, moments.diagonal()[p:], 1.0
        )
        tested &= variance > _CANCELLED * white
        added = uncertain * (across.T @ (slope_biased - slope))
        variance = max(excess, 1.0) * np.maximum(variance, white) + added**2
        windows = round(self.system.windows / self.system.window.overlap)
        tested &= significance(np.where(tested, left, 1.0), bias, windows) > SIGNIFICANT
        return np.where(tested, across.T @ slope, 0.0) / np.sqrt(np.where(tested, variance, 1.0))

    def _within(self, numbers: Indices) -> Patch:
        """The equations with only some of the terms that are tested, which follow the parameters found."""
        p, patch, layout = len(self.values), self.patch, self.patch.layout
        local = np.append(np.full(p + len(self.rows), -2), -1)  # the last for known numbers
        local[:p] = np.arange(p)
        local[p + numbers] = p + np.arange(len(numbers))
        parameter = local[self.parameter]
        chosen = np.flatnonzero(parameter > -2)
        columns = self.columns[chosen]
        both = np.ix_(columns, columns)
        once = chosen < len(layout.kernel)  # else a term on a single mass
        return replace(
            patch,
            layout=replace(
                layout,
                kernel=layout.kernel[columns],
                signs=self.signs[:, chosen],
                incidence=layout.incidence[columns],
                increment=layout.increment[columns] & once,
                coefficients=TermCoefficients(
                    parameter[chosen], np.where(once, layout.coefficients.known[columns], 0.0)
                ),
            ),
            fixed=np.where(once, patch.fixed[columns], 0.0),
            rows=patch.rows[columns],
            products=patch.products[both],
            moments=patch.moments[both],
            slopes=patch.slopes[columns],
        )


def first_inertia(layout: PatchLayout) -> int:
    """The row of the first term of inertia."""
    return len(layout.kernel) - len(layout.masses) - len(layout.forced)


def _single_terms(layout: PatchLayout, own: Bools) -> Iterator[tuple[int, int]]:
    """Rows and masses of forces on single masses: terms of their links, if `own` (q,), accelerations of them and of their
    neighbours, and applied forces.
    """
    incidence, first = np.abs(layout.link_incidence), first_inertia(layout)
    inertia = np.arange(first, first + len(layout.masses))
    for mass, (signs, near) in enumerate(zip(layout.signs, incidence @ incidence.T, strict=True)):
        for row in np.flatnonzero((signs != 0.0) & own).tolist():
            yield row, mass
        for row in inertia[(near > 0.0) & (signs[inertia] == 0.0)].tolist():
            yield row, mass


def _dense(matrix: Floats | csc_array) -> Floats:
    return matrix if isinstance(matrix, np.ndarray) else np.asarray(matrix.toarray())
