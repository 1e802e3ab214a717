"""Selection by how close the laws run to the records, where a model error would hide it.

A fit with a model error weighs what each short piece of the motion says of the forces, most of it far above resonance. That
is best where the error is a random force. The error of a law is none: it moves with the motion, and so does what filters of
the sensors make of the highest harmonics, so that terms that make next to no force may take it up, beyond doubt. Here the laws
are therefore fitted once more with the motion held to them. Where that predicts pieces of the records that were left out
measurably better than the values with the model error do, and asks for fewer terms, evidence and prediction are those of the
motion held to the laws, scattered over blocks as before: the values are those that run closest to the records (output error),
and the intervals count by how much those with a model error differ. Both would agree if the error were a random force (Hausman
1978). Where the terms are the same, the values with a model error stay.

References
----------
L. Ljung, "System identification: theory for the user" (1999), chapters 4 and 8.
J. A. Hausman, "Specification tests in econometrics", Econometrica 46 (1978).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.inexact_laws import (
    cautious_model,
    inexact_options,
    select_by_evidence,
    select_inexact,
    simplified,
)
from linkwise.discovery.prediction import block_parabolas
from linkwise.discovery.selection import Selection, TermSearch
from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.search import block_scatter
from linkwise.likelihood.shooting.minimise import AnnealingStatus

_HELD = 0.01  # times the relaxation of a model error: motion is then that of the laws, to a part of what they leave
_CLOSE = 0.05  # of the root mean square of each channel: what a run may leave that has not lost the motion
_WORTH = 0.05  # of the sum of squares that such a run leaves: 2.5 % of its root mean square
_BEYOND = 2.0  # scatters between blocks from which one prediction is better than another one


def select_nearly_right(
    search: TermSearch,
    selection: Selection,
    chosen: frozenset[str] | None = None,
    *,
    known: LikelihoodFit | None = None,
) -> Selection:
    """The selection of `select_inexact`, or that of laws which the motion is held to, where these predict measurably better.

    That is for measured displacements of masses alone, the states of which records show.
    """
    inexact = select_inexact(search, selection, chosen, known=known)
    if search.restarts or not _is_sound(inexact):
        return inexact
    try:
        return _held_to_the_laws(search, inexact) or inexact
    except (
        IdentificationError,
        np.linalg.LinAlgError,
    ):  # the motion runs away, or says nothing of a parameter
        return inexact


def _is_sound(selection: Selection) -> bool:
    """Whether a selection settled on laws with a model error that intervals can include."""
    fit = selection.fit
    converged = selection.settled and fit.status is AnnealingStatus.CONVERGED
    return converged and fit.model_error > 0.0 and not fit.chi_square_off and fit.error_ratios is not None


def _held_to_the_laws(search: TermSearch, inexact: Selection) -> Selection | None:
    """The selection with the motion held to the laws, on the same links.

    None where that does not predict measurably better, or does not do with fewer terms.
    """
    tight = _HELD * inexact.fit.model_error
    first = _fit(search, inexact, inexact.fit.optimum.point.nodes, tight)
    if not _runs_close(first):
        return None
    quadratic, penalty = cautious_model(search, first, inexact.structure, inexact.chosen)
    closer = replace(inexact, fit=first, quadratic=quadratic, penalty=penalty, rounds=inexact.rounds + 1)
    if not _runs_closer(search, closer, inexact.fit.values):
        return None
    own = search.within(search.candidates.on_links_of(inexact.chosen))
    closer = simplified(own, select_by_evidence(own, closer, known=first, tight=tight), tight=tight)
    fewer = len(closer.chosen) < len(inexact.chosen)
    if not (fewer and closer.settled and _runs_close(closer.fit)):
        return None
    loose = _fit(search, closer, inexact.fit.optimum.point.nodes, inexact.fit.model_error)
    if loose.status is not AnnealingStatus.CONVERGED:
        return None
    fit = _judged_by_blocks(closer.fit, loose, inexact.fit.model_error)
    if fit is None:
        return None
    quadratic, penalty = cautious_model(search, fit, closer.structure, closer.chosen)
    texts = {name: entry.term.text for name, entry in search.candidates.by_name.items()}
    dropped = tuple(f"{name} ({texts[name]})" for name in sorted(inexact.chosen - closer.chosen))
    return replace(closer, fit=fit, quadratic=quadratic, penalty=penalty, of_departures=dropped)


def free_run_remarks(selection: Selection) -> tuple[str, ...]:
    """A sentence on the terms that a model error asked for, and the motion held to the laws did not."""
    if not selection.of_departures:
        return ()
    return (
        f"With a model error alone {' and '.join(selection.of_departures)} would have been selected. Held to the laws, the "
        "motion does without, and pieces of the record that were left out are predicted better: values and evidence are those "
        "of the laws that run closest to the record, and the intervals allow for the others.",
    )


def _fit(search: TermSearch, selection: Selection, nodes: Floats, relaxation: float) -> LikelihoodFit:
    """A fit of the laws of a selection at one `relaxation`, from its values and `nodes`."""
    options = inexact_options(
        search, search.progress, selection.rounds + 1, nodes, relaxation, tight=relaxation
    )
    return likelihood_fit(search.records, selection.structure, selection.fit.values, options=options)


def _runs_close(fit: LikelihoodFit) -> bool:
    """Whether a fit converged to a motion that follows the records in every channel."""
    if fit.status is not AnnealingStatus.CONVERGED:
        return False
    segments, sigma = fit.segments, fit.optimum.scales.sigma[:, None]
    if segments.relative_noise is not None:
        sigma = sigma * segments.relative_noise
    left = np.sum((sigma * fit.misfit.residuals) ** 2, axis=(0, 2))
    shown = np.sum((segments.samples * segments.observed) ** 2, axis=(0, 2))
    return bool(np.all(left < _CLOSE**2 * shown))


def _runs_closer(search: TermSearch, closer: Selection, values: Floats) -> bool:
    """Whether pieces that a fit leaves out in turn are predicted better by it than by other `values` (p,) of its laws.

    That is beyond the scatter between blocks, and by more than next to nothing of what it leaves.
    """
    parabolas = block_parabolas(closer, search.candidates, ())
    if parabolas is None:
        return False
    farther = parabolas.prediction_of(values / closer.fit.optimum.scales.theta[: len(values)])
    return farther.excess > max(_BEYOND * farther.scatter, _WORTH * parabolas.cost)


def _judged_by_blocks(
    closest: LikelihoodFit, loose: LikelihoodFit, model_error: float
) -> LikelihoodFit | None:
    """The fit that runs `closest` with the model error of a `loose` one, and covariance from blocks; None without blocks.

    By how far the values of both differ is counted with the covariance.
    """
    optimum, p = closest.optimum, len(closest.values)
    noise = float(np.sqrt(closest.chi_square))
    free = np.ones(len(optimum.point.border), dtype=bool)
    free[:p] = closest.free
    scatter = block_scatter(
        closest.segments,
        closest.misfit,
        optimum.scales,
        optimum.loss,
        q=optimum.q,
        noise=noise,
        free=free,
    )
    if scatter is None:
        return None
    white = noise * np.sqrt(np.maximum(closest.covariance.diagonal(), np.finfo(float).tiny))
    by_blocks = scatter.ratios[:p] * noise
    moved = np.where(closest.free, loose.values - closest.values, 0.0)
    covariance = closest.covariance * np.outer(by_blocks, by_blocks) + np.outer(moved, moved)
    return replace(
        closest,
        covariance=covariance,
        noise=loose.noise,
        chi_square=loose.chi_square,
        chi_square_off=False,
        model_error=model_error,
        force_error=loose.force_error,
        error_ratios=np.sqrt(np.maximum(covariance.diagonal(), 0.0)) / white,
        optimum=replace(optimum, noise=noise),
    )
