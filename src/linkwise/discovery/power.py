"""What a record could not have shown: how large a term that was dropped may still be."""

from __future__ import annotations

import numpy as np

from linkwise.discovery.candidates import Candidates
from linkwise.discovery.selection import Selection
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.tests.diagnosis import link_forces
from linkwise.likelihood.tests.score_test import CandidateForce, candidate_forces
from linkwise.runtime import one_blas_thread


@np.errstate(over="ignore", invalid="ignore")  # a term may be infinite somewhere
def unit_shares(selection: Selection, candidates: Candidates) -> dict[str, float]:
    """The force of each candidate that was dropped from a link, per unit of its coefficient, over that of the link.

    Both are root mean squares along the fitted motion. Candidates on other pairs of masses are left out.

    Parameters
    ----------
    selection : Selection
        The selection.
    candidates : Candidates
        All candidates.

    Returns
    -------
    dict of str to float
        The ratios by name of the candidate, in the reciprocal of the unit of its coefficient.
    """
    structure, optimum = selection.structure, selection.fit.optimum
    index = structure.topology.index
    places: dict[frozenset[str], list[int]] = {}
    for number, link in enumerate(structure.links):
        places.setdefault(frozenset(link.between), []).append(number)
    tested = frozenset(selection.quadratic.names) - selection.chosen
    dropped = [
        (entry, candidates.pairs[entry.pair].between)
        for entry in candidates.entries
        if entry.name in tested and frozenset(candidates.pairs[entry.pair].between) in places
    ]
    with one_blas_thread():
        misfit = evaluate(optimum.segments, optimum.point, optimum.scales, optimum.loss)
        of_links = link_forces(optimum, misfit)
        forces = [
            CandidateForce(index[first], index[second], entry.term.law) for entry, (first, second) in dropped
        ]
        _, units = candidate_forces(optimum, misfit, forces)
    shares = {}
    for (entry, between), unit in zip(dropped, units, strict=True):
        force = sum(of_links[number] for number in places[frozenset(between)])
        shares[entry.name] = float(1.0 / (unit * force)) if force > 0.0 else np.inf
    return shares
