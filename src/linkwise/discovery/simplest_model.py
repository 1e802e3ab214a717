"""The simplest model on the path of removals that predicts pieces of the records as well as the best, beside a model error.

The criterion alone keeps terms that stand in for the error of a law in a part of the records. Where it is no more than in
doubt, a term must also lower what is paid for the blocks that the model was not fitted to, by more than the standard error of
the difference (the rule of one standard error: Breiman, Friedman, Olshen and Stone, "Classification and regression trees",
1984, section 3.4.3). Exact laws are left to the criterion: a decay says all it has to say in one block, so that the scatter
between blocks is no measure of its evidence.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.discovery.candidates import Candidates
from linkwise.discovery.criterion import Penalty
from linkwise.discovery.other_models import PathPoint
from linkwise.discovery.prediction import BlockParabolas, block_parabolas
from linkwise.discovery.quadratic_model import QuadraticModel
from linkwise.discovery.result import CERTAIN
from linkwise.discovery.selection import Selection


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
