"""Selection where no combination of the terms is exact: with a model error, by evidence that blocks of the records agree on.

The error of a law moves with the motion, so that a likelihood which takes it for white noise overstates every decision. Here
each round fits the laws with their most likely model error, and divides the local quadratic model of the cost by the
overdispersion of the scores of separate blocks of the records, as quasi-likelihood does. Scores of some terms scatter far more
than the median of all does. Where the search has settled each is therefore judged by its own scatter, where that is larger
(generalised score tests), and dropped if it is not worth its penalty so. Of the models that then differ by terms in doubt the
simplest is taken that predicts blocks it was not fitted to as well as the best (`simplest_model`).

References
----------
K. P. Burnham and D. R. Anderson, "Model selection and multimodel inference" (2002), section 2.5.
D. D. Boos, "On generalized score tests", Am. Statist. 46 (1992).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.criterion import Penalty
from linkwise.discovery.prediction import block_parabolas
from linkwise.discovery.quadratic_model import QuadraticModel
from linkwise.discovery.selection import Selection, TermSearch, round_progress, starts_of
from linkwise.discovery.simplest_model import simplest_model, terms_asked_for
from linkwise.discovery.stepwise import best_subset
from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.likelihood.tests.diagnosis import overdispersion
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport

_ROUNDS = 8
_MOST_STEPS = 1000  # of all fits; a search that takes more creeps from one poor model to the next
_TIGHT = 1e-4  # model error from which it is looked for where a fit may do without
_LOOSER = 9.0  # times the relaxation by which motion is held: where such a fit starts


def select_inexact(
    search: TermSearch,
    selection: Selection,
    chosen: frozenset[str] | None = None,
    *,
    known: LikelihoodFit | None = None,
) -> Selection:
    """The subset that no candidate improves by more than blocks of the records agree on, without terms that few blocks want.

    It is searched from that of `selection`, or from `chosen`: where `selection` explains the record by terms that stand in for
    one that was not offered, a smaller subset shows that a model error explains it as well. The fit of `selection` with its
    model error may be `known`. `settled` is False where a fit does not converge with a model error, where the records are too
    short for blocks, and where rounds or steps run out.
    """
    return simplified(search, select_by_evidence(search, selection, chosen, known=known))


def select_by_evidence(
    search: TermSearch,
    selection: Selection,
    chosen: frozenset[str] | None = None,
    *,
    known: LikelihoodFit | None = None,
    tight: float | None = None,
) -> Selection:
    """The selection by evidence alone, as `select_inexact` describes it.

    With a `tight` relaxation the motion is held to the laws by it, and no model error is fitted.
    """
    steps = 0

    def counted(report: ProgressReport, /) -> None:
        nonlocal steps
        steps += 1
        search.progress(report)

    current, relaxation = selection, None
    fit, structure = selection.fit, selection.structure
    if chosen is None:
        chosen = selection.chosen
    else:
        structure = search.candidates.structure(chosen)
        fit, relaxation = search.first_fit(structure), _TIGHT
    visited, reducing = {chosen}, False
    values, nodes = fit.values, fit.optimum.point.nodes
    for number in range(selection.rounds + 1, selection.rounds + 1 + _ROUNDS):
        options = inexact_options(search, counted, number, nodes, relaxation, tight=tight)
        try:
            fit = known or likelihood_fit(search.records, structure, values, options=options)
            known = None
        except IdentificationError:  # the motion runs away from where the last round led
            return replace(current, settled=False)
        try:
            quadratic, penalty = cautious_model(search, fit, structure, chosen)
            inside = list(range(len(structure.parameters)))
            after = inside if reducing else best_subset(replace(quadratic, by_blocks=()), penalty, inside)
            reducing = reducing or after == inside
            if reducing:
                after = _without_uneven(quadratic, penalty, inside)
            names = frozenset(quadratic.names[k] for k in after) & frozenset(search.candidates.by_name)
            current = Selection(chosen, structure, fit, quadratic, penalty, reducing, number)
            if names == chosen or fit.status is not AnnealingStatus.CONVERGED or steps > _MOST_STEPS:
                break
            if names in visited and not reducing:
                break
            visited.add(names)
            chosen, structure = names, search.candidates.structure(names)
            values, _ = starts_of(quadratic, after, structure, fit)
        except np.linalg.LinAlgError:
            return replace(current, settled=False)
        nodes, relaxation = fit.optimum.point.nodes, fit.model_error or None
    return current


def inexact_options(
    search: TermSearch,
    progress: Progress,
    number: int,
    nodes: Floats | None,
    relaxation: float | None,
    *,
    tight: float | None = None,
) -> LikelihoodOptions:
    """Those of the fit of a round, from the `nodes` and the `relaxation` of the one before, or at a `tight` one."""
    options = replace(
        search.sensors,
        progress=round_progress(progress, number),
        nodes=nodes,
        relaxation=relaxation,
        coloured_noise=False,
    )
    if tight is None:
        return options
    return replace(options, relaxation=_LOOSER * tight, tightest=tight, model_error=False)


def simplified(search: TermSearch, selection: Selection, *, tight: float | None = None) -> Selection:
    """The simplest model that predicts as well as a settled selection with a model error, fitted; that selection if none does.

    Nor where a fit without the terms does not converge, or asks for them after all. At a `tight` relaxation no model error is
    fitted.
    """
    fit = selection.fit
    inexact = fit.model_error > 0.0 or tight is not None
    if not (selection.settled and fit.status is AnnealingStatus.CONVERGED and inexact):
        return selection
    inside = list(range(len(selection.structure.parameters)))
    try:
        parabolas = block_parabolas(selection, search.candidates, ())
        if parabolas is None:
            return selection
        simplest = simplest_model(selection.quadratic, selection.penalty, parabolas, inside)
        if simplest == inside:
            return selection
        names = frozenset(selection.quadratic.names[k] for k in simplest)
        chosen = names & frozenset(search.candidates.by_name)
        structure = search.candidates.structure(chosen)
        values, _ = starts_of(selection.quadratic, simplest, structure, fit)
        number, nodes = selection.rounds + 1, fit.optimum.point.nodes
        options = inexact_options(search, search.progress, number, nodes, fit.model_error, tight=tight)
        fit = likelihood_fit(search.records, structure, values, options=options)
        quadratic, penalty = cautious_model(search, fit, structure, chosen)
        needless = tuple(sorted(selection.chosen - chosen))
        simpler = Selection(chosen, structure, fit, quadratic, penalty, True, number, needless)
        asked_for = terms_asked_for(simpler, search.candidates)
    except (IdentificationError, np.linalg.LinAlgError):
        return selection
    return selection if asked_for or fit.status is not AnnealingStatus.CONVERGED else simpler


def _without_uneven(quadratic: QuadraticModel, penalty: Penalty, inside: list[int]) -> list[int]:
    """The coefficients `inside` without the term that is worth its penalty least, judged by the scatter of its own scores.

    All of them if each is worth it. The only term of a link stays: whether masses are linked is not a question of one form.
    """
    pairs = penalty.pair[inside].tolist()
    worth = np.array(
        [
            z**2 if pair >= 0 and (pairs.count(pair) > 1 or pair in penalty.stated) else np.inf
            for z, pair in zip(quadratic.solve(inside).z, pairs, strict=True)
        ]
    )
    least = int(np.argmin(worth))
    return inside if worth[least] > penalty.term else [*inside[:least], *inside[least + 1 :]]


def cautious_model(
    search: TermSearch, fit: LikelihoodFit, structure: Structure, chosen: frozenset[str]
) -> tuple[QuadraticModel, Penalty]:
    """The local model of the cost over the overdispersion of the blocks, in which no score varies less than they do.

    LinAlgError where there is none.
    """
    quadratic, penalty = search.local_model(fit, structure, chosen)
    blocks = overdispersion(fit.optimum, search.additions(structure, chosen)[1])
    if blocks is None:
        raise np.linalg.LinAlgError("the records are too short for blocks")
    return replace(
        quadratic,
        h=quadratic.h / blocks.factor,
        g=quadratic.g / blocks.factor,
        by_blocks=tuple(scatter / blocks.factor**2 for scatter in blocks.scatters),
    ), penalty
