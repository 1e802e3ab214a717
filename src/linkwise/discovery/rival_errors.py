"""Errors of stated values beside which terms that were found would not be needed.

A mass that is stated 1 % wrong leaves a force in proportion to its acceleration, for which a term on another link may stand
in: a spring to the ground, of a mass that moves mostly at one frequency. A score test of the error beside all terms found is
then silent. Here each term in turn gives way to each error, in the local quadratic model, and the criterion of the best model
without the term against that of the selection says which of both the records prefer.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.discovery.quadratic_model import QuadraticModel, inverse_of
from linkwise.discovery.result import CERTAIN
from linkwise.discovery.selection import Selection
from linkwise.discovery.stepwise import local_search
from linkwise.likelihood.tests.columns import errors_of_stated_values
from linkwise.likelihood.tests.score_test import Hypothesis
from linkwise.model.structure import Structure

_LARGEST = 0.05  # relative: scales, load cells and data sheets are better than that
_LARGEST_DAMPING = 1.0  # of a mode, which changes with temperature and joints
_STRONG = 6.0  # of the criterion: "strong" evidence for the error (Kass and Raftery 1995)
_STATED = {
    "mass": "the mass of {} were {} than stated",
    "coefficient": "{} were {} than stated",
    "frequency": "the frequency of {} were {} than stated",
    "damping": "the damping of {} were {} than stated",
}
_PHRASES = {
    **_STATED,
    "force gain": "{} were {} than recorded",
    "offset": "{} had a zero offset of {}",
    "common offset": "{} were off by {}",
}
_CHECK = "check the value, or let it be unknown"
_ADVICE = {
    **dict.fromkeys(_STATED, _CHECK),
    "force gain": "check its calibration",
    "offset": "check the zero of the channel, or estimate its offset",
    "common offset": "check the zeros of the channels, or estimate their offsets and offer no constant force",
}
_OFFSETS = {
    "offset": "a zero offset of a sensor",
    "common offset": "a zero offset that all sensors of displacement have in common",
}
_SAME = 0.05  # of the criterion: rounds to 0.0
_NAMED = 3
_DROPPED_BESIDE = 2  # more links that an error may make needless with a term


@dataclass(frozen=True)
class RivalError:
    """An error of a stated value, `where`, of relative `size`, beside which the `terms`, by number, are not needed.

    Or a zero offset of a channel, or one of all displacements, in a `unit`.

    `excess` is the criterion of that model above that of the selection: below zero the records prefer the error.
    """

    kind: str
    where: str
    size: float
    terms: tuple[int, ...]
    excess: float
    unit: str = ""

    @property
    def is_preferred(self) -> bool:
        """Whether the records are strong evidence for the error and against the terms."""
        return self.excess < -_STRONG

    def remark(self, names: tuple[str, ...]) -> str:
        """A sentence for the user; `names` are those of all terms by number."""
        size = f"{100.0 * abs(self.size):.2g} % {'more' if self.size > 0.0 else 'less'}"
        of = "an error of what is stated"
        if self.kind in _OFFSETS:
            size, of = f"{self.size:.3g} {self.unit}", _OFFSETS[self.kind]
        error = _PHRASES[self.kind].format(self.where, size)
        terms = " and ".join(names[number] for number in self.terms)
        if self.is_preferred:
            return (
                f"If {error}, {terms} would not be needed and the criterion would be {-self.excess:.3g} lower: "
                f"{_ADVICE[self.kind]}."
            )
        error = error.replace("a zero offset", "one")
        change = f"only {self.excess:.1f} higher" if self.excess > 0.0 else f"{-self.excess:.1f} lower"
        if abs(self.excess) < _SAME:
            change = "the same"
        return (
            f"This record hardly distinguishes {terms} from {of}: if {error}, the criterion would be {change} without "
            f"{'it' if len(self.terms) == 1 else 'them'}."
        )


def rival_errors(selection: Selection, identified: Structure) -> tuple[RivalError, ...]:
    """For each set of terms that errors of stated values could replace the best such error, the best set first.

    `identified` is the structure of the selection with the values of its fit.
    """
    structure = selection.structure
    try:
        hypotheses, local = errors_of_stated_values(selection.fit.optimum, structure, identified)
    except np.linalg.LinAlgError:
        return ()
    p = len(structure.parameters)
    names = (*selection.quadratic.names[:p], *(hypothesis.where for hypothesis in hypotheses))
    model = QuadraticModel(names, local.curvature, local.slope, local.scatter)
    unknown = {mass.name for mass in structure.masses if not mass.mass.known}
    try:
        screened = _may_be_replaced(
            selection, model, np.array([_largest(hypothesis) for hypothesis in hypotheses])
        )
    except np.linalg.LinAlgError:
        return ()
    rivals = [
        RivalError(hypothesis.kind, hypothesis.where, size, terms, excess)
        for number, hypothesis in enumerate(hypotheses)
        if hypothesis.kind in _PHRASES and hypothesis.where not in unknown
        for term in np.flatnonzero(screened[:, number]).tolist()
        for size, terms, excess in without_term(selection, model, p + number, term)
        if abs(size) < _largest(hypothesis)
    ]
    best: dict[tuple[int, ...], RivalError] = {}
    for rival in sorted(rivals, key=lambda rival: rival.excess):
        best.setdefault(rival.terms, rival)
    return tuple(best.values())


def rival_remarks(rivals: tuple[RivalError, ...], names: tuple[str, ...]) -> tuple[str, ...]:
    """Sentences on the first of the `rivals`, with the `names` of terms by number."""
    return tuple(rival.remark(names) for rival in rivals[:_NAMED])


def _largest(hypothesis: Hypothesis) -> float:
    """The largest relative error of a stated value."""
    return _LARGEST_DAMPING if hypothesis.kind == "damping" else _LARGEST


def _may_be_replaced(selection: Selection, model: QuadraticModel, largest: Floats) -> Bools:
    """(p, e) whether a term, dropped beside an error, leaves a small error and a criterion that more drops may lower.

    Small is below `largest` (e,). By the inverse of the curvature of all terms, bordered by each error. Raises
    numpy.linalg.LinAlgError if the columns of the terms are linearly dependent.
    """
    penalty, p = selection.penalty, len(selection.structure.parameters)
    pair = penalty.pair[:p]
    alone = np.array(
        [np.sum(pair == number) == 1 and number not in penalty.stated for number in pair.tolist()]
    )
    saved = penalty.term + np.where(alone, penalty.link, 0.0)
    inverse = inverse_of(model.h[:p, :p])
    values, cross = inverse @ model.g[:p], model.h[:p, p:]
    along = inverse @ cross  # (p, e)
    left = model.h.diagonal()[p:] - np.einsum("pe,pe->e", cross, along)
    left = np.where(left > 0.0, left, np.inf)
    errors = (model.g[p:] - cross.T @ values) / left
    variance = inverse.diagonal()[:, None] + along**2 / left
    beside = values[:, None] - along * errors  # the terms beside each error
    sizes = errors + along / left / variance * beside  # of the error, once the term is dropped
    excess = beside**2 / variance - left * errors**2 + penalty.term - saved[:, None]
    more = _DROPPED_BESIDE * (penalty.term + penalty.link)
    return np.asarray((pair >= 0)[:, None] & (np.abs(sizes) < largest) & (excess < CERTAIN + more))


def without_term(
    selection: Selection, model: QuadraticModel, error: int, term: int
) -> Iterator[tuple[float, tuple[int, ...], float]]:
    """Where an error, by its number in `model`, may replace a term: its size, all terms replaced, and the excess.

    The latter is the criterion above that of the selection, if it is below 10; of errors only this one may join.
    """
    penalty, p = selection.penalty, len(selection.structure.parameters)
    chosen = list(range(p))
    selected = model.cost(chosen) + penalty.total(chosen)
    inside = np.array([*(number for number in chosen if number != term), error])
    block = np.ix_(inside, inside)
    scatter = None if model.scatter is None else model.scatter[block]
    part = QuadraticModel(tuple(model.names[k] for k in inside), model.h[block], model.g[inside], scatter)
    of_part = replace(penalty, pair=np.append(penalty.pair[inside[:-1]], -1))  # the error is not selected
    try:
        retained = local_search(part, of_part, range(p))
        size = float(part.solve(retained).values[-1])
        excess = part.cost(retained) + of_part.total(retained) + penalty.term - selected
    except np.linalg.LinAlgError:
        return
    if excess < CERTAIN:
        replaced = sorted(set(chosen) - set(inside[retained].tolist()))
        yield size, tuple(replaced), float(excess)
