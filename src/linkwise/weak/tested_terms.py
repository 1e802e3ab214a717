"""Scores of terms of size zero in the weak equations of a patch of masses.

The variance of a score is a sum of squares over time. A part of that of its own normal equation bounds the score from above,
and costs a fraction of the whole; the whole of that equation costs more, and of few scores only; the variance beside the
coefficients of the laws most. Scores that cannot be beyond chance are not computed.

What regression on the columns of the laws leaves of the columns of other terms, and how large their scores can be by it.

Variances due to noise of the normal equations of single terms: the diagonal of what `scatter` has, for less.

To first order the noise of a channel enters the sum of a term by k(t)' u(t), k the sums of kernels over windows for the term,
and u what the channel is weighted by, which is the same for all terms that act in the same equations with the same signs.
Their variance is the sum over time of k' (sum of u u' over channels) k.

Score tests of weak equations: terms that the laws lack, and forces on one mass alone that no link explains.

A term of size zero is added to the equations. Its score is the sum over windows of the term times what the laws leave, without
the bias due to noise and beside the coefficients of the laws (Rao 1948); its variance is that of the normal equations due to
noise (`scatter`). Terms of a link act on both of its masses. One on a single mass stands for an error of a sensor, of a stated
mass or of an applied force, which action and reaction do not excuse.

The test functions of the fit are as short as the fastest motion. In the equation of a mass that moves more slowly most of what
they leave is noise of its inertia, which falls with the fifth power of their width, so every term is tested under wider ones
too. They see an error of a sensor or of a stated mass of a tenth the size.

Friction and quadratic damping act by the rate as the test functions of the fit smooth it: what that takes from the terms makes
their scores smaller, and what its noise adds is known (`rate_bias`).

The equations of each patch of masses are tested alone, so that the cost grows with the structure and not with its square.

References
----------
C. R. Rao, Math. Proc. Cambridge Philos. Soc. 44, 50 (1948), for the score test.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import combinations_with_replacement

import numpy as np
from scipy.linalg.lapack import dpocon, dpotrf, dpotrs
from scipy.sparse import csc_array

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.expression import to_text
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.weak.equations import WeakEquations, weak_equations
from linkwise.weak.fit import SIGNIFICANT, assemble_blocks, normal_equations, residual_power, significance
from linkwise.weak.layout import StructureLayout
from linkwise.weak.patch import Patch
from linkwise.weak.scatter import (
    SlopeStatistics,
    channel_weights,
    own_kernels,
    own_noise,
    score_blocks,
    slopes_along,
)
from linkwise.weak.weak_form import INNER, PHI_2, PatchLayout, TermCoefficients
from linkwise.weak.window import Window

_SINGULAR = 1e-12  # part of the largest singular value that those of collinear columns do not exceed
_WELL_POSED = 1e-8  # reciprocal condition far above that, so that no direction is left out


@dataclass(frozen=True, eq=False)
class Remainders:
    """What is left of terms beside the coefficients of the laws, each in units of the root of its moment.

    Attributes
    ----------
    score, bias : array of shape (t,)
        Scores, and what noise would add to them.
    left, diagonal : array of shape (t,)
        Moments beside the coefficients of the laws and without these.
    unit : array of shape (t,)
        The units.
    tested : array of bool, shape (t,)
        False for terms that the laws have, and for those that do not stand above the noise.
    """

    score: Floats
    bias: Floats
    left: Floats
    diagonal: Floats
    unit: Floats
    tested: Bools

    def squares(self, excess: float, uncertain: float, scatter: Floats) -> Floats:
        """What the squares of scores cannot exceed.

        Parameters
        ----------
        excess : float
            Power of the residuals over that expected from noise.
        uncertain : float
            Relative error of the power of the noise.
        scatter : array of shape (t,)
            What the variances of the normal equations of the terms due to noise are at least.

        Returns
        -------
        array of shape (t,)
            The squares; 0 for terms that are not tested.
        """
        scatter = self.unit**2 * np.maximum(scatter, 0.0)
        white = np.where(self.tested, self.left * scatter / np.where(self.tested, self.diagonal, 1.0), 1.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            variance = max(excess, 1.0) * white + (uncertain * self.bias) ** 2
            return np.where(self.tested, self.score**2 / variance, 0.0)


def diagonal_beside(diagonal: Floats, coupled: Floats, normal: Floats, beside: Floats) -> Floats:
    """The diagonal of the products of columns less multiples of others.

    Parameters
    ----------
    diagonal : array of shape (t,)
        That of the products of the columns.
    coupled : array of shape (p, t)
        Their products with the others.
    normal : array of shape (p, p)
        Products of these.
    beside : array of shape (p, t)
        The multiples.

    Returns
    -------
    array of shape (t,)
        The diagonal.
    """
    return np.asarray(diagonal + np.einsum("ij,ij->j", beside, normal @ beside - 2.0 * coupled))


def regression(normal: Floats, coupled: Floats) -> Floats:
    """What columns are of others in least squares, without directions in which these are collinear.

    Parameters
    ----------
    normal : array of shape (p, p)
        Products of these others, of order 1.
    coupled : array of shape (p, t)
        Products of them with the columns.

    Returns
    -------
    array of shape (p, t)
        The multiples.
    """
    factor, failed = dpotrf(normal)
    if len(normal) and not failed and dpocon(factor, np.abs(normal).sum(axis=0).max())[0] > _WELL_POSED:
        return np.asarray(dpotrs(factor, coupled)[0])
    return np.asarray(np.linalg.lstsq(normal, coupled, rcond=_SINGULAR)[0], dtype=float)


@dataclass(frozen=True, eq=False)
class SingleTerms:
    """Terms of which each has a normal equation of its own.

    Attributes
    ----------
    rows : array of int, shape (r,)
        Different rows of the patch.
    place : array of int, shape (s,)
        Which of these each term is.
    acting : array of shape (k, m)
        Signs in the equations, of k kinds of terms.
    kind : array of int, shape (s,)
        The kind of each.
    """

    rows: Indices
    place: Indices
    acting: Floats
    kind: Indices

    @classmethod
    def of(cls, rows: Indices, signs: Floats) -> SingleTerms:
        """Terms that are the `rows` (s,) of a patch with some `signs` (m, s) in its equations."""
        acting, kind = np.unique(signs.T, axis=0, return_inverse=True)
        return cls(*np.unique(rows, return_inverse=True), acting, kind)

    def chosen(self, numbers: Indices) -> SingleTerms:
        """Some of the terms."""
        kinds, kind = np.unique(self.kind[numbers], return_inverse=True)
        rows, place = np.unique(self.place[numbers], return_inverse=True)
        return SingleTerms(self.rows[rows], place, self.acting[kinds], kind)


def linear_scatter(
    patch: Patch,
    system: WeakEquations,
    masses: Floats,
    weight: Floats,
    terms: SingleTerms,
    slopes: Floats,
    sums: Floats,
) -> Floats:
    """Variances of first order: sums of squares over points of the record, of which some give less than all.

    Parameters
    ----------
    patch : Patch
        The equations.
    system : WeakEquations
        All equations of the record.
    masses, weight : array of shape (m,)
        The masses in kg, and the weights of their equations.
    terms : SingleTerms
        The terms.
    slopes : array of shape (2, l, P)
        Mean slopes of the links with respect to d (N/m) and v (N s/m) at the points.
    sums : array of shape (K, r, P)
        Sums of the kernels at the points for the different rows of the terms.

    Returns
    -------
    array of shape (s,)
        The variances.
    """
    weights, kind, _ = channel_weights(patch, system, masses, terms.acting * weight, slopes)
    of_kind = (kind == np.arange(len(terms.acting))[:, None]).astype(float)
    kernels = [kernel for kernel in range(len(sums)) if kernel != INNER + PHI_2]
    total = np.zeros((sums.shape[1], len(terms.acting)))
    for first, second in combinations_with_replacement(kernels, 2):
        form = of_kind @ (weights[first] * weights[second])
        total += (1.0 if first == second else 2.0) * ((sums[first] * sums[second]) @ form.T)
    return total[terms.place, terms.kind]


def quadratic_scatter(
    patch: Patch, system: WeakEquations, masses: Floats, weight: Floats, terms: SingleTerms, slopes: Floats
) -> Floats:
    """What noise in the terms themselves adds: the diagonal of `scatter.quadratic_noise` over the whole record.

    Parameters
    ----------
    patch, system, masses, weight, terms
        As of `linear_scatter`.
    slopes : array of shape (2, l, P)
        Mean slopes of the links at every `WeakEquations.slope_stride`-th window.

    Returns
    -------
    array of shape (s,)
        What it adds to the variances.
    """
    window, layout = system.window, patch.layout
    kernels = own_kernels(patch, system, slopes, masses)
    flat = kernels.reshape(len(kernels), -1)
    variance = system.motion.covariance(patch.masses, floored=True).diagonal()
    amount = system.slope_stride * (weight * variance) ** 2
    squares = np.empty((len(amount), len(terms.rows)))
    for kernel in np.unique(layout.kernel[terms.rows]).tolist():
        own = np.flatnonzero(layout.kernel[terms.rows] == kernel)
        correlation = np.einsum("ij,ij->j", window.cross_correlations[kernel, kernel].T @ flat, flat)
        squares[:, own] = correlation.reshape(kernels.shape[1:]) @ (patch.slopes[terms.rows[own]] ** 2).T
    acting = own_noise(
        patch, system, terms.acting.T[:, terms.kind], layout.incidence[terms.rows[terms.place]]
    )
    return np.asarray(amount @ (acting**2 * squares[:, terms.place]))


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


_TERMS = ("1", "d", "d**2", "d**3", "v", "v*d", "v*d**2")  # of which none needs a smoothed v
_FIFTH = "d**5"
_DAMPING = ("sign(v)", "v*abs(v)")  # under an input: where the motion decays, its pieces tell them from c*v
# per period of the fastest motion that the fifth power needs: fewer alias it into the test functions
_FIFTH_SAMPLES = 7.0
_LARGEST = 48  # masses of a structure whose equations are tested
_NOISE_POWER = 0.03  # relative error of the power of noise that is found; of stated noise, what its residuals say is added
_CHANCE = 8.0  # with twice the logarithm of the number of scores: normal scores give one in 300 fits
_WIDTHS = (1.0, 3.0)  # of the test functions of the fit: the wider ones hold a period of the fastest motion
_FEWEST = 50  # windows, of which scores are about normal


@dataclass(frozen=True)
class SignificantScore:
    """A term whose score is beyond chance.

    Attributes
    ----------
    place : str
        The link that lacks the term, or the mass on which it acts alone.
    term : str
        The term, as in a law; "acceleration" or "force" for that of a mass.
    of : str
        The link or the mass whose motion a force on a single mass follows; empty for a term of a link.
    z : float
        The score in standard errors.
    """

    place: str
    term: str
    of: str
    z: float

    @property
    def description(self) -> str:
        """In words."""
        if not self.of:
            return f"a force like {self.term} in {self.place}"
        return f"a force like {self.term} of {self.of} on {self.place} alone"


def significant_score(
    record: Record, structure: Structure, equations: WeakEquations, values: Floats, excess: float
) -> SignificantScore | None:
    """The most significant term that the laws lack.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure with its unknowns.
    equations : WeakEquations
        Its equations on the record.
    values : array of shape (p,)
        The parameters found.
    excess : float
        Power of the residuals over that expected from noise; scores scatter as much more.

    Returns
    -------
    SignificantScore or None
        The term; None where chance explains all scores, or the structure has too many masses.
    """
    if structure.size > _LARGEST:
        return None
    known = dict(zip(equations.parameters, map(float, values), strict=True))
    fine = record.rate > _FIFTH_SAMPLES * equations.motion.bandwidth
    driven = equations.force is not None or equations.motion.base is not None
    terms = (*_TERMS, *((_FIFTH,) if fine else ()), *(_DAMPING if driven else ()))
    wide, prefix = with_terms(structure, terms)
    uncertain = _NOISE_POWER + (abs(excess - 1.0) if record.noise else 0.0)
    try:
        for width in _WIDTHS:  # wider ones only where those of the fit see nothing
            window = equations.window if width == 1.0 else equations.window.widened(width)
            if width > 1.0 and window.rows(len(record)) < _FEWEST:
                break
            system = _with_tested_terms(record, wide, prefix, equations, known, window)
            tests = [
                ScoreTests.of(patch, system, known, equations.structure_layout) for patch in system.patches
            ]
            score = _largest_score(tests, excess, uncertain)
            if score is not None:
                return score
    except (IdentificationError, np.linalg.LinAlgError):  # a term may not be finite along the motion
        pass
    return None


def _largest_score(tests: Sequence[ScoreTests], excess: float, uncertain: float) -> SignificantScore | None:
    """The largest score in all patches if it is beyond chance."""
    count = len(_WIDTHS) * max(sum(len(test.rows) for test in tests), 1)
    least = _CHANCE + 2.0 * float(np.log(count))
    scored = [(test.largest(excess, uncertain, least), test) for test in tests]
    beyond = [_named(test, *score) for score, test in scored if score is not None]
    return max(beyond, key=lambda score: abs(score.z), default=None)


def _with_tested_terms(
    record: Record,
    structure: Structure,
    prefix: str,
    equations: WeakEquations,
    known: dict[str, float],
    window: Window,
) -> WeakEquations:
    """The equations of a structure with terms whose coefficients begin with `prefix`, under some test functions.

    Slopes of laws, which say what noise does, and rates that laws act by are those of the motion under those of the fit.
    """
    system = weak_equations(
        record,
        structure,
        equations.motion,
        window=window,
        rate_window=equations.window,
        values=known,
        alone=lambda part: part.coefficient is not None and part.coefficient.startswith(prefix),
    )
    centres = window.half + window.stride * np.arange(system.windows)
    nearest = np.rint((centres - equations.window.half) / equations.window.stride).astype(int)
    nearest = np.minimum(nearest, equations.windows - 1)
    return replace(system, d=equations.d[:, nearest], v=equations.v[:, nearest])


@lru_cache(maxsize=32)
def with_terms(structure: Structure, terms: tuple[str, ...]) -> tuple[Structure, str]:
    """The structure with an unknown coefficient for each of some terms that a law does not have one for.

    Parameters
    ----------
    structure : Structure
        The structure.
    terms : tuple of str
        The terms, as in a law.

    Returns
    -------
    wide : Structure
        The structure with the terms.
    prefix : str
        What the names of their coefficients begin with, and no other coefficient.
    """
    prefix = "added"
    while any(name.startswith(prefix) for link in structure.links for name in link.coefficients):
        prefix += "_"
    links = tuple(_with_link_terms(link, terms, prefix) for link in structure.links)
    return replace(structure, links=links), prefix


def _with_link_terms(link: Link, terms: Sequence[str], prefix: str) -> Link:
    unknown = {
        to_text(link.law.basis[name]).replace(" ", "")
        for name in link.law.linear
        if link.coefficients[name].value is None
    }
    added = {f"{prefix}{number}": term for number, term in enumerate(terms) if term not in unknown}
    text = " + ".join([link.law.text, *(f"{name}*({term})" for name, term in added.items())])
    coefficients = {**link.coefficients, **{name: Coefficient.unknown() for name in added}}
    return replace(link, law=Law.parse(text, link.states), coefficients=coefficients)


def _named(tests: ScoreTests, number: int, z: float) -> SignificantScore:
    """The term of a test."""
    layout, row, mass = tests.patch.layout, int(tests.rows[number]), int(tests.masses[number])
    of_system = tests.system.structure_layout
    structure = of_system.structure
    names = [of_system.equation_names[index] for index in layout.masses.tolist()]
    place = "" if mass < 0 else names[mass]
    for terms in layout.group_terms:
        if terms.terms.start <= row < terms.terms.stop:
            element = of_system.elements[int(layout.groups[terms.group].links[row - terms.terms.start])]
            link, law, name = structure.links[element.link], element.law, terms.part.coefficient or ""
            term = to_text(law.basis[name]) if name in law.basis else law.text
            return SignificantScore(place or link.name, term, link.name if place else "", z)
    of_inertia = row - first_inertia(layout)
    if of_inertia < len(names):
        return SignificantScore(place, "acceleration", names[of_inertia], z)
    return SignificantScore(place, "force", structure.mass_names[layout.forced[of_inertia - len(names)]], z)
