"""Selection where the noise of sensors is coloured: decisions by the covariance that such noise gives to the scores.

The likelihood takes noise for white, and overstates the evidence for terms in the band where a coloured one has its power.
Each round here fits the laws with the noise that was found coloured, and changes the selection by z scores that count it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkwise.discovery.selection import Selection, TermSearch, round_progress, starts_of
from linkwise.discovery.stepwise import local_search
from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.shooting.anneal import AnnealingStatus
from linkwise.likelihood.whiteness import is_coloured

_ROUNDS = 6


def select_coloured(search: TermSearch, selection: Selection) -> Selection | None:
    """The subset that no candidate improves beyond coloured noise, searched from that of `selection`.

    None where its residuals are white, where coloured noise is not what explains them best, and where the search does not
    settle.
    """
    if selection.fit.status is AnnealingStatus.INTERRUPTED or not is_coloured(selection.fit.misfit.residuals):
        return None
    structure, chosen, fit = selection.structure, selection.chosen, selection.fit
    values = fit.values
    visited = {chosen}
    for number in range(selection.rounds + 1, selection.rounds + 1 + _ROUNDS):
        options = replace(
            search.sensors, progress=round_progress(search.progress, number), nodes=fit.optimum.point.nodes
        )
        try:
            fit = likelihood_fit(search.records, structure, values, options=options)
            if fit.optimum.coloured is None or fit.status is not AnnealingStatus.CONVERGED:
                return None
            quadratic, penalty = search.local_model(fit, structure, chosen)
            after = local_search(quadratic, penalty, range(len(structure.parameters)))
            names = frozenset(quadratic.names[k] for k in after) & frozenset(search.candidates.by_name)
            if names == chosen:
                return Selection(chosen, structure, fit, quadratic, penalty, True, number)
            if names in visited:
                return None
            visited.add(names)
            chosen, structure = names, search.candidates.structure(names)
            values, _ = starts_of(quadratic, after, structure, fit)
        except (IdentificationError, np.linalg.LinAlgError):
            return None
    return None
