"""Structures with what a diagnosis names: a missing term or link, or an unknown for a stated value that is off.

What laws with the likeliest missing terms say of an answer whose laws lack them.

A model error hides what is smaller than itself: beside a host that lacks a cubic term, a spring that nobody stated, or a mass
that is stated wrong, may move another coefficient by ten of its standard errors and no score be significant. Laws with the
likeliest term are therefore fitted, and with what is significant beside it, until they leave only noise. Only then do they
say whether the intervals hold: laws that still leave more have shadows of what they lack among their scores.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.estimates.causes import Cause
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.likelihood.checks.changed_coefficients import likeliest_change, with_change
from linkwise.likelihood.checks.judgement import LARGEST_SHIFT, Examined, Judgement
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.marginal import is_long
from linkwise.likelihood.optima.other_optima import with_faint_modes
from linkwise.likelihood.options import LikelihoodOptions, is_admissible, with_error
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.likelihood.tests.diagnosis import Diagnosis, diagnose
from linkwise.likelihood.tests.score_test import MEMORY_TERMS, CandidateForce, candidate_forces
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.link import Link
from linkwise.model.names import SHAPE
from linkwise.model.structure import Structure
from linkwise.progress import part
from linkwise.records.record import Record
from linkwise.verdict import Verdict

FREED = {
    "mass": "mass:{where}",
    "frequency": "{where}.frequency",
    "shape": f"{{source}}.{SHAPE}{{point}}",
}
"""What `Structure.unknown` frees where a stated value is off, by the kind of the cause."""


def with_cause(structure: Structure, cause: Cause) -> Structure:
    """The structure with a missing term or link of unknown size, or with an unknown for a stated value that is off.

    Parameters
    ----------
    structure : Structure
        The structure.
    cause : Cause
        A cause of the kind "term", "link", "mass", "frequency" or "shape".

    Returns
    -------
    Structure
        The structure with it.
    """
    links = structure.links
    if cause.kind in FREED:
        point = cause.where.partition(".")[2]  # after the name of its host, which has no dot
        which = FREED[cause.kind].format(where=cause.where, source=cause.source, point=point)
        return _with_own_value(structure, cause).unknown(which)
    if cause.kind == "link":
        name = cause.where.replace("-", "_")
        while any(link.name == name for link in links):
            name += "_"
        law, coefficients = Law.parse(f"size*({cause.term})"), {"size": Coefficient.unknown(start=0.0)}
        return replace(structure, links=(*links, Link(name, ends_of(structure, cause), law, coefficients)))
    return replace(
        structure,
        links=tuple(_with_term(link, cause.term) if link.name == cause.where else link for link in links),
    )


def _with_own_value(structure: Structure, cause: Cause) -> Structure:
    """The structure in which the mass or the frequency of a cause is equal to no other's, as its score takes it alone."""
    name = f"{cause.where}.{cause.kind}"

    def apart(coefficient: Coefficient, own: str) -> Coefficient:
        is_shared = own == name or coefficient.same_as == name
        return replace(coefficient, same_as=None) if coefficient.known and is_shared else coefficient

    masses = (replace(mass, mass=apart(mass.mass, f"{mass.name}.mass")) for mass in structure.masses)
    links = (
        replace(
            link, coefficients={key: apart(c, f"{link.name}.{key}") for key, c in link.coefficients.items()}
        )
        for link in structure.links
    )
    return replace(structure, masses=tuple(masses), links=tuple(links))


def ends_of(structure: Structure, cause: Cause) -> tuple[str, str]:
    """The two ends of a missing link, which a cause has in one word.

    Parameters
    ----------
    structure : Structure
        The structure.
    cause : Cause
        A cause of the kind "link".

    Returns
    -------
    tuple of (str, str)
        The places that it joins.
    """
    places = list(structure.topology.index)
    return next(
        (first, second) for first in places for second in places if f"{first}-{second}" == cause.where
    )


def _with_term(link: Link, term: str) -> Link:
    name = "added"
    while name in link.coefficients or name in link.law.variables:
        name += "_"
    declared = dict(link.law.declared)
    if declared:  # as of a mode, whose law has numbers with units
        declared |= Law.parse(f"{name}*({term})").units
    signals = dict(link.law.signal_units)
    law = Law.parse(f"{link.law.text} + {name}*({term})", link.states, units=declared, signals=signals)
    return replace(link, law=law, coefficients={**link.coefficients, name: Coefficient.unknown(start=0.0)})


_MOST = 4  # terms, links and errors that are added
_NEAR = 3.0  # standard errors within which coefficients are looked for
_ALIKE = 0.5  # of what the likeliest cause gains: others that may stand for it
_AS_LIKELY = 9.0  # of -2 log likelihood: three standard errors
_TRIED = 3  # causes that are as likely
_LEFT = 2.0  # chi-square that exact laws may leave where more is missing

_CROSSTALK = "crosstalk"
_TINY = float(np.finfo(float).tiny)


def richer_laws(of: Examined, before: Judgement) -> Judgement | None:
    """Whether laws with the likeliest term, and what is significant beside it, leave only noise, and move coefficients.

    Neither where the laws were searched nor in long records, which are not fitted again.
    """
    fit, structure, records, causes = of.fit, of.structures[0], of.records, before.diagnosis
    if before.verdict is not Verdict.MODEL_ERROR_NEEDED or not causes or causes[0].kind != "term":
        return None
    if of.searched or fit.random_forces or is_long(fit.segments):
        return None
    deviations = np.sqrt(np.maximum(with_faint_modes(fit, of.identified)[0].diagonal(), _TINY))
    exact = _exact_laws(causes[0], fit, structure, records, deviations)
    if exact is None:
        return None
    terms = " and ".join(map(_in_words, exact.added))
    if exact.is_interrupted:
        return replace(
            before,
            verdict=Verdict.NOT_CONVERGED,
            message=f"Interrupted: the fit with {terms} did not end. The values are the best of the laws as stated.",
        )
    with_them, names = f"With {terms}", fit.segments.system.parameters.names
    if exact.change is not None:
        return _beside_change(
            before, exact.change, dict(zip(names, deviations.tolist(), strict=True)), with_them
        )
    shifted, shift = exact.farthest(fit, deviations)
    if shift <= LARGEST_SHIFT and exact.causes:
        return None
    noise = "hardly more than noise" if exact.causes else "only noise"
    message = f"{before.message} {with_them} {noise} is left"
    if shift <= LARGEST_SHIFT:
        return replace(before, message=f"{message}.")
    added = set(map(_identity, exact.added))
    return replace(
        before,
        message=f"{message}, and {shifted} changes by {shift:.2g} of its standard errors.",
        diagnosis=(*exact.added, *(cause for cause in causes if _identity(cause) not in added)),
    )


def _beside_change(
    before: Judgement, change: Cause, deviations: Mapping[str, float], with_them: str
) -> Judgement | None:
    """The judgement where a coefficient changes in laws with what is missing, by their standard `deviations` in the answer."""
    if change.where not in deviations:  # of a term that was added, which may be of another form
        return None
    if abs(change.size) > NORMAL_95 * deviations[change.where]:
        return with_change(before, change, with_them)
    remark = f"{with_them}, {change.description} would explain most of the rest."
    return replace(before, message=f"{before.message} {remark}")


@dataclass(frozen=True, eq=False)
class _RicherLaws:
    """A `structure` with what was `added` of terms, links and errors of stated values and sensors, and its `fit`.

    Crosstalk was taken out of the `records`.
    """

    added: tuple[Cause, ...]
    structure: Structure
    records: Sequence[Record]
    fit: LikelihoodFit

    @property
    def is_interrupted(self) -> bool:
        return self.fit.status is AnnealingStatus.INTERRUPTED

    @property
    def deviations(self) -> Floats:
        """(p,) standard errors of its own coefficients."""
        return np.sqrt(np.maximum(self.fit.covariance.diagonal(), np.finfo(float).tiny))

    @property
    def leaves_noise(self) -> bool:
        """Whether the laws leave hardly more than noise, in which causes may still be significant."""
        return not self.fit.model_error and not self.fit.chi_square_off

    @cached_property
    def diagnosis(self) -> Diagnosis:
        """What is significant beside them, and all that was tested."""
        names = [parameter.name for parameter in self.structure.parameters]
        values: dict[str, float] = dict(zip(names, map(float, self.fit.values), strict=True))
        channels = self.records[0].channels
        return diagnose(self.fit, self.structure.with_values(values), channels, terms=True)

    @property
    def causes(self) -> tuple[Cause, ...]:
        """What is significant beside them."""
        return self.diagnosis.causes

    @cached_property
    def change(self) -> Cause | None:
        """A change of a coefficient that explains much more than these causes, if there is one."""
        return likeliest_change(self.fit, self.records, self.diagnosis.tested, self.causes)

    def farthest(self, fit: LikelihoodFit, deviations: Floats) -> tuple[str, float]:
        """The coefficient that differs most from those of a fit without what was added, in its `deviations` (p,).

        What is still significant may take back what it would change coefficients by, to first order; all, if that is unknown.
        """
        back = max((cause.shift or np.inf for cause in self.causes), default=0.0) * self.deviations
        names = [parameter.name for parameter in self.structure.parameters]
        numbers = [names.index(name) for name in fit.segments.system.parameters.names]
        changes = np.maximum(np.abs(self.fit.values[numbers] - fit.values) - back[numbers], 0.0)
        shifts = np.where(fit.free, changes / deviations, 0.0)
        number = int(np.argmax(shifts))
        return names[numbers[number]], float(shifts[number])


def _exact_laws(
    first: Cause, fit: LikelihoodFit, structure: Structure, records: Sequence[Record], deviations: Floats
) -> _RicherLaws | None:
    """Laws with a `first` term, and the likeliest causes beside it, that leave hardly more than noise; None if none do.

    Each of causes that are as likely is followed, and that counts which moves a coefficient farthest: trust is not to depend
    on which of them it is. Laws whose fit was interrupted, or beside which a coefficient changes, are the last ones.
    """
    stated = _RicherLaws((), structure, records, fit)
    lacking, latest = [(stated, cause) for cause in _likeliest([first])], [stated]
    while lacking and len(latest[0].added) < _MOST:
        fits = []
        for laws, cause in lacking:
            again = _fitted(laws, cause, laws.deviations if laws.added else deviations)
            if again is not None and again.is_interrupted:
                return again
            if again is not None and again.change is not None:
                return again
            fits += [] if again is None else [again]
        if not fits:
            break
        latest = [laws for laws in fits if laws.leaves_noise and not laws.causes] or fits
        lacking = _lacking(latest)
    enough = [laws for laws in latest if laws.added and laws.leaves_noise]
    return max(enough, key=lambda laws: laws.farthest(fit, deviations)[1], default=None)


def _lacking(latest: Sequence[_RicherLaws]) -> list[tuple[_RicherLaws, Cause]]:
    """What is likeliest beside each of laws that are as likely, in turn, each combination once."""
    beside = [[(laws, cause) for cause in _likeliest(laws.causes)] for laws in latest]
    in_turn = [pair for pairs in zip_longest(*beside) for pair in pairs if pair is not None]
    once: dict[frozenset[tuple[str, ...]], tuple[_RicherLaws, Cause]] = {}
    for laws, cause in in_turn:
        once.setdefault(frozenset(map(_identity, (*laws.added, cause))), (laws, cause))
    return list(once.values())[:_TRIED]


def _likeliest(causes: Sequence[Cause]) -> list[Cause]:
    """The likeliest causes that can be added, that which moves a coefficient farthest first; there are several where they are
    as likely, and none where another cause explains much more.
    """
    can_be_added = [
        cause for cause in causes if _can_be_added(cause) and cause.gain > _ALIKE * causes[0].gain
    ]
    as_likely = [cause for cause in can_be_added if cause.gain > can_be_added[0].gain - _AS_LIKELY]
    return sorted(as_likely, key=lambda cause: -cause.shift)[:_TRIED]


def _can_be_added(cause: Cause) -> bool:
    """Whether laws can have it: a term or a link, a stated value that becomes unknown, or an error of a sensor."""
    if cause.kind in ("term", "link"):
        return cause.term not in MEMORY_TERMS
    return cause.kind in FREED or cause.kind == _CROSSTALK or is_admissible(cause)


def _fitted(before: _RicherLaws, lacking: Cause, deviations: Floats) -> _RicherLaws | None:
    """The fit of laws with what they lack; None where it does not converge, or leaves much more than noise.

    It starts at the values of the laws before, with their deviations (p,), and at the size of what is added. An interrupted
    one is given as it is.
    """
    structure, records, options = before.structure, before.records, before.fit.options
    richer: Structure = structure
    if lacking.kind == _CROSSTALK:
        records = [_without_crosstalk(record, lacking) for record in records]
    elif is_admissible(lacking):
        wider = with_error(options, lacking, records[0])
        if wider is None:
            return None
        options = wider
    else:
        richer = with_cause(structure, lacking)
    names = [parameter.name for parameter in structure.parameters]
    starts = dict(zip(names, zip(before.fit.values, _NEAR * deviations, strict=True), strict=True))
    for parameter in richer.parameters:
        if parameter.name not in starts:
            starts[parameter.name] = _start(parameter.name, lacking, before)
    theta, spread = np.array([starts[parameter.name] for parameter in richer.parameters]).T
    whole = replace(options, nodes=None, relaxation=None, steps=LikelihoodOptions.steps)
    whole = replace(whole, progress=part(options.progress, 1.0, 1.0))  # the search itself is done
    try:
        fit = likelihood_fit(records, richer, theta, spread=spread, options=whole)
    except IdentificationError:  # its motion may run to infinity
        return None
    laws = _RicherLaws((*before.added, lacking), richer, records, fit)
    converged = fit.status is AnnealingStatus.CONVERGED and fit.has_errors and fit.chi_square < _LEFT
    return laws if converged or laws.is_interrupted else None


def _start(name: str, lacking: Cause, laws: _RicherLaws) -> tuple[float, float]:
    """The value that an unknown starts at where laws get what they lack, and its standard deviation there."""
    if lacking.kind in FREED:
        stated = laws.structure.coefficient(name).value or 0.0
        return stated * (1.0 + lacking.size), abs(stated * lacking.size)
    size = lacking.size * _of_one_newton(lacking, laws)
    return size, abs(size)


def _without_crosstalk(record: Record, crosstalk: Cause) -> Record:
    """The record without the part of one channel that another one shows as well."""
    values = record.values.copy()
    own, source = (record.channels.index(name) for name in (crosstalk.where, crosstalk.source))
    values[:, own] -= crosstalk.size * values[:, source]
    return replace(record, values=values, simulated=None)


def _identity(cause: Cause) -> tuple[str, str, str, str]:
    """What a cause is, whatever it gains."""
    return cause.kind, cause.where, cause.term, cause.source


def _in_words(added: Cause) -> str:
    if added.is_instrument:
        return added.description
    return f"{added.term} in {'a link ' if added.kind == 'link' else ''}{added.where}"


def _of_one_newton(lacking: Cause, laws: _RicherLaws) -> float:
    """The coefficient of a term whose force along the fitted motion has a root mean square of 1 in its unit."""
    structure, optimum = laws.structure, laws.fit.optimum
    ends = ends_of(structure, lacking) if lacking.kind == "link" else structure.link(lacking.where).between
    first, second = (structure.topology.index[end] for end in ends)
    force = CandidateForce(first, second, Law.parse(lacking.term))
    return float(candidate_forces(optimum, laws.fit.misfit, [force])[1][0])
