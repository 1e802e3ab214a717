"""Selection where random forces act that no channel shows, or shows with noise: every fit finds them beside the terms.

The states are integrated out, so that the likelihood of the terms is that of the samples alone (METHODS section 5), and the
scores of the candidates have the slope of its determinant. No fit is exact, none needs a model error.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from linkwise.discovery.criterion import Penalty
from linkwise.discovery.quadratic_model import QuadraticModel
from linkwise.discovery.selection import Selection, TermSearch, round_progress, starts_of
from linkwise.discovery.stepwise import best_subset
from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.likelihood.tests.score_test import determinant_slopes
from linkwise.model.structure import Structure

_ROUNDS = 10


def select_with_random_forces(search: TermSearch, chosen: Collection[str]) -> Selection:
    """The subset, searched from `chosen`, that no candidate tested improves beside the random forces.

    `settled` is False where a fit does not converge, where the search returns to a subset that it had left, and where the
    rounds run out.

    Raises
    ------
    IdentificationError
        If a candidate has a parameter that is to be found, or the first fit runs away.
    """
    open_terms = {entry.offered.text for entry in search.candidates.entries if entry.offered.parameters}
    if open_terms:
        raise IdentificationError(
            f"parameters of terms ({', '.join(sorted(open_terms))}) and random forces cannot be estimated together yet: give "
            "the terms with numbers"
        )
    names, structure = frozenset(chosen), search.candidates.structure(frozenset(chosen))
    theta, spread = search.start(structure)
    visited: set[frozenset[str]] = set()
    current: Selection | None = None
    nodes = None
    for number in range(1, _ROUNDS + 1):
        options = replace(search.sensors, progress=round_progress(search.progress, number), nodes=nodes)
        try:
            fit = likelihood_fit(search.records, structure, theta, spread=spread, options=options)
            quadratic, penalty = _marginal_model(search, fit, structure, names)
            after = best_subset(quadratic, penalty, range(len(structure.parameters)))
            improved = frozenset(quadratic.names[k] for k in after) & frozenset(search.candidates.by_name)
            current = Selection(names, structure, fit, quadratic, penalty, improved == names, number)
            visited.add(names)
            stopped = fit.status is not AnnealingStatus.CONVERGED
            if current.settled or stopped or improved in visited:
                return replace(current, settled=current.settled and not stopped)
            names, structure = improved, search.candidates.structure(improved)
            theta, spread = starts_of(quadratic, after, structure, fit)
            nodes = fit.optimum.point.nodes
        except (IdentificationError, np.linalg.LinAlgError):
            if current is None:
                raise
            break
    assert current is not None
    return replace(current, settled=False)


def _marginal_model(
    search: TermSearch, fit: LikelihoodFit, structure: Structure, chosen: frozenset[str]
) -> tuple[QuadraticModel, Penalty]:
    """The local model of -2 log of the marginal likelihood; of noise of inputs the determinant hardly depends on a term."""
    quadratic, penalty = search.local_model(fit, structure, chosen)
    if not any(force.ambient for force in fit.random_forces):
        return quadratic, penalty
    inside = list(range(len(structure.parameters)))
    additions = quadratic.additions(inside)
    deviations = np.abs(additions.values / np.where(additions.z == 0.0, np.nan, additions.z))
    _, forces = search.additions(structure, chosen)
    tested = [
        (place, number)
        for place, number in enumerate(additions.numbers.tolist())
        if np.isfinite(deviations[place])
    ]
    values: dict[str, float] = dict(
        zip((p.name for p in structure.parameters), map(float, fit.values), strict=True)
    )
    slopes = determinant_slopes(
        fit.optimum,
        structure.with_values(values),
        [force.where.removeprefix("force:") for force in fit.random_forces],
        [(forces[number - len(inside)], float(deviations[place])) for place, number in tested],
    )
    g = quadratic.g.copy()
    g[[number for _, number in tested]] += slopes
    return replace(quadratic, g=g), penalty
