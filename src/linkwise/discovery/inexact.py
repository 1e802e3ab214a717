"""Selection where the noise of sensors is coloured: decisions by the covariance that such noise gives to the scores.

The likelihood takes noise for white, and overstates the evidence for terms in the band where a coloured one has its power.
Each round here fits the laws with the noise that was found coloured, and changes the selection by z scores that count it.

Selection where random forces act that no channel shows, or shows with noise: every fit finds them beside the terms.

The states are integrated out, so that the likelihood of the terms is that of the samples alone (METHODS section 5), and the
scores of the candidates have the slope of its determinant. No fit is exact, none needs a model error.

The simplest model on the path of removals that predicts pieces of the records as well as the best, beside a model error.

The criterion alone keeps terms that stand in for the error of a law in a part of the records. Where it is no more than in
doubt, a term must also lower what is paid for the blocks that the model was not fitted to, by more than the standard error of
the difference (the rule of one standard error: Breiman, Friedman, Olshen and Stone, "Classification and regression trees",
1984, section 3.4.3). Exact laws are left to the criterion: a decay says all it has to say in one block, so that the scatter
between blocks is no measure of its evidence.

Selection where no combination of the terms is exact: with a model error, by evidence that blocks of the records agree on.

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

Selection by how close the laws run to the records, where a model error would hide it.

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

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.model_average import PathPoint
from linkwise.discovery.prediction import BlockParabolas, block_parabolas
from linkwise.discovery.result import CERTAIN
from linkwise.discovery.selection import (
    Penalty,
    QuadraticModel,
    Selection,
    TermSearch,
    best_subset,
    local_search,
    round_progress,
    starts_of,
)
from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.noise import is_coloured
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.search import block_scatter
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.likelihood.tests.diagnosis import overdispersion
from linkwise.likelihood.tests.score_test import determinant_slopes
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport

_COLOUR_ROUNDS = 6


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
    last = selection.rounds + _COLOUR_ROUNDS
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


_FORCE_ROUNDS = 10


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
    for number in range(1, _FORCE_ROUNDS + 1):
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


def simplest_model(
    quadratic: QuadraticModel, penalty: Penalty, parabolas: BlockParabolas, inside: list[int]
) -> list[int]:
    """The smallest of the models of removals from `inside`, by number, whose prediction is not measurably worse than the best.

    That is by more than the scatter between blocks of the difference to the best of them.
    """
    models = [inside, *_removals(quadratic, penalty, inside)]
    excesses = np.array([parabolas.prediction(model).excess for model in models])
    models = [model for model, excess in zip(models, excesses, strict=True) if np.isfinite(excess)]
    best = models[int(np.argmin(excesses[np.isfinite(excesses)]))]
    for model in reversed(models):
        beside_best = parabolas.prediction(model, than=best)
        if beside_best.excess <= beside_best.scatter:
            return model
    return inside


def _removals(quadratic: QuadraticModel, penalty: Penalty, inside: list[int]) -> list[list[int]]:
    """The models after dropping the least certain term again and again, while its evidence leaves it in doubt.

    The only term of a link stays: whether masses are linked is not a question of one form.
    """
    models: list[list[int]] = []
    current = list(inside)
    while True:
        pairs = penalty.pair[current].tolist()
        worth = np.array(
            [
                z**2 - penalty.term
                if pair >= 0 and (pairs.count(pair) > 1 or pair in penalty.stated)
                else np.inf
                for z, pair in zip(quadratic.solve(current).z, pairs, strict=True)
            ]
        )
        least = int(np.argmin(worth))
        if worth[least] > CERTAIN:
            return models
        current = [*current[:least], *current[least + 1 :]]
        models.append(current)


def terms_asked_for(selection: Selection, candidates: Candidates) -> bool:
    """Whether, beside the fit of a simplified `selection`, a term it lacks is beyond doubt, or all measurably predict more."""
    inside = range(len(selection.structure.parameters))
    needless = _needless(selection)
    additions = selection.quadratic.additions(inside)
    worth = dict(zip(additions.numbers.tolist(), additions.z**2 - selection.penalty.term, strict=True))
    if any(worth[number] > CERTAIN for number in needless):
        return True
    parabolas = block_parabolas(selection, candidates, needless)
    if parabolas is None:
        return True
    larger = parabolas.prediction([*inside, *needless])
    return larger.excess < -larger.scatter


def _needless(selection: Selection) -> list[int]:
    """The numbers of the terms that the selection was simplified by."""
    return [number for number, name in enumerate(selection.quadratic.names) if name in selection.needless]


def simplest_model_remarks(selection: Selection) -> tuple[str, ...]:
    """A sentence on the terms that the criterion would have kept, and prediction did not ask for."""
    if not selection.needless:
        return ()
    quadratic, penalty = selection.quadratic, selection.penalty
    inside = list(range(len(selection.structure.parameters)))
    larger = [*inside, *_needless(selection)]
    change = quadratic.cost(larger) + penalty.total(larger) - quadratic.cost(inside) - penalty.total(inside)
    terms = " and ".join(selection.needless)
    return (
        f"Pieces of the record that were left out are predicted as well without {terms}, with which the criterion "
        f"would be {abs(change):.3g} {'lower' if change < 0.0 else 'higher'}: the simplest law that predicts as "
        "well was selected.",
    )


def larger_model_remarks(path: Sequence[PathPoint], *, inexact: bool) -> tuple[str, ...]:
    """A sentence where a larger model on the path predicts measurably better beside laws that are `inexact`: why it stays out.

    Its terms were taken from all that were offered by the same records, which the criterion counts and the scatter does not.
    """
    chosen = next(number for number, point in enumerate(path) if point.chosen)
    better = [point for point in path[chosen + 1 :] if point.prediction < -point.scatter]
    if not (inexact and better):
        return ()
    first = min(better, key=lambda point: point.criterion)
    if first.criterion > 0.0:
        why = f"its criterion is {first.criterion:.3g} higher, which counts from how many candidates its terms were taken"
    else:
        why = "blocks of the record disagree on its terms by more than they are worth"
    return (
        f"A model of {first.terms} terms predicts pieces of the record that were left out better, by {-first.prediction:.3g} "
        f"with a scatter of {first.scatter:.3g}; it was not selected because {why}. Its terms may stand in for one that was "
        "not offered.",
    )


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
