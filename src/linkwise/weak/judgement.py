"""Whether the answer of the weak form can be trusted: what noise explains, and what in the record follows the motion.

Sums of the weak equations over pieces of a record: normal equations, what noise adds to them, and its covariance.

All of them come from the terms, the windows and the weights that the whole record has.

Whether pieces of a record agree on the coefficients: a term that the laws lack acts otherwise where the motion is smaller.

Friction beside a damper looks like more damping the smaller the motion is, and quadratic damping like less. Where the motion
decays no score of such terms is needed, which would take a smoothed rate: the laws as they are stated are fitted to halves of
the record, of its first half and of its first quarter, since a motion that decays is soon hidden by noise, and to quarters.
The squares of what the pieces differ by, over their variances, follow chi-square where the laws are right (Cochran 1954).

Variances that are sums over some points of the record bound these squares from above, for a fraction of the cost; the whole
sums are formed only where the bound leaves room for a difference.

The terms and the windows of the whole record are those of its pieces (`piecewise`), but for the second half, where a motion
that decays is slower than in the first and needs wider windows.

References
----------
W. G. Cochran, Biometrics 10, 101 (1954), for the combination of estimates from different experiments.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy
from scipy.linalg.lapack import dpotrf, dpotri

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import LinkwiseError
from linkwise.estimates.causes import UnseenTerm
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.noise import has_outliers
from linkwise.verdict import Verdict
from linkwise.weak.displacements import MeasuredDisplacements, source_names
from linkwise.weak.efficient_scores import efficient_scores, undecided_damping, unseen_terms
from linkwise.weak.equations import MIN_WINDOWS, WeakEquations, weak_equations, weak_residual
from linkwise.weak.fit import SIGNIFICANT, SINGULAR, WeakFit, residual_power, significance
from linkwise.weak.layout import LawTerms
from linkwise.weak.patch import Patch
from linkwise.weak.scatter import SlopeStatistics, quadratic_noise, residual_excess, score_blocks
from linkwise.weak.tested_terms import SignificantScore, significant_score
from linkwise.weak.window import InnerStretches, Stretches


@dataclass(frozen=True, eq=False)
class PieceSums:
    """Sums over E pieces of a record, of p parameters.

    Attributes
    ----------
    normal : array of shape (E, p, p)
        The normal equations, without the bias due to noise.
    right : array of shape (E, p)
        Their right-hand sides.
    bias : array of shape (E, p, p)
        What noise adds to them.
    linear, quadratic : array of shape (E, p, p)
        Their covariances due to noise: the part of its first order, with the noise that terms contain, and the rest.
    windows : array of shape (E,)
        Numbers of windows without a missing sample, of the masses that have most.
    excess : array of shape (E,)
        Powers of the residuals over those expected from noise.
    """

    normal: Floats
    right: Floats
    bias: Floats
    linear: Floats
    quadratic: Floats
    windows: Floats
    excess: Floats


def piece_sums(
    equations: WeakEquations, values: Floats, ranges: Sequence[tuple[int, int]], *, least: bool = False
) -> PieceSums:
    """The sums over pieces of a record.

    Parameters
    ----------
    equations : WeakEquations
        The equations of the whole record.
    values : array of shape (p,)
        Their solution.
    ranges : sequence of tuple of int
        The first window of each piece, a multiple of `WeakEquations.slope_stride`, and the one behind its last.
    least : bool, optional
        Whether covariances and excess are what they are at least: of first order a sum of squares over some of the points
        (`InnerStretches`), and 1. The other sums are the same.

    Returns
    -------
    PieceSums
        The sums.
    """
    count, p = len(ranges), len(values)
    kind = InnerStretches if least else Stretches
    stretches = kind(equations.window, equations.thinning, tuple(ranges))
    patches = [patch for patch in equations.patches if len(patch.layout.free_terms)]
    weights = [1.0 / residual_power(patch, values) for patch in patches]
    noisy = [(patch, SlopeStatistics.along(patch, equations, values, stretches)) for patch in patches]
    normal, bias, linear, quadratic = np.zeros((4, count, p, p))
    right = np.zeros((count, p))
    for patch, weight in zip(patches, weights, strict=True):
        free, chosen = patch.layout.free_terms, _selection(patch.layout.free_parameters, p)
        signs = ((patch.signs.T * weight) @ patch.signs)[free]
        for number, (products, added) in enumerate(_products(equations, patch, ranges)):
            rows = (products - added)[free] * signs
            right[number] -= (rows @ patch.fixed) @ chosen
            normal[number] += chosen.T @ rows[:, free] @ chosen
            bias[number] += chosen.T @ (added[free] * signs)[:, free] @ chosen
    for which, blocks in score_blocks(noisy, weights, equations, quadratic=False):
        chosen = _selection(which, p)
        linear += chosen.T @ blocks @ chosen
    for (patch, statistics), weight in zip(noisy, weights, strict=True):
        which, blocks = quadratic_noise(patch, statistics, weight, equations)
        chosen = _selection(which, p)
        quadratic += chosen.T @ blocks @ chosen
    valid: Floats = np.max([patch.valid for patch in patches], axis=0)
    return PieceSums(
        normal,
        right,
        bias,
        linear,
        quadratic,
        np.array([valid[first:last].sum() for first, last in ranges]),
        np.ones(count) if least else residual_excess(noisy, values, equations),
    )


def _selection(which: Indices, count: int) -> Floats:
    """(s, count) 1 at the number of each of s terms."""
    chosen = np.zeros((len(which), count))
    chosen[np.arange(len(which)), which] = 1.0
    return chosen


def _products(
    equations: WeakEquations, patch: Patch, ranges: Sequence[tuple[int, int]]
) -> Iterator[tuple[Floats, Floats]]:
    """(q, q) products of the rows of a patch in each piece, and what noise adds to them."""
    window = equations.window
    evaluated, slope = equations.context.evaluated(patch.layout)
    for first, last in ranges:
        rows = patch.rows[:, first:last]
        samples = slice(first * window.stride, (last - 1) * window.stride + window.length)
        own, valid = [_within(terms, samples) for terms in evaluated], patch.valid[first:last]
        yield rows @ rows.T, equations.context.bias(patch.layout, own, slope, valid)


def _within(terms: LawTerms, samples: slice) -> LawTerms:
    """The terms at some samples."""
    parts = (part if isinstance(part, float) else part[:, samples] for part in terms.derivatives)
    by_rate = None if terms.rate_slope is None else terms.rate_slope[:, samples]
    return replace(terms, derivatives=tuple(parts), rate_slope=by_rate)


_CUTS = ((0.0, 0.125, 0.25), (0.0, 0.25, 0.5), (0.0, 0.5, 1.0), (0.0, 0.25, 0.5, 0.75, 1.0))
_HALF = 0.5
_TWICE = 2.0  # the significance that a whole record needs: below, errors of some pieces were a third of what they should be
_LEAST = 0.1  # of the part of a variance that is a sum of squares: a smaller one is the difference of large, inexact parts
_SURELY = 1e3  # of the smallest eigenvalue that is not singular: no eigenvalue is below the reciprocal of the inverse's trace
_LARGEST = 48  # masses of a structure whose pieces are compared
_PIECES_ALARM = 1e-4  # probability that pieces differ so much by chance, over all coefficients and cuts


@dataclass(frozen=True)
class Disagreement:
    """A coefficient of which pieces of the record give different values, between `lowest` and `highest`."""

    name: str
    lowest: float
    highest: float


def disagreement(
    record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit
) -> Disagreement | None:
    """The coefficient on which pieces of a record agree least.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure with its unknowns.
    equations : WeakEquations
        Its equations on the record.
    fit : WeakFit
        Their solution.

    Returns
    -------
    Disagreement or None
        The coefficient; None where chance explains all differences, or the structure has too many masses, or an unknown one,
        which is hardly distinguished from zero in some pieces.
    """
    if structure.size > _LARGEST or not all(mass.mass.known for mass in structure.masses):
        return None
    of_second = _second_half(record, structure, equations, fit)
    bounds = _differences_of_all(equations, of_second, fit, least=True)
    if (
        bounds is not None
        and min((chance for chance, _ in bounds), default=1.0) * max(len(bounds), 1) >= _PIECES_ALARM
    ):
        return None
    differences = _differences_of_all(equations, of_second, fit)
    if not differences:
        return None
    chance, worst = min(differences, key=lambda pair: pair[0])
    return worst if chance * len(differences) < _PIECES_ALARM else None


def _differences_of_all(
    equations: WeakEquations, of_second: WeakEquations | None, fit: WeakFit, *, least: bool = False
) -> list[tuple[float, Disagreement]] | None:
    """For each cut and parameter the probability of what its pieces differ by; no less than it with the `least` variances.

    None where a piece has none of these.
    """
    pieces = sorted({ends for cut in _CUTS for ends in pairwise(cut)})
    first = [ends for ends in pieces if ends[1] <= _HALF]
    second = [((low - _HALF) / _HALF, (high - _HALF) / _HALF) for low, high in pieces if low >= _HALF]
    fits = dict(zip(first, _fits(equations, fit, first, least=least), strict=True))
    later = [None] * len(second) if of_second is None else _fits(of_second, fit, second, least=least)
    fits |= dict(zip((ends for ends in pieces if ends[0] >= _HALF), later, strict=True))
    if least and not all(piece is None or piece.complete for piece in fits.values()):
        return None
    differences: list[tuple[float, Disagreement]] = []
    for cut in _CUTS:
        fitted = [fit_of_piece for ends in pairwise(cut) if (fit_of_piece := fits[ends]) is not None]
        if len(fitted) > 1:
            values, weights = (
                np.stack(part) for part in zip(*((p.values, p.weights) for p in fitted), strict=True)
            )
            differences += _differences(equations.parameters, values, weights)
    return differences


def _second_half(
    record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit
) -> WeakEquations | None:
    """The equations of the second half of a record; None where it is too short."""
    given = dict(zip(equations.parameters, map(float, fit.values), strict=True))
    half = record[round(_HALF * len(record)) :]
    try:
        motion = equations.motion.of_piece(half, structure)
        return weak_equations(half, structure, motion, values=given)
    except LinkwiseError:
        return None


@dataclass(frozen=True, eq=False)
class _PieceFit:
    """Values and weights (p,) of the parameters in a piece; weight 0 for what it hardly determines, or is at a bound.

    It is `complete` where all others have a variance.
    """

    values: Floats
    weights: Floats
    complete: bool


def _fits(
    equations: WeakEquations, fit: WeakFit, pieces: Sequence[tuple[float, float]], *, least: bool
) -> list[_PieceFit | None]:
    """The fit of each piece, perhaps with variances that are what they are at `least`.

    None for a piece that is too short, or has no motion left.
    """
    window, stride = equations.window, equations.slope_stride
    samples = equations.motion.displacements.shape[1]
    ranges = []
    for low, high in pieces:
        first = -(-round(low * samples) // window.stride)
        last = (round(high * samples) - window.length) // window.stride + 1
        ranges.append((-(-first // stride) * stride, min(last, equations.windows)))
    long = [number for number, (first, last) in enumerate(ranges) if last - first >= MIN_WINDOWS]
    fits: list[_PieceFit | None] = [None] * len(pieces)
    if not long or not fit.free.any():
        return fits
    sums = piece_sums(equations, fit.values, [ranges[number] for number in long], least=least)
    for place, number in enumerate(long):
        fits[number] = _fitted(sums, place, fit)
    return fits


def _fitted(sums: PieceSums, piece: int, fit: WeakFit) -> _PieceFit | None:
    """The fit of a piece, as of `_fits`.

    What it hardly determines it has from the whole: with another value, which may be anything, the others would scatter by
    more than their variance says.
    """
    normal, right, windows = sums.normal[piece], sums.right[piece], int(sums.windows[piece])
    if windows < MIN_WINDOWS or not np.isfinite(normal).all():
        return None
    free = fit.free & (normal.diagonal() > 0.0)
    solved = _Solved.of(normal, sums.bias[piece], windows, free)
    if solved is None:
        return None
    clear = solved.significance > _TWICE * SIGNIFICANT
    if not clear.all():
        free[free] = clear
        solved = _Solved.of(normal, sums.bias[piece], windows, free)
        if solved is None:
            return None
    values, weights = fit.values.copy(), np.zeros(len(free))
    values[free] = solved.inverse @ (right - normal[:, ~free] @ values[~free])[free]
    linear, whole = (
        (solved.inverse @ scatter[np.ix_(free, free)] @ solved.inverse).diagonal()
        for scatter in (sums.linear[piece], sums.linear[piece] + sums.quadratic[piece])
    )
    variance = np.maximum(whole, _LEAST * linear)
    determined = variance > 0.0
    variance = np.where(determined, variance * max(float(sums.excess[piece]), 1.0) ** 2, 1.0)
    weights[free] = np.where(determined, 1.0 / variance, 0.0)
    return _PieceFit(values, weights, bool(determined.all()))


@dataclass(frozen=True, eq=False)
class _Solved:
    """The `inverse` (f, f) of normal equations of f free parameters, and the `significance` (f,) of each beside the others."""

    inverse: Floats
    significance: Floats

    @classmethod
    def of(cls, normal: Floats, bias: Floats, windows: int, free: Bools) -> _Solved | None:
        """None where no parameter is free, or the equations are not positive definite."""
        if not free.any():
            return None
        chosen, scale = np.ix_(free, free), 1.0 / np.sqrt(normal.diagonal()[free])
        unit = np.outer(scale, scale)
        inverse = _inverse(normal[chosen] * unit)
        if inverse is None:
            return None
        directions = inverse / inverse.diagonal()
        added = np.einsum("ip,ip->p", directions, (bias[chosen] * unit) @ directions)
        return cls(inverse * unit, significance(1.0 / inverse.diagonal(), added, windows))


def _inverse(scaled: Floats) -> Floats | None:
    """The inverse of a matrix with a diagonal of 1; None where it is not positive definite."""
    factor, failed = dpotrf(scaled, lower=1)
    inverse = None if failed else dpotri(factor, lower=1)[0]
    if inverse is not None and np.trace(inverse) < 1.0 / (_SURELY * SINGULAR):
        return np.asarray(np.tril(inverse) + np.tril(inverse, -1).T)
    eigenvalues, vectors = np.linalg.eigh(scaled)
    return np.asarray((vectors / eigenvalues) @ vectors.T) if eigenvalues[0] >= SINGULAR else None


def _differences(
    names: tuple[str, ...], values: Floats, weights: Floats
) -> Iterator[tuple[float, Disagreement]]:
    """For each parameter that two of the pieces (b, p) determine, the probability of their differences."""
    count = np.count_nonzero(weights, axis=0)
    total = np.maximum(weights.sum(axis=0), np.finfo(float).tiny)
    squares = np.sum(weights * (values - np.sum(weights * values, axis=0) / total) ** 2, axis=0)
    chances = scipy.special.gammaincc(0.5 * np.maximum(count - 1, 1), 0.5 * squares)
    for number in np.flatnonzero(count > 1).tolist():
        own = values[weights[:, number] > 0.0, number]
        yield float(chances[number]), Disagreement(names[number], float(own.min()), float(own.max()))


LARGEST_EXCESS = 1.3  # residual power over what noise explains; right laws stay below it from 10 dB on
NOTED_EXCESS = 1.15  # right laws hardly ever leave more
_FALSE_ALARM = 1e-5  # probability that a record of few windows leaves the limits although its laws are right
_SKEWED = 0.1  # relative standard error of R or C: beyond, those that come out low look too sure, by four errors and more
_EXPLAINED = "The laws explain the record to within its noise"


@dataclass(frozen=True)
class WeakJudgement:
    """What can be said of an answer.

    Attributes
    ----------
    verdict : Verdict
        The most important finding.
    message : str
        The finding in words.
    unseen_terms : tuple of UnseenTerm
        What the record does not rule out beside the laws.
    """

    verdict: Verdict
    message: str
    unseen_terms: tuple[UnseenTerm, ...] = ()


def judgement(
    record: Record,
    structure: Structure,
    equations: WeakEquations,
    fit: WeakFit,
    contradicted: Sequence[str] = (),
) -> WeakJudgement:
    """What can be said of an answer.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure with its unknowns.
    equations : WeakEquations
        Its equations on the record.
    fit : WeakFit
        Their solution.
    contradicted : sequence of str, optional
        The parameters of which the record contradicts what is known beforehand.

    Returns
    -------
    WeakJudgement
        The finding, and terms that remain possible.
    """
    forbidden = _forbidden(record, structure, equations, fit)
    if forbidden is not None:
        return WeakJudgement(*forbidden)
    return _of_terms(record, structure, equations, fit, contradicted)


def _forbidden(
    record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit
) -> tuple[Verdict, str] | None:
    """What takes trust away before terms are tested at the likeliest motion."""
    if equations.motion.surplus > LARGEST_EXCESS:
        return Verdict.SYSTEMATIC_MISFIT, (
            "The sensors of a host do not move as its modes do: what they show beside these is "
            f"{np.sqrt(equations.motion.surplus):.3g} times their noise: a shape, a place or the "
            "sign of a sensor is wrong, modes that were left out move, or the noise is larger than stated."
        )
    lowest, highest = _limits(sum(len(patch.masses) * patch.windows for patch in equations.patches))
    times = f"{np.sqrt(fit.excess):.3g} times"
    if not fit.excess < highest:
        larger = ", or larger than stated" if record.noise else ""
        share = _model_error(equations, fit)
        return Verdict.NOISE_MISMATCH, (
            f"The laws explain the record to within {100.0 * share:.3g} % of its forces, which is {times} what noise "
            "would leave: a term is missing from a law, a link from the structure, a force from the "
            f"record, the noise is not white{larger}, or the samples are too far apart to follow the motion. The values are "
            "the best of these laws."
        )
    if fit.excess < lowest and not equations.motion.noise_free:
        source, advice = (
            ("stated", "Correct the stated noise, or leave it out")
            if record.noise
            else ("estimated", "State it, if it is known")
        )
        return Verdict.NOISE_MISMATCH, (
            f"The residuals are only {times} what noise would leave: the noise is smaller than "
            f"{source} or not white, and the correction for its bias has biased the values. {advice}."
        )
    if _has_outliers(record, structure, equations.motion):
        return Verdict.OUTLIERS, (
            "The noise has more large errors than normal noise, for which the weak form corrects the "
            'bias. Remove the outliers, or use method "ml", with a robust loss where they are many.'
        )
    hardly = [
        name
        for name, significance in zip(equations.parameters, fit.significance, strict=True)
        if significance < SIGNIFICANT
    ]
    if hardly:
        return Verdict.HARDLY_DETERMINED, (
            f"{_EXPLAINED}, but the record contains hardly more information on {', '.join(hardly)} than the noise that the "
            "weak form subtracts, so that an interval would be too narrow. Give a number, record a motion that "
            'stands farther above the noise, or use method "ml", which needs no such correction.'
        )
    skewed = _skewed(equations, fit)
    if skewed:
        return Verdict.HARDLY_DETERMINED, (
            f"{_EXPLAINED}, but tells {', '.join(skewed)} to within more than {100.0 * _SKEWED:.0f} % only, and the rate of "
            "a state is not linear in these, so that an interval would be too narrow on one side. Give a number, "
            'record a motion that stands farther above the noise, or use method "ml".'
        )
    follows = _follows_the_motion(record, structure, equations, fit)
    if follows:
        return Verdict.SYSTEMATIC_MISFIT, f"{_EXPLAINED}, but {follows}"
    return None


def _of_terms(
    record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit, contradicted: Sequence[str]
) -> WeakJudgement:
    """What terms that laws may lack make of an answer that nothing else takes trust from."""
    scores = efficient_scores(record, structure, equations, fit)
    lacking = None if scores is None else scores.significant()
    if lacking is not None:
        return WeakJudgement(Verdict.SYSTEMATIC_MISFIT, f"{_EXPLAINED}, but {_left(lacking)}")
    if contradicted:
        return WeakJudgement(Verdict.MEASUREMENT_ERROR, _contradiction(contradicted))
    if scores is None:
        return WeakJudgement(Verdict.CONVERGED, f"{_EXPLAINED}.")
    values = dict(zip(equations.parameters, map(float, fit.values), strict=True))
    subject = structure.with_values(values), equations, fit
    driven = equations.force is not None or equations.motion.base is not None
    damping = undecided_damping(scores, *subject) if driven else None  # a decay has many amplitudes
    if damping is not None:
        return WeakJudgement(
            Verdict.HARDLY_DETERMINED,
            f"{_EXPLAINED}, but the record does not rule out {damping.description}: where the motion "
            "is steady, friction and quadratic damping look like a linear damper. Record a free decay, or forces of several "
            "amplitudes, for longer or with less noise; or add the term to the law.",
        )
    return WeakJudgement(Verdict.CONVERGED, f"{_EXPLAINED}.", unseen_terms(scores, *subject))


def _contradiction(contradicted: Sequence[str]) -> str:
    return (
        f"The record contradicts what is stated of {', '.join(contradicted)} by more than four standard errors, so no "
        "interval is given: correct the value or its sigma, or look for an error of a sensor or a term that a law lacks, such "
        "as friction."
    )


def _skewed(equations: WeakEquations, fit: WeakFit) -> list[str]:
    """The coefficients that enter rates of states nonlinearly, as 1/R, and are too uncertain for a symmetric interval."""
    layout, deviations = equations.structure_layout, np.sqrt(fit.covariance.diagonal())
    remembers = {element.link for element in layout.elements[len(layout.structure.links) :]}
    of_memory = {number for (link, _), number in layout.parameter_index.items() if link in remembers}
    return [
        equations.parameters[number]
        for number in sorted(of_memory.intersection(layout.nonlinear))
        if deviations[number] > _SKEWED * abs(fit.values[number])
    ]


def _has_outliers(record: Record, structure: Structure, motion: MeasuredDisplacements) -> bool:
    numbers = np.flatnonzero(motion.has_channel[:-2])
    names = source_names(structure)
    samples = np.stack([record.channel(names[number]) for number in numbers.tolist()], axis=1)
    return has_outliers(samples, np.sqrt(motion.source_variance[numbers]))


def _follows_the_motion(record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit) -> str:
    """What in the record follows the motion and the laws do not explain, in words; empty where there is nothing."""
    lacking = significant_score(record, structure, equations, fit.values, fit.excess)
    if lacking is not None:
        return _left(lacking)
    wrong_noise = (
        bool(record.noise) and fit.excess > NOTED_EXCESS
    )  # of which the bias differs from piece to piece
    apart = None if wrong_noise else disagreement(record, structure, equations, fit)
    if apart is not None:
        return (
            f"pieces of it do not agree on {apart.name}: they give {apart.lowest:.3g} to "
            f"{apart.highest:.3g}, which chance does not explain, so no interval is given. A term is missing that depends on "
            'how large the motion is, such as friction, or the structure changed. Method "ml" names terms.'
        )
    return ""


def _left(lacking: SignificantScore) -> str:
    return (
        f"what they leave follows the motion: {lacking.description}, {abs(lacking.z):.3g} standard "
        "errors in size, would explain a part of it. Intervals would count that as noise, so none is given; a term or a "
        'link is missing, or a sensor or a stated mass is wrong. Method "ml" distinguishes these.'
    )


def _limits(windows: float) -> tuple[float, float]:
    """Limits of the residual excess of right laws; neighbouring windows share their noise, so two count as one."""
    freedom = 0.5 * max(windows, 2.0)
    low, high = (
        float(scipy.special.gammaincinv(0.5 * freedom, chance)) * 2.0 / freedom
        for chance in (_FALSE_ALARM, 1.0 - _FALSE_ALARM)
    )
    return min(low, 1.0 / LARGEST_EXCESS), max(high, LARGEST_EXCESS)


def _model_error(equations: WeakEquations, fit: WeakFit) -> float:
    """Root mean square of the residuals less their noise, over that of the force on the mass; of the worst mass."""
    residual = weak_residual(equations, fit.values)
    shares = [
        np.sqrt(np.nanmean(residual[:, mass] ** 2) / np.mean(equations.acceleration[mass] ** 2)) / kilograms
        for patch in equations.patches
        for mass, kilograms in zip(patch.masses, patch.layout.inertia.at(fit.values), strict=True)
        if kilograms
    ]
    return float(max(shares) * np.sqrt(1.0 - 1.0 / fit.excess))
