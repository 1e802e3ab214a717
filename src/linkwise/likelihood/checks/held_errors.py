"""Errors of sensors and inputs that intervals hold: small ones, beside a model error that intervals include.

A record whose laws are a little wrong shows a little of everything: a drift, a part of a sample of delay. The score test of
such an error says to first order what it would make of each coefficient. Where that is no more than an interval can hold, it
joins the covariance as a missing term does; an answer with an error that moves a coefficient by more is not trusted. Where a
missing term explains more, which an error may look like, errors are judged beside the terms that the intervals count.

What the verdict on a fit says of the causes that would explain what it leaves.

The effect of missing terms, and of small errors of sensors, on the coefficients, where a model error stands for them.

The coefficients of a law that lacks a term make up for it, as far as they can, and do so alike in all parts of a record: no
scatter of blocks shows. Here terms are added to the linearised equations one at a time, always the one that explains most of
what those before it leave, while what it gains is significant; after those the few that laws lack most often, while they are
farther from zero than their standard error: laws that are known to be wrong may well lack them, and coefficients that
resemble them make up for many times their score. With values c_D of the terms D so found the coefficients move by G c_D, and
G c_D c_D' G' is added to their covariance: the second moment of the c_D about the zero that the laws as stated give them, as
for terms that a discovery dropped (Berk et al., Ann. Statist. 41, 2013). Errors of sensors and inputs that the diagnosis
names are added with the terms, where they would move coefficients by no more than the intervals can hold.

Terms that exact laws may lack without a sign in the records, though they would move coefficients out of their intervals.

Stated masses may be off likewise.

The score test of a term bounds its size. A term that resembles those of the law moves their coefficients by many standard
errors before its own score is significant, so that intervals hold for the law as stated only. No interval of reasonable width
could hold what no test of the records sees; it is reported instead.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.estimates.causes import Cause, UnseenTerm
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.tests.columns import largest_damping
from linkwise.likelihood.tests.diagnosis import (
    LARGEST,
    TestedCauses,
    beyond_white,
    least_gain,
    link_forces,
    which_stated,
)
from linkwise.likelihood.tests.score_test import (
    BETWEEN_MODES,
    MEMORY_TERMS,
    PRICE_OF_REACH,
    Hypothesis,
    augmented_quadratic,
    candidate_forces,
    missing_forces,
    single_tests,
    which_between_modes,
    which_usual,
)
from linkwise.likelihood.tests.variances import BEHIND_FILTER, SPECTRAL_KINDS, UNSTEADY
from linkwise.model.names import MASS
from linkwise.model.structure import Structure
from linkwise.runtime import one_blas_thread

_SINGULAR = 1e-12
_MOST = 6  # significant terms; of more, each makes a small part of what the first ones do
_MOST_USUAL = 24  # usual terms after them; those of more links are as many decisions
_LIKELY = 1.0
"""Standard errors from zero beyond which usual terms are counted: as for a term of a regression (Theil 1961), those that are
nearer to zero than their own error say no more of the coefficients than their absence does."""

_HINT = 2.5
"""A normal score, on either side, beyond which intervals of exact laws hold a usual term: one in 80 by chance, so that nearly
all stay as they are. To hold what terms with a smaller score may do, all would have to be several times as wide."""

_POWERS = ("d**3", "d**5")
_HINT_OF_POWER = 2.0
"""The same of a power of the elongation: one in 22 by chance. What the coefficients make up for it depends on the amplitude:
those of 10 s of random motion differ from those of an endless record by about as many standard errors as the score says, and
beside missing damping by a third of that. Of several powers each has a higher limit, as chance gives more of them."""


@dataclass(frozen=True, eq=False)
class MissingTerms:
    """The `covariance` (p, p), in SI units, that missing terms, missing links and errors add to that of the coefficients.

    `counted` are those added, the likeliest first, and `moves` (p, c) what each makes of the coefficients beside the others;
    `unexplained` are links with terms, and pairs of masses with forms, that are still significant beside them.
    """

    counted: tuple[Hypothesis, ...]
    moves: Floats
    unexplained: frozenset[tuple[str, str]]

    @property
    def covariance(self) -> Floats:
        moved = self.moves.sum(axis=1)
        return np.outer(moved, moved)


@np.errstate(over="ignore", invalid="ignore")  # a candidate may be infinite somewhere; it is then not taken
def for_missing_terms(
    fit: LikelihoodFit,
    identified: Structure,
    tested: TestedCauses | None = None,
    errors: Collection[Cause] = (),
) -> MissingTerms | None:
    """What missing terms of links, missing links and named errors add to the covariance of the coefficients.

    Parameters
    ----------
    fit : LikelihoodFit
        A fit with a model error.
    identified : Structure
        The structure with the values of the fit.
    tested : TestedCauses or None
        What was tested at this fit, all terms among it; only terms and links are tested here without it.
    errors : collection of Cause
        The errors of sensors, masses and inputs among these that are added with the terms.

    Returns
    -------
    MissingTerms or None
        None where no term explains what the laws leave.
    """
    if tested is not None:
        named = {(error.kind, error.where, error.source) for error in errors}
        numbers = [
            number
            for number, hypothesis in enumerate(tested.hypotheses)
            if hypothesis.kind in ("term", "link")
            or (hypothesis.kind, hypothesis.where, hypothesis.source) in named
        ]
        among = _among(tested, numbers, len(fit.values))
        return _counted(fit, *among, _rounds(among[0], identified))
    optimum = fit.optimum
    hypotheses, forces = missing_forces(identified, optimum.segments.system.parameters.names)
    try:
        with one_blas_thread():
            misfit = evaluate(optimum.segments, optimum.point, optimum.scales, optimum.loss)
            candidates, _ = candidate_forces(optimum, misfit, forces)
            quadratic = augmented_quadratic(optimum, misfit, candidates)
    except np.linalg.LinAlgError:
        return None
    return _counted(fit, hypotheses, quadratic.curvature, quadratic.slope, _rounds(hypotheses, identified))


def usual_scores(fit: LikelihoodFit, identified: Structure, tested: TestedCauses) -> Floats:
    """(u,) normal scores of the usual terms among what was `tested`, without sign; 0 of those that cannot be told.

    They are tested one at a time, all coefficients fitted anew to first order.
    """
    return np.sqrt(_gains_of(tested, which_usual(tested.hypotheses, identified))) / fit.optimum.noise


def for_usual_terms(
    fit: LikelihoodFit, identified: Structure, tested: TestedCauses, *, doubted: bool
) -> MissingTerms | None:
    """What usual terms, none of them significant, add to the covariance of a fit that leaves only noise; None if none does.

    Damping between modes of hosts counts as one. Those at which the residuals hint; where it is `doubted` that the laws are
    exact, those of one link that are farther from zero than their standard error, of more links fewer, as chance gives more of
    them (Foster and George, Ann. Statist. 22, 1994).
    """
    usual = which_usual(tested.hypotheses, identified)
    between = which_between_modes(tested.hypotheses)
    if not (usual or between):
        return None
    links = max(len({tested.hypotheses[number].where for number in usual}), 1)
    hypotheses = [tested.hypotheses[number] for number in usual + between]
    least = _hints(hypotheses)
    if doubted:
        least = np.minimum(_LIKELY**2 + 2.0 * np.log(links), least)
    limits = least + _prices(hypotheses)
    if not np.any(_gains_of(tested, usual + between) > limits * fit.optimum.noise**2):
        return None
    among = _among(tested, usual + between, len(fit.values))
    return _counted(fit, *among, [(limits, _MOST_USUAL if doubted else _MOST)])


@np.errstate(over="ignore", invalid="ignore")  # a candidate may be infinite somewhere; it is then not taken
def _counted(
    fit: LikelihoodFit,
    hypotheses: Sequence[Hypothesis],
    curvature: Floats,
    slope: Floats,
    rounds: Sequence[tuple[Floats, int]],
) -> MissingTerms | None:
    """The terms that are added one at a time, each the likeliest beside those before it.

    In each round those that gain more than its limits (h,), up to a number.
    """
    optimum, p = fit.optimum, len(fit.values)
    scale = 1.0 / np.sqrt(np.maximum(curvature.diagonal(), np.finfo(float).tiny))
    curvature, slope = curvature * np.outer(scale, scale), slope * scale
    order, added = np.arange(len(slope)), 0
    for least, at_most in rounds:
        most = min(added + at_most, len(hypotheses))
        while added < most:
            beyond = _beyond(curvature, slope, order, p + added) / optimum.noise**2
            excess = np.where(beyond > least[order[p + added :] - p], beyond, 0.0)
            if not excess.any():
                break
            position, best = p + added, int(np.argmax(excess))
            order[[position, position + best]] = order[[position + best, position]]
            added += 1
    if not added:
        return None
    own, terms = order[:p], order[p : p + added]
    both = order[: p + added]
    values = np.linalg.lstsq(curvature[np.ix_(both, both)], slope[both], rcond=_SINGULAR)[0][p:]
    follow = curvature[np.ix_(own, own)], curvature[np.ix_(own, terms)]
    moves = np.linalg.lstsq(*follow, rcond=_SINGULAR)[0] * values
    moves = np.where(fit.free[:, None], moves * (scale[:p] * optimum.scales.theta[:p])[:, None], 0.0)
    significant = _beyond(curvature, slope, order, p + added) / optimum.noise**2 > rounds[0][0][0]
    beside = (hypotheses[number - p] for number in order[p + added :][significant].tolist())
    return MissingTerms(
        moves=moves,
        counted=tuple(hypotheses[number - p] for number in terms.tolist()),
        unexplained=frozenset((hypothesis.where, hypothesis.term) for hypothesis in beside),
    )


def _rounds(hypotheses: Sequence[Hypothesis], identified: Structure) -> list[tuple[Floats, int]]:
    """First significant terms, then likely usual ones."""
    significant = np.full(len(hypotheses), least_gain(len(hypotheses)))
    likely = significant.copy()
    usual = which_usual(hypotheses, identified)
    likely[usual] = _LIKELY**2 + _prices(hypotheses)[usual]
    return [(significant, _MOST), (likely, _MOST_USUAL)]


def _hints(hypotheses: Sequence[Hypothesis]) -> Floats:
    """(h,) what each gains at least where the residuals of exact laws hint at it."""
    powers = np.array([hypothesis.term in _POWERS for hypothesis in hypotheses])
    of_power = _HINT_OF_POWER**2 + 2.0 * np.log(max(int(np.count_nonzero(powers)), 1))
    return np.asarray(np.where(powers, min(of_power, _HINT**2), _HINT**2))


def _prices(hypotheses: Sequence[Hypothesis]) -> Floats:
    """(h,) what each gains by chance beside its size: a force with memory has a reach as well.

    Beside a stiff link it hardly differs from a damper, whose interval it would make many times as wide. Damping between
    modes is one of many pairs.
    """
    pairs = sum(hypothesis.kind == BETWEEN_MODES for hypothesis in hypotheses)
    of_pair = 2.0 * float(np.log(max(pairs, 1)))
    return np.array(
        [
            of_pair
            if hypothesis.kind == BETWEEN_MODES
            else PRICE_OF_REACH * (hypothesis.term in MEMORY_TERMS)
            for hypothesis in hypotheses
        ]
    )


def _gains_of(tested: TestedCauses, numbers: Sequence[int]) -> Floats:
    """What each of some hypotheses alone would take off the cost; 0 of those that cannot be told."""
    gains = tested.tests.gains[np.array(numbers, dtype=int)]
    return np.where(np.isfinite(gains), gains, 0.0)


def _beyond(curvature: Floats, slope: Floats, order: NDArray[np.intp], counted: int) -> Floats:
    """What each of the columns after those `counted` would take off the cost beside them."""
    among = np.ix_(order, order)
    gains = single_tests(curvature[among], slope[order], curvature[among], counted).gains
    return np.where(np.isfinite(gains), gains, 0.0)


def _among(
    tested: TestedCauses, numbers: Sequence[int], parameters: int
) -> tuple[list[Hypothesis], Floats, Floats]:
    """The hypotheses of these `numbers`; curvature and slope in the `parameters` and their sizes, scaled."""
    order = [*range(parameters), *(parameters + number for number in numbers)]
    hypotheses = [tested.hypotheses[number] for number in numbers]
    return hypotheses, tested.curvature[np.ix_(order, order)], tested.slope[order]


LARGEST_SHIFT = 3.0
"""Standard errors: the largest change of a coefficient that is trusted, by an error of a sensor or an input beside a model
error, by a missing link, or by a term beside noise. An interval that holds it is up to three times as wide."""
LARGEST_TERM = 0.05
"""Relative to the force in a link: the largest missing term that is trusted. With a larger one in the law, the coefficients
would change by more than an engineer can neglect."""
LIKELIER = 16.0
"""Of -2 log likelihood: what a likelier cause gains more than another where chance gives that to one in 3000 (Vuong 1989)."""
_ANOTHER_LAW = 0.5
"""The same where other causes explain more: a term that makes most of the force in its link, which then has another law."""
_KINDS = (
    "gain",
    "offset",
    "drift",
    "delay",
    "crosstalk",
    "mass",
    "force gain",
    "force delay",
)
"""Whose effect the first order describes. A filter of all sensors changes the motion that nonlinear links act by as well,
noise of inputs has no size that moves coefficients to a side, and what contradicts a stated value is no small error."""
_BESIDE_TERMS = (*_KINDS, BETWEEN_MODES)
"""The same where a term explains more, which looks like damping of a host too. Where that explains most, it is stated."""


def intervals_by_blocks(fit: LikelihoodFit) -> bool:
    """Whether intervals include errors that follow the motion: only where blocks of the records determine them."""
    return fit.model_error > 0.0 and fit.error_ratios is not None


def held_errors(fit: LikelihoodFit, causes: Sequence[Cause]) -> tuple[Cause, ...]:
    """The errors of sensors and inputs among the `causes` that intervals may hold, since they allow for a model error already.

    Where one of them explains most, all of them, if each would move no coefficient by more than `LARGEST_SHIFT` of its
    standard errors, nor overturn what is said of one; none where an error is of another kind. Where a term explains most, all
    whose effect is known; `counted_causes` says of these whether intervals do.
    """
    errors = tuple(cause for cause in causes if cause.is_instrument)
    if not errors or not intervals_by_blocks(fit):
        return ()
    if errors[0] is not causes[0]:
        return tuple(error for error in errors if error.kind in _BESIDE_TERMS)
    small = all(
        error.kind in _KINDS and 0.0 < error.shift <= LARGEST_SHIFT and not error.overturned
        for error in errors
    )
    return errors if small else ()


@dataclass(frozen=True, eq=False)
class CountedCauses:
    """The `missing` terms and errors that intervals count, and an error that moves a coefficient `too_far` for them.

    The `shift` of the latter is that beside the terms, in standard errors that count them.
    """

    missing: MissingTerms | None = None
    too_far: Cause | None = None


def counted_causes(
    fit: LikelihoodFit, identified: Structure, causes: Sequence[Cause], tested: TestedCauses | None
) -> CountedCauses:
    """What intervals count of the causes of a model error.

    Where a term explains most, only the likeliest error is counted: with those that look like it, as the error of a mass like
    a gain, the records do not determine its size.
    """
    errors = {(cause.kind, cause.where, cause.source): cause for cause in held_errors(fit, causes)}
    missing = for_missing_terms(fit, identified, tested, tuple(errors.values()))
    likeliest = next((cause for cause in missing.counted if not cause.term), None) if missing else None
    if likeliest is None:
        return CountedCauses(missing)
    error = errors[likeliest.kind, likeliest.where, likeliest.source]
    alone = for_missing_terms(fit, identified, tested, (error,))
    numbers = [number for number, cause in enumerate(alone.counted) if not cause.term] if alone else []
    if alone is None or not numbers:
        return CountedCauses(missing)
    by_terms = np.delete(alone.moves, numbers, axis=1).sum(axis=1)
    deviation = np.sqrt(np.maximum(fit.covariance.diagonal() + by_terms**2, np.finfo(float).tiny))
    shifts = np.where(fit.free, np.abs(alone.moves[:, numbers[0]]) / deviation, 0.0)
    farthest, names = int(np.argmax(shifts)), fit.segments.system.parameters.names
    beside_terms = replace(error, shift=float(shifts[farthest]), shifted=names[farthest])
    return CountedCauses(
        missing if causes[0].is_instrument else alone,
        beside_terms if beside_terms.shift > LARGEST_SHIFT else None,
    )


def of_held_errors(causes: Sequence[Cause], errors: Sequence[Cause]) -> str:
    """That one of the held `errors` explains most, where it does, and how little they would move the coefficients."""
    if not errors or errors[0] is not causes[0]:
        return ""
    farthest = max(errors, key=lambda error: error.shift)
    return (
        f" {errors[0].description[0].upper()}{errors[0].description[1:]} would explain most of what is left. It would "
        f"change {farthest.shifted} by {farthest.shift:.2g} of its standard errors, and no coefficient by more."
    )


def decisive(causes: Sequence[Cause], *, by_blocks: bool) -> Cause | None:
    """The cause that forbids trust, if there is one; with intervals `by_blocks`, small terms of the links do not.

    They do where they would overturn what the answer says of a coefficient, whose interval does not hold that.
    """
    if not causes or not by_blocks or causes[0].kind == "link" or causes[0].share > LARGEST_TERM:
        return causes[0] if causes else None
    too_large = (
        cause
        for cause in causes
        if cause.share > _ANOTHER_LAW
        or cause.overturned
        or (cause.kind == "link" and cause.shift > LARGEST_SHIFT)
    )
    return next(too_large, None)


def not_held(fit: LikelihoodFit, causes: Sequence[Cause], missing: MissingTerms | None) -> tuple[Cause, ...]:
    """The causes that intervals do not hold, without the coefficients that they would overturn where intervals hold that.

    Counting `missing` terms, intervals hold a coefficient where they hold its zero, and where a cause explains nothing beside
    those terms: a weak one would overturn what the likelier ones, which it looks like, do not. A missing link that explains
    nothing beside them and is less likely than the first of them is none: were it there, it would explain the most.
    """
    if missing is None:
        return tuple(causes)
    errors = np.sqrt(np.maximum((fit.covariance + missing.covariance).diagonal(), 0.0))
    names = fit.segments.system.parameters.names
    uncertain = {
        name for name, clear in zip(names, np.abs(fit.values) > NORMAL_95 * errors, strict=True) if not clear
    }
    return tuple(
        replace(
            cause,
            overturned=tuple(
                name for name in cause.overturned if name not in uncertain and _is_left(cause, missing)
            ),
        )
        for cause in causes
        if _is_left(cause, missing) or cause.kind != "link" or cause.gain > causes[0].gain - LIKELIER
    )


def _is_left(cause: Cause, missing: MissingTerms) -> bool:
    """Whether a cause is significant beside the terms that are counted."""
    return (cause.where, cause.term) in missing.unexplained


def would_explain(cause: Cause) -> str:
    return f"{cause.description} would lower -2 log likelihood by {cause.gain:.3g}"


def likeliest(causes: Sequence[Cause], part: str = "of what is left") -> str:
    return f" Most {part} would be explained by {causes[0].description}." if causes else ""


def moved(causes: Sequence[Cause]) -> str:
    """Which coefficient the likeliest cause would change most, where it would change by more than its interval says."""
    if not causes or causes[0].shift <= LARGEST_SHIFT:
        return ""
    return f" With it, {causes[0].shifted} would change by {causes[0].shift:.2g} of the standard errors of the laws as stated."


def of_instrument(cause: Cause) -> str:
    """What an error in what was recorded or stated means for the answer."""
    if cause.kind in ("input noise", "ambient"):
        kind = "an ambient force on" if cause.kind == "ambient" else "noise of"
        more = "more of it, or let it be found" if cause.remark else f"{kind} {cause.where}"
        return (
            f", but {would_explain(cause)}. It excites the structure, and coefficients, above all dampings, would be "
            f"wrong by more than intervals of exact laws say: allow for {more}."
        )
    if cause.kind == UNSTEADY:
        return (
            f", but {would_explain(cause)}. The strongest parts tell most, so intervals would be at least "
            f"{np.hypot(1.0, cause.size):.2g} times too narrow: use parts of the record in which the level "
            "is about the same."
        )
    if cause.remark.endswith(BEHIND_FILTER):
        return (
            f", but {would_explain(cause)}. All frequencies tell the level of the forces, and dampings would be wrong by more "
            "than intervals of exact laws say: resample the accelerations at twice the frequency up to which the "
            "filter is flat, by their Fourier transform."
        )
    if cause.kind in SPECTRAL_KINDS:
        return (
            f", but {would_explain(cause)}. The laws take up what such forces differ by from white and independent ones, and "
            "would be wrong by more than intervals of exact laws say: record the forces, or the structure where "
            "nothing but applied forces or its own decay moves it."
        )
    return (
        f", but {would_explain(cause)}, more than any missing term. Coefficients would be wrong by more than intervals of "
        "exact laws say: correct it, or estimate it with the other unknowns."
    )


def of_error_beside_terms(error: Cause) -> str:
    """What an error means that moves a coefficient farther than intervals hold, beside the terms that they count."""
    return (
        f", but {would_explain(error)}, and beside the terms that would explain more it would change {error.shifted} by "
        f"{error.shift:.2g} of its standard errors. Intervals of exact laws do not include that: correct it, or estimate "
        "it with the other unknowns."
    )


def of_systematic_misfit(cause: Cause) -> str:
    """What a misfit that follows the motion means for the answer."""
    overturned = ""
    if cause.overturned:
        overturned = f", and {', '.join(cause.overturned)} would have no certain sign, or another one"
    return (
        f", but what is left follows the motion: {would_explain(cause)}{overturned}. Intervals of exact laws would count that "
        "as noise; a term or a link is missing, or a sensor has an error."
    )


_NEGLIGIBLE = 0.01
"""Of a coefficient: what the calibration of sensors leaves open anyway, and intervals do not hold unless it is stated. The
gain of an accelerometer is known to 1 % as a rule."""


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # a candidate that is infinite is not taken
def unseen_terms(
    fit: LikelihoodFit, identified: Structure, tested: TestedCauses | None, covariance: Floats, *, terms: bool
) -> tuple[UnseenTerm, ...]:
    """The usual terms, damping between modes and stated masses that the records do not bound well, the farthest move first.

    Parameters
    ----------
    fit : LikelihoodFit
        A fit that is trusted.
    identified : Structure
        The structure with the values of the fit.
    tested : TestedCauses or None
        What was tested at the fit, usual terms among it; None where nothing was.
    covariance : array of shape (p, p)
        That of the coefficients as it is reported.
    terms : bool
        Whether terms are looked for as well as masses: where the fit leaves only noise, without a significant cause.

    Returns
    -------
    tuple of UnseenTerm
        Those which, as large as the records let them be, would change a coefficient by more than an interval can hold, and
        by more than is negligible; of each term the coefficient that it would change most.
    """
    if tested is None:
        return ()
    optimum, p, tests = fit.optimum, len(fit.values), tested.tests
    deviations = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    beyond_noise = NORMAL_95 * optimum.noise * beyond_white(fit)
    numbers = which_stated(tested.hypotheses, fit.segments.system.parameters.names)
    if terms:
        usual = which_usual(tested.hypotheses, identified)
        numbers = usual + which_between_modes(tested.hypotheses) + numbers
    wholes = _wholes(fit, identified, tested, numbers)
    unseen = []
    for number, (whole, largest) in zip(numbers, wholes, strict=True):
        hypothesis, size = tested.hypotheses[number], float(tests.sizes[number])
        limit = min(abs(size) + beyond_noise * float(tests.deviations[number]), largest * whole)
        change = tests.changes[:, number] * optimum.scales.theta[:p] * np.divide(limit, abs(size))
        shifts, relative = np.abs(change) / deviations, np.abs(change / fit.values)
        beyond = fit.free & np.isfinite(shifts) & (shifts > LARGEST_SHIFT) & (relative > _NEGLIGIBLE)
        if not (beyond.any() and tests.gains[number] > 0.0 and whole > 0.0):
            continue
        farthest = int(np.argmax(np.where(beyond, shifts, 0.0)))
        unseen.append(
            UnseenTerm(
                link=hypothesis.where,
                term=MASS if hypothesis.kind == MASS else hypothesis.term or "v",
                share=float(limit / whole),
                coefficient=fit.segments.system.parameters.names[farthest],
                change=float(change[farthest]),
                standard_errors=float(shifts[farthest]),
                relative_change=float(relative[farthest]),
            )
        )
    return tuple(sorted(unseen, key=lambda term: -term.standard_errors))


def _wholes(
    fit: LikelihoodFit, identified: Structure, tested: TestedCauses, numbers: Sequence[int]
) -> Iterator[tuple[float, float]]:
    """Of each hypothesis of these numbers what its share is taken of, in its scale, and the largest share that is possible."""
    forces = dict(
        zip((link.name for link in identified.links), link_forces(fit.optimum, fit.misfit), strict=False)
    )
    damping = largest_damping(identified)
    for number in numbers:
        hypothesis, unit = tested.hypotheses[number], float(tested.units[number])
        if hypothesis.kind == BETWEEN_MODES:
            yield damping[hypothesis.where] / unit, 1.0
        elif hypothesis.kind == MASS:
            yield 1.0 / unit, LARGEST
        else:
            yield forces.get(hypothesis.where, 0.0), np.inf
