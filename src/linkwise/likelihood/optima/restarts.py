"""Fits from several starts: the first that explains the records to within their noise, else the best of them.

A search whose starting states come from inverse dynamics mostly fails because part of the motion started on a wrong branch of
a law while the parameters are nearly right; from these the states are computed again. A start of another kind competes with
the first one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.starts.memory import Start
from linkwise.records.record import Record

_ATTEMPTS = 3
# of records, of whose motion the first quarter mostly determines the laws to a percent
_BEGINNINGS = 0.25, 0.5
_RELEVANT = 4.0  # of -2 log likelihood: what one more parameter lowers it by with a probability of 5 %
_TIED = 20.0  # of -2 log likelihood: two optima that near, with odds of 2e4 at most, are not told apart

_ALIKE = 4.0  # standard errors within which two fits are one
_MOST = 3  # fits from starts
_NEAR = 3.0  # times the misfit of the best start beyond which another is not worth a fit


Search = Callable[..., LikelihoodFit]
"""`likelihood_fit` of some records and a structure, from values and with options."""


def fit_with_restarts(
    fitted: Search,
    theta: Floats,
    options: LikelihoodOptions,
    *,
    another: Callable[[LikelihoodOptions, LikelihoodFit], LikelihoodFit | None] | None = None,
) -> LikelihoodFit:
    """Fit up to three times, each time from the parameters of the fit before, until one converges with the expected noise.

    Parameters
    ----------
    fitted : Search
        The fit.
    theta : array of shape (p,)
        Starting values of the parameters.
    options : LikelihoodOptions
        The options; a model error is allowed only in a last fit from the best values.
    another : callable, optional
        Fits with options from a start of another kind, given the first fit; None where there is none. The likelier of both
        goes on, with the values of the other where they are as likely.

    Returns
    -------
    LikelihoodFit
        The first that converges with the expected noise, else the last; an interrupt ends the search.
    """
    strict, nodes = replace(options, model_error=False), None
    fit = fitted(theta, options=strict)
    rival = None if another is None or fit.interrupted else another(strict, fit)
    if rival is not None:
        chosen = rival if rival.interrupted else _likelier(fit, rival)
        nodes = rival.optimum.point.nodes if chosen.values is rival.values else None
        fit = chosen
    for _ in range(_ATTEMPTS - 1):
        if _ends(fit):
            return fit
        again = fitted(fit.values, options=strict)
        if not _ends(again) and _gain(again, fit) < _RELEVANT:
            break
        fit, nodes = again, None
    if _ends(fit):
        return fit
    return fitted(fit.values, options=options if nodes is None else replace(options, nodes=nodes))


def _likelier(fit: LikelihoodFit, rival: LikelihoodFit) -> LikelihoodFit:
    """The fit, or a rival that converged and is likelier by a relevant amount, with the values of the other if both may be."""
    if not (rival.converged and fit.converged):
        return rival if rival.converged else fit
    gain = _gain(rival, fit)
    if not (_ends(fit) and _ends(rival)):
        return rival if gain > _RELEVANT else fit
    likely, rejected = (rival, fit) if gain > 0.0 else (fit, rival)
    tied = abs(gain) < _TIED
    if tied and not likely.has_errors and rejected.has_errors:
        likely, rejected = rejected, likely
    return replace(likely, others=(rejected.values,)) if tied and _are_apart(rejected, likely) else likely


def fit_from_starts(search: Search, starts: Sequence[Start]) -> LikelihoodFit:
    """Fit from the best starts until a fit explains the records, with the values of other fits that are as good as the best.

    Raises IdentificationError if the motion from none of them is finite.
    """
    near = [start for start in starts if start.misfit <= _NEAR * starts[0].misfit]
    best, *others = attempts(partial(search, theta=start.values) for start in near[:_MOST])
    as_good = (
        fit.values
        for fit in others
        if fit.converged
        and _are_apart(fit, best)
        and abs(fit.misfit.cost(1.0) - best.misfit.cost(1.0)) < _TIED
    )
    return replace(best, others=tuple(as_good))


def fit_of_growing_records(search: Search, records: Sequence[Record], values: Floats) -> LikelihoodFit:
    """The fit to records from the values of fits to their beginnings, each twice as long as that before.

    Of a long chaotic motion values that are some percent off find no optimum, of its beginning they do.
    """
    for part in _BEGINNINGS:
        values = search([record[: round(part * len(record))] for record in records], theta=values).values
    return search(records, theta=values)


def attempts(searches: Iterable[Callable[[], LikelihoodFit]]) -> list[LikelihoodFit]:
    """Fits, the best first, of which the last one explains the records to within their noise or was interrupted, if any.

    Raises IdentificationError where all of the searches do.
    """
    fits: list[LikelihoodFit] = []
    failures: list[IdentificationError] = []
    for search in searches:
        try:
            fits.append(search())
        except IdentificationError as error:  # as where the motion is not finite
            failures.append(error)
            continue
        if _ends(fits[-1]):
            break
    if not fits:
        raise failures[0]
    best, *others = sorted(fits, key=_rank)
    return [replace(best, status=fits[-1].status) if fits[-1].interrupted else best, *others]


def runs_away(fit: LikelihoodFit) -> bool:
    """Whether motion with a model error soon runs away from the records, which it follows a few samples at a time."""
    return fit.model_error > 0.0 and fit.optimum.runs_away


def is_settled(fit: LikelihoodFit) -> bool:
    """Whether a fit converged to what noise or a model error explains, and its motion does not run away from the records."""
    return fit.converged and not fit.chi_square_off and not runs_away(fit)


def _rank(fit: LikelihoodFit) -> tuple[bool, bool, bool, float]:
    """Fits that are settled first, noise before a model error, then those that leave least; relaxations count as misfit."""
    settled, inexact = is_settled(fit), fit.model_error > 0.0
    left = fit.misfit.cost(fit.model_error) / fit.samples if inexact else fit.chi_square
    return not settled, runs_away(fit), settled and inexact, left


def _are_apart(fit: LikelihoodFit, best: LikelihoodFit) -> bool:
    """Whether the values of a fit are others than those of the best."""
    errors = np.sqrt(np.maximum(best.covariance.diagonal(), 0.0))
    return bool((np.abs(fit.values - best.values) > _ALIKE * errors).any())


def _gain(fit: LikelihoodFit, before: LikelihoodFit) -> float:
    """By how much -2 log likelihood is lower than in a fit before, their noise as it is left."""
    return float(fit.samples * np.log(before.chi_square / fit.chi_square))


def _ends(fit: LikelihoodFit) -> bool:
    """Whether a fit converged with the expected noise and exact laws, or was interrupted."""
    return fit.interrupted or (fit.converged and fit.leaves_noise)
