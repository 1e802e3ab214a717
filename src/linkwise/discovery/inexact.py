"""Selection where exact laws leave more than white noise: beside coloured noise, random forces, or a model error.

Each kind of `Rounds` has its own fit and its own criterion about it: with the noise of a sensor that was found coloured
(`select_beyond_white_noise`), with random forces that no channel shows, integrated out (`select_with_random_forces`), or with
the most likely model error of the laws, by evidence that blocks of the records agree on (`select_nearly_right`). There terms
that stand in for an error of a law in a part of the records are dropped where pieces that were left out are predicted as well
without them, and those that the motion has no need of once it is held to the laws.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.criterion import CERTAIN, QuadraticModel
from linkwise.discovery.prediction import BlockParabolas, block_parabolas
from linkwise.discovery.result import PathPoint
from linkwise.discovery.selection import Rounds, Selection, Start, TermSearch, starts_of
from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.search import block_scatter
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.likelihood.tests.diagnosis import overdispersion
from linkwise.likelihood.tests.score_test import determinant_slopes
from linkwise.likelihood.whiteness import is_coloured
from linkwise.model.structure import Structure

_MOST_STEPS = 1000  # of all fits; a search that takes more creeps from one poor model to the next
_TIGHT = 1e-4  # model error from which it is looked for where a fit may do without
_LOOSER = 9.0  # times the relaxation by which motion is held: where such a fit starts
_HELD = 0.01  # times the relaxation of a model error: motion is then that of the laws, to a part of what they leave
_CLOSE = 0.05  # of the root mean square of each channel: what a run may leave that has not lost the motion


@dataclass(eq=False)
class ColouredRounds(Rounds):
    """Rounds of fits with coloured noise of a sensor, or a model error where that is likelier: it ends them.

    A likelihood that takes noise for white overstates the evidence for terms in the band where a coloured one has its power.
    """

    most: int = 6

    def changed(self, quadratic: QuadraticModel, inside: list[int], fit: LikelihoodFit) -> list[int]:
        return quadratic.local_search(inside)

    def ends(self, fit: LikelihoodFit) -> bool:
        return super().ends(fit) or fit.optimum.coloured is None


def select_beyond_white_noise(search: TermSearch, selection: Selection) -> Selection:
    """The subset that no candidate improves beyond coloured noise, where that explains the residuals of `selection` best.

    Else, or where the search does not settle, `selection` itself.
    """
    fit, rounds, number = selection.fit, ColouredRounds(search), selection.rounds + 1
    if selection.interrupted or not is_coloured(fit.misfit.residuals):
        return selection
    with suppress(IdentificationError):
        beyond = rounds.fit(selection.structure, (fit.values, None), rounds.options(number, fit))
        if beyond.optimum.coloured is not None:
            selections, _ = rounds.select(selection.chosen, number, known=beyond)
            settled = (each for each in selections if each.settled and not rounds.ends(each.fit))
            return next(settled, selection)
    return selection


@dataclass(eq=False)
class MarginalRounds(Rounds):
    """Rounds of fits beside random forces, by -2 log of the marginal likelihood (METHODS section 5).

    The states are integrated out, and the scores of the candidates have the slope of the determinant. No fit is exact.
    """

    most: int = 10

    def model(self, fit: LikelihoodFit, structure: Structure, chosen: frozenset[str]) -> QuadraticModel:
        """Of noise of inputs the determinant hardly depends on a term."""
        quadratic = super().model(fit, structure, chosen)
        if not any(force.ambient for force in fit.random_forces):
            return quadratic
        numbers, values, z = quadratic.additions(range(len(structure.parameters)))
        deviations = np.abs(values / np.where(z == 0.0, np.nan, z))
        forces = self.search.candidates.forces(self.search.added(chosen), structure)
        tested = np.flatnonzero(np.isfinite(deviations)).tolist()
        slopes = determinant_slopes(
            fit.optimum,
            structure.with_values(fit.by_name),
            [force.where.removeprefix("force:") for force in fit.random_forces],
            [(forces[place], float(deviations[place])) for place in tested],
        )
        g = quadratic.g.copy()
        g[numbers[tested]] += slopes
        return replace(quadratic, g=g)


def select_with_random_forces(search: TermSearch, chosen: frozenset[str]) -> Selection:
    """The subset, searched from `chosen`, that no candidate tested improves beside the random forces.

    `settled` is False where a fit does not converge, where the search returns to a subset that it had left, and where the
    rounds run out. Raises IdentificationError if a candidate has a parameter that is to be found, or the first fit runs away.
    """
    open_terms = {entry.offered.text for entry in search.candidates.entries if entry.offered.parameters}
    if open_terms:
        raise IdentificationError(
            f"parameters of terms ({', '.join(sorted(open_terms))}) and random forces cannot be estimated together yet: give "
            "the terms with numbers"
        )
    rounds = MarginalRounds(search)
    selections, error = rounds.select(chosen)
    if error is not None and not selections:
        raise error
    last = selections[-1]
    return replace(last, settled=last.settled and not rounds.ends(last.fit))


def _worth(quadratic: QuadraticModel, inside: list[int]) -> Floats:
    """By how much the evidence of each term exceeds its penalty; infinite for what is to stay.

    The only term of a link stays: whether masses are linked is not a question of one form.
    """
    others = quadratic.penalty.has_other_terms(inside)
    return np.where(others, quadratic.solve(inside).z ** 2 - quadratic.penalty.term, np.inf)


def simplest_model(quadratic: QuadraticModel, parabolas: BlockParabolas, inside: list[int]) -> list[int]:
    """The smallest of the models of removals from `inside`, by number, whose prediction is not measurably worse than the best.

    That is by more than the standard error, from the scatter between blocks, of the difference to the best of them (Breiman,
    Friedman, Olshen and Stone, "Classification and regression trees", 1984, section 3.4.3). Removals are of the least certain
    term again and again, while its evidence leaves it in doubt. Exact laws are left to the criterion: a decay says all it has
    to say in one block, so that the scatter is no measure of its evidence.
    """
    models = [inside]
    while (worth := _worth(quadratic, models[-1])).min() <= CERTAIN:
        models.append(np.delete(models[-1], int(np.argmin(worth))).tolist())
    excesses = [parabolas.prediction(model).excess for model in models]
    models = [model for model, excess in zip(models, excesses, strict=True) if np.isfinite(excess)]
    best = models[int(np.argmin([excess for excess in excesses if np.isfinite(excess)]))]
    for model in reversed(models):
        beside_best = parabolas.prediction(model, than=best)
        if beside_best.excess <= beside_best.scatter:
            return model
    return inside


@dataclass(eq=False)
class InexactRounds(Rounds):
    """Rounds of fits with a model error, by evidence that blocks agree on; then the terms that few blocks want are dropped.

    The error of a law moves with the motion, so that a likelihood which takes it for white noise overstates every decision.
    The quadratic model of the cost is therefore divided by the overdispersion of the scores of separate blocks of the records
    (Burnham and Anderson, "Model selection and multimodel inference", 2002, section 2.5). Scores of some terms scatter far
    more than the median: where the search has settled each is judged by its own scatter, where that is larger (Boos, "On
    generalized score tests", Am. Statist. 46, 1992), and dropped if it is not worth its penalty so.

    Each fit starts at the `relaxation` of the one before. At a `tight` one the motion is held to the laws, and no model error
    is fitted.
    """

    most: int = 8
    tight: float | None = None
    relaxation: float | None = None
    steps: int = 0

    def options(self, number: int, before: LikelihoodFit | None) -> LikelihoodOptions:
        options = replace(super().options(number, before), relaxation=self.relaxation, coloured_noise=False)
        if self.tight is not None:
            looser = _LOOSER * self.tight
            options = replace(options, relaxation=looser, tightest=self.tight, model_error=False)
        return options

    def fit(self, structure: Structure, start: Start, options: LikelihoodOptions) -> LikelihoodFit:
        return super().fit(structure, (start[0], None), options)

    def model(self, fit: LikelihoodFit, structure: Structure, chosen: frozenset[str]) -> QuadraticModel:
        """The criterion over the overdispersion of the blocks, in which no score varies less than they do."""
        quadratic = super().model(fit, structure, chosen)
        candidates = self.search.candidates
        blocks = overdispersion(fit.optimum, candidates.forces(self.search.added(chosen), structure))
        if blocks is None:
            raise np.linalg.LinAlgError("the records are too short for blocks")
        return replace(
            quadratic,
            h=quadratic.h / blocks.factor,
            g=quadratic.g / blocks.factor,
            by_blocks=tuple(scatter / blocks.factor**2 for scatter in blocks.scatters),
            overdispersion=blocks.factor,
        )

    def changed(self, quadratic: QuadraticModel, inside: list[int], fit: LikelihoodFit) -> list[int]:
        """Once no move gains, the term goes that is worth its penalty least by the scatter of its own scores."""
        self.relaxation, self.steps = fit.model_error or None, self.steps + len(fit.path)
        after = inside if self.revisits else replace(quadratic, by_blocks=()).best_subset(inside)
        if after != inside:
            return after
        self.revisits = True  # a smaller subset, from here on
        worth = _worth(quadratic, inside)
        least = int(np.argmin(worth))
        return inside if worth[least] > 0.0 else [*inside[:least], *inside[least + 1 :]]

    def ends(self, fit: LikelihoodFit) -> bool:
        return super().ends(fit) or self.steps > _MOST_STEPS

    def by_evidence(self, selection: Selection, chosen: frozenset[str] | None = None) -> Selection:
        """The subset that no candidate improves by more than blocks of the records agree on, without terms that few want.

        It is searched from that of `selection`, or from `chosen`. `settled` is False where the records are too short for
        blocks, and where rounds or steps run out.
        """
        before = selection.fit
        if chosen is not None:
            before = self.search.first_fit(self.search.candidates.structure(chosen))
            self.relaxation = _TIGHT
        start = selection.chosen if chosen is None else chosen
        selections, error = self.select(start, selection.rounds + 1, before=before)
        last = selections[-1] if selections else selection
        return replace(last, settled=error is None and (last.settled or self.revisits))

    def simplified(self, selection: Selection) -> Selection:
        """The simplest model that predicts as well as a settled selection, fitted; that selection if none does.

        Nor where a fit without the terms does not converge.
        """
        fit, candidates = selection.fit, self.search.candidates
        inexact = fit.model_error > 0.0 or self.tight is not None
        if not (selection.settled and fit.status is AnnealingStatus.CONVERGED and inexact):
            return selection
        try:
            parabolas = block_parabolas(selection)
            if parabolas is None:
                return selection
            simplest = simplest_model(selection.quadratic, parabolas, selection.inside)
            if simplest == selection.inside:
                return selection
            chosen = selection.chosen & {selection.quadratic.names[k] for k in simplest}
            structure, number = candidates.structure(chosen), selection.rounds + 1
            start = starts_of(selection.quadratic, simplest, structure, fit)
            self.relaxation = fit.model_error
            fit = self.fit(structure, start, self.options(number, fit))
            quadratic = self.model(fit, structure, chosen)
            needless = tuple(sorted(selection.chosen - chosen))
            simpler = Selection(candidates, chosen, structure, fit, quadratic, True, number, needless)
        except (IdentificationError, np.linalg.LinAlgError):
            return selection
        return simpler if fit.status is AnnealingStatus.CONVERGED else selection


def select_nearly_right(
    search: TermSearch, selection: Selection, chosen: frozenset[str] | None = None
) -> Selection:
    """The selection with a model error, or that of laws which the motion is held to, where these do with fewer terms.

    It is searched from that of `selection`, or from `chosen`: where `selection` explains the record by terms that stand in for
    one that was not offered, a smaller subset shows that a model error explains it as well. The motion is held to the laws for
    measured displacements of masses alone, the states of which records show.
    """
    rounds = InexactRounds(search)
    inexact = rounds.simplified(rounds.by_evidence(selection, chosen))
    if search.restarts or not _is_sound(inexact):
        return inexact
    try:
        return _held_to_the_laws(search, inexact) or inexact
    # the motion runs away, or says nothing of a parameter
    except (IdentificationError, np.linalg.LinAlgError):
        return inexact


def _is_sound(selection: Selection) -> bool:
    """Whether a selection settled on laws with a model error that intervals can include."""
    fit = selection.fit
    converged = selection.settled and fit.status is AnnealingStatus.CONVERGED
    return converged and fit.model_error > 0.0 and not fit.chi_square_off and fit.error_ratios is not None


def _held_to_the_laws(search: TermSearch, inexact: Selection) -> Selection | None:
    """The selection with the motion held to the laws, on the same links.

    A model error weighs what each short piece of the motion says of the forces, most of it far above resonance: best where it
    is a random force. The error of a law moves with the motion, and so does what filters of the sensors make of the highest
    harmonics, so that terms that make next to no force may take it up, beyond doubt. Values are therefore those that run
    closest to the records (output error; Ljung, "System identification", 1999, chapters 4 and 8), and the intervals count by
    how much those with a model error differ: both would agree if it were a random force (Hausman, Econometrica 46, 1978).

    None where that does not do with fewer terms, or runs far from the records.
    """
    own = replace(search, tested=search.tested & search.candidates.on_links_of(inexact.chosen))
    rounds = InexactRounds(own, tight=_HELD * inexact.fit.model_error)
    closer = rounds.simplified(rounds.by_evidence(inexact))
    fewer = len(closer.chosen) < len(inexact.chosen)
    if not (fewer and closer.settled and _runs_close(closer.fit)):
        return None
    rounds = InexactRounds(search, tight=inexact.fit.model_error)
    options = rounds.options(closer.rounds + 1, inexact.fit)
    loose = rounds.fit(closer.structure, (closer.fit.values, None), options)
    if loose.status is not AnnealingStatus.CONVERGED:
        return None
    fit = _judged_by_blocks(closer.fit, loose, inexact.fit.model_error)
    if fit is None:
        return None
    quadratic = rounds.model(fit, closer.structure, closer.chosen)
    texts = {name: entry.term.text for name, entry in search.candidates.by_name.items()}
    dropped = tuple(f"{name} ({texts[name]})" for name in sorted(inexact.chosen - closer.chosen))
    return replace(closer, fit=fit, quadratic=quadratic, of_departures=dropped)


def _runs_close(fit: LikelihoodFit) -> bool:
    """Whether a fit converged to a motion that follows the records in every channel."""
    if fit.status is not AnnealingStatus.CONVERGED:
        return False
    segments, sigma = fit.segments, fit.segments.deviations(fit.optimum.scales)
    left = np.sum((sigma * fit.misfit.residuals) ** 2, axis=(0, 2))
    shown = np.sum((segments.samples * segments.observed) ** 2, axis=(0, 2))
    return bool(np.all(left < _CLOSE**2 * shown))


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
    scatter = block_scatter(replace(optimum, noise=noise), free)
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


def choice_remarks(selection: Selection, path: Sequence[PathPoint]) -> Iterator[str]:
    """Sentences on why beside a model error these terms were selected, and neither fewer nor more of them.

    Where a larger model on the path predicts measurably better, its terms were taken from all that were offered by the same
    records, which the criterion counts and the scatter does not.
    """
    if selection.of_departures:
        yield (
            f"With a model error alone {' and '.join(selection.of_departures)} would have been selected. Held to the laws, "
            "the motion does without: values and evidence are those of the laws that run closest to the record, and the "
            "intervals allow for the others."
        )
    if selection.needless:
        needless = map(selection.quadratic.names.index, selection.needless)
        change = selection.excess([*selection.inside, *needless])
        yield (
            f"Pieces of the record that were left out are predicted as well without {' and '.join(selection.needless)}, with "
            f"which the criterion would be {abs(change):.3g} {'lower' if change < 0.0 else 'higher'}: the simplest law that "
            "predicts as well was selected."
        )
    chosen = next(number for number, point in enumerate(path) if point.chosen)
    better = [point for point in path[chosen + 1 :] if point.prediction < -point.scatter]
    if better and selection.fit.model_error > 0.0:
        first = min(better, key=lambda point: point.criterion)
        why = "blocks of the record disagree on its terms by more than they are worth"
        if first.criterion > 0.0:
            higher = f"its criterion is {first.criterion:.3g} higher"
            why = f"{higher}, which counts from how many candidates its terms were taken"
        yield (
            f"A model of {first.terms} terms predicts pieces of the record that were left out better, by "
            f"{-first.prediction:.3g} with a scatter of {first.scatter:.3g}; it was not selected because {why}. Its terms may "
            "stand in for one that was not offered."
        )
