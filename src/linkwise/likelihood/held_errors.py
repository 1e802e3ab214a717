"""Errors of sensors and inputs that intervals hold: small ones, beside a model error that intervals include.

A record whose laws are a little wrong shows a little of everything: a drift, a part of a sample of delay. The score test of
such an error says to first order what it would make of each coefficient. Where that is no more than an interval can hold, it
joins the covariance as a missing term does; an answer with an error that moves a coefficient by more is not trusted. Where a
missing term explains more, which an error may look like, errors are judged beside the terms that the intervals count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.estimates.causes import Cause
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.hypotheses import BETWEEN_MODES
from linkwise.likelihood.missing_terms import MissingTerms, for_missing_terms
from linkwise.likelihood.tested_causes import TestedCauses
from linkwise.model.structure import Structure

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
        f"change {farthest.shifted} by {farthest.shift:.2g} of its standard errors, and no coefficient by more; the intervals "
        "allow for that."
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
