"""Selection where the noise of sensors is coloured: decisions by the covariance that such noise gives to the scores.

The likelihood takes noise for white, and overstates the evidence for terms in the band where a coloured one has its power.
Each round here fits the laws with the noise that was found coloured, and changes the selection by z scores that count it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.selection import Selection, TermSearch, round_progress, starts_of
from linkwise.discovery.stepwise import local_search
from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.noise import is_coloured
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.model.structure import Structure

_ROUNDS = 6


def fit_beyond_white_noise(search: TermSearch, selection: Selection) -> LikelihoodFit | None:
    """The laws of `selection` fitted with coloured noise or a model error, whichever is likelier.

    None where its residuals are white, and where the fit fails.
    """
    if selection.fit.status is AnnealingStatus.INTERRUPTED or not is_coloured(selection.fit.misfit.residuals):
        return None
    try:
        return _fitted(search, selection.structure, selection.fit.values, selection.fit, selection.rounds + 1)
    except IdentificationError:
        return None


def select_coloured(search: TermSearch, selection: Selection, fit: LikelihoodFit) -> Selection | None:
    """The subset that no candidate improves beyond coloured noise, searched from that of `selection` and its `fit` with such.

    None where coloured noise is not what explains the residuals best, and where the search does not settle.
    """
    structure, chosen = selection.structure, selection.chosen
    visited = {chosen}
    last = selection.rounds + _ROUNDS
    for number in range(selection.rounds + 1, last + 1):
        if fit.optimum.coloured is None or fit.status is not AnnealingStatus.CONVERGED:
            return None
        try:
            quadratic, penalty = search.local_model(fit, structure, chosen)
            after = local_search(quadratic, penalty, range(len(structure.parameters)))
            names = frozenset(quadratic.names[k] for k in after) & frozenset(search.candidates.by_name)
            if names == chosen:
                return Selection(chosen, structure, fit, quadratic, penalty, True, number)
            if names in visited or number == last:
                return None
            visited.add(names)
            chosen, structure = names, search.candidates.structure(names)
            values, _ = starts_of(quadratic, after, structure, fit)
            fit = _fitted(search, structure, values, fit, number + 1)
        except (IdentificationError, np.linalg.LinAlgError):
            return None
    return None


def _fitted(
    search: TermSearch, structure: Structure, values: Floats, before: LikelihoodFit, number: int
) -> LikelihoodFit:
    """A fit with what explains its residuals best, from `values` and the states of the fit `before`, in the round `number`."""
    progress = round_progress(search.progress, number)
    options = replace(search.sensors, progress=progress, nodes=before.optimum.point.nodes)
    return likelihood_fit(search.records, structure, values, options=options)
