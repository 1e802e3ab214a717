"""Memory as a term: which link, if any, has states of its own, and by which named law.

Where no selection of functions of d and v leaves only noise, or laws with memory were offered, the links that the screen shows
and those stated are offered these laws one at a time. Rough starting values on a piece of the record rank links and laws. The
best law of the best links is fitted, then the other laws of the link that leaves least, and this link without memory, with
usual forms of d and v in its place: their criteria are the evidence. A fit that stops at a ceiling gives a bound, since the
cost only rises as the flow is tightened. From the best fit terms and links are selected as without memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.criterion import Penalty
from linkwise.discovery.result import MemoryEvidence
from linkwise.discovery.rivals import link_rates
from linkwise.discovery.screened_records import ScreenedRecords
from linkwise.discovery.selection import (
    Selection,
    TermSearch,
    cost_of,
    leaves_only_noise,
    select_structure,
)
from linkwise.discovery.terms import USUAL
from linkwise.errors import IdentificationError
from linkwise.estimates.causes import Cause
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.optima.restarts import fit_from_starts
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.likelihood.starts.memory import Start, host_memory_starts, memory_starts, rough_memory_start
from linkwise.likelihood.starts.values import starting_values
from linkwise.likelihood.terms import Delay, of_kind
from linkwise.likelihood.tests.score_test import MEMORY_TERMS
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.runtime import one_blas_thread
from linkwise.signals.base_frame import framed_records

_YIELDS = 0.3  # of the deviation of the elongation, where a slider yields
# root mean square of a state over that of a sign, and over that of the elongation
_OF_SLIDER, _OF_RELAXING = 0.8, 0.7
_LINKS = 4  # of the ranked ones that are fitted
# chi-square and steps at which a fit ends: half more than noise, or nearly, is evidence enough
_CEILING, _STEPS = 1.5, 25
_STEPS_BESIDE_HOSTS = 75  # as starts follow from smoothed forces, which may be far off
_NEAR = 1.5  # times the least misfit of rough starts up to which starts are refined
_ALIKE = 10.0  # of -2 log likelihood: laws nearer than that explain the records as well
_LINEAR = ("d", "v")
_FORMS = ("d*abs(d)", "d**2", "d**3", "d**5", "v*abs(v)")
# of the root mean square rate of a link: where friction in place of memory saturates
_SATURATING, _SHARPEST = 0.1, 1e-3


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """A named law with memory on the link of a pair, by number, among the `chosen` terms, and its fit once it has one.

    `memory` names the coefficients of the law, `valleys` are starting values.
    """

    pair: int
    law: str
    search: TermSearch
    chosen: frozenset[str]
    structure: Structure
    memory: tuple[str, ...]
    valleys: tuple[Start, ...] = ()
    fit: LikelihoodFit | None = None

    @property
    def misfit(self) -> float:
        """The part of the forces that the best starting values leave; infinite where there are none."""
        return min((valley.misfit for valley in self.valleys), default=np.inf)

    @classmethod
    def of(cls, search: TermSearch, chosen: frozenset[str], pair: int, law: str) -> _Hypothesis:
        candidates = search.candidates.with_memory(pair, law)
        known = frozenset(candidates.by_name)
        own = replace(search, candidates=candidates, tested=search.tested & known)
        structure = candidates.structure(chosen & known)
        plain = {parameter.name for parameter in search.candidates.structure(chosen).parameters}
        memory = tuple(p.name for p in structure.parameters if p.name not in plain)
        return cls(pair, law, own, chosen & known, structure, memory)

    def started(self, records: Sequence[Record]) -> _Hypothesis:
        """With rough starting values, or with all that smoothed forces give beside hosts; as it is where there are none."""
        with suppress(IdentificationError):
            if self.structure.hosts:
                return replace(self, valleys=host_memory_starts(records, self.structure, {}))
            return replace(self, valleys=(rough_memory_start(records, self.structure),))
        return self

    def fitted(self, records: Sequence[Record], limit: float = -np.inf) -> _Hypothesis:
        """With the fit from its starting values; from the best ones on whole records where these leave less than a `limit`.

        Without one where the motion runs away from there.
        """
        own = self
        if self.misfit <= limit and not self.structure.hosts:
            with suppress(IdentificationError):
                own = replace(self, valleys=memory_starts(records, self.structure, {})[:1])
        return replace(own, fit=own._fit())

    def _fit(self) -> LikelihoodFit | None:
        steps = _STEPS_BESIDE_HOSTS if self.structure.hosts else _STEPS

        def search(*, theta: Floats) -> LikelihoodFit:
            started = self.search.starting_at(self.structure, theta)
            return started.first_fit(self.structure, ceiling=_CEILING, steps=steps)

        try:
            return fit_from_starts(search, self.valleys)
        except (IdentificationError, np.linalg.LinAlgError):
            return None

    @property
    def rank(self) -> tuple[bool, bool, float]:
        """Fits that leave only noise first, then others that converged, then those that leave least."""
        if self.fit is None:
            return True, True, np.inf
        return not self.is_exact, self.fit.status is not AnnealingStatus.CONVERGED, self.fit.chi_square

    @property
    def is_exact(self) -> bool:
        """Whether the laws leave no more than noise."""
        return self.fit is not None and leaves_only_noise(self.fit)

    def criterion(self, noise: Floats, penalty: Penalty) -> float:
        """At a `noise` (C,), or about the bound of it; infinite without a fit.

        A fit that ended early has free states that follow the noise, which chi-square counts and the cost does not.
        """
        if self.fit is None:
            return np.inf
        least = 0.0 if self.is_exact else self.fit.chi_square * self.fit.samples
        return _criterion(self.structure, self.fit, noise, penalty, least)

    def selected(self) -> Selection | None:
        """The subset of terms and links that no candidate improves, searched from the fit; None where it did not converge."""
        if self.fit is None or self.fit.status is not AnnealingStatus.CONVERGED:
            return None
        search = self.search.starting_at(self.structure, self.fit.values)
        search = replace(search, sensors=replace(search.sensors, nodes=self.fit.optimum.point.nodes))
        try:
            return select_structure(search, self.chosen)
        except IdentificationError:
            return None


def _criterion(
    structure: Structure, fit: LikelihoodFit, noise: Floats, penalty: Penalty, least: float = 0.0
) -> float:
    """Cost, at `least` some, plus penalty, where coefficients of laws with memory cost as terms do."""
    size = penalty.term * len(structure.parameters) + penalty.link * len(structure.links)
    return max(cost_of(fit, noise), least) + size


def select_memory(
    search: TermSearch,
    screened: ScreenedRecords,
    selection: Selection,
    cause: Cause | None = None,
) -> tuple[Selection, tuple[MemoryEvidence, ...]] | None:
    """The selection with memory in a link, where it leaves only noise at a lower criterion, and the evidence for it.

    `selection` is the best without memory, and `cause` explains most of what it leaves. Where no law was offered, usual ones
    are tried, if masses are known, else starts run far and fits long, and if all displacements were measured.
    """
    candidates = search.candidates
    scaled = all(mass.mass.known for mass in candidates.masses) and not candidates.hosts
    late = of_kind(search.sensors.errors, Delay)
    laws = candidates.memory or (USUAL if scaled and not (screened.integrated or late) else ())
    if selection.interrupted:
        return None
    records = framed_records(search.records, candidates.full_structure)
    ranked = _ranked(search, screened, laws, records)
    if not ranked:
        return None
    limit = _NEAR * ranked[0].misfit
    with one_blas_thread():
        fits = [own.fitted(records) for own in _suspected(search, selection, laws, cause)]
        settled = {fitted.pair for fitted in fits if fitted.is_exact}
        fits = [fitted for fitted in fits if fitted.pair in settled]
        firsts = {hypothesis.pair: hypothesis for hypothesis in reversed(ranked)}  # the best law of each link
        best_links = [rest for rest in ranked if rest is firsts[rest.pair]][:_LINKS]
        some = [hypothesis for hypothesis in best_links if hypothesis.pair not in settled]
        fits += [hypothesis.fitted(records, limit) for hypothesis in some]
        first = min(fits, key=lambda fitted: fitted.rank)
        if first.pair not in settled:
            others = [rest for rest in ranked if rest.pair == first.pair and rest.law != first.law]
            fits += [hypothesis.fitted(records, limit) for hypothesis in others]
    best = min(fits, key=lambda fitted: fitted.rank)
    chosen = best.selected()
    if chosen is None or not chosen.is_exact:
        return None
    evidence = _evidence(best, chosen, fits, selection, search)
    return (chosen, evidence) if evidence[0].over_none > 0.0 else None


def no_memory_remark(laws: Sequence[str]) -> str:
    """A sentence on laws that were offered, of which none was found."""
    return f"With {' or '.join(laws)} in one link the records are not explained better: no memory was found."


def _ranked(
    search: TermSearch, screened: ScreenedRecords, laws: Sequence[str], records: Sequence[Record]
) -> list[_Hypothesis]:
    """Every law on every link that the screen shows, those with the least misfit first."""
    by_name = search.candidates.by_name
    pairs = {by_name[name].pair for name in screened.first} | search.candidates.stated_pairs
    names = {name for name, entry in by_name.items() if entry.pair in pairs}
    linear = {name for name in names if by_name[name].term.text in _LINEAR}
    chosen = frozenset(linear | (names & screened.first))
    try:
        every = [_Hypothesis.of(search, chosen, pair, law) for pair in sorted(pairs) for law in laws]
    except IdentificationError:  # a mass without a link
        return []
    with one_blas_thread():
        ranked = [hypothesis.started(records) for hypothesis in every]
    started = (hypothesis for hypothesis in ranked if np.isfinite(hypothesis.misfit))
    return sorted(started, key=lambda hypothesis: hypothesis.misfit)


def _suspected(
    search: TermSearch, selection: Selection, laws: Sequence[str], cause: Cause | None
) -> list[_Hypothesis]:
    """The laws on the link in which memory would explain most of what a selection leaves, with values from both.

    Those of the part with memory follow from the size of the force in N that the `cause` says, and how far the link moves.
    """
    motions = selection.link_motions()
    if cause is None or cause.term not in MEMORY_TERMS or cause.where not in motions:
        return []
    elongation, rate = (float(np.std(motion)) for motion in motions[cause.where])
    if not min(elongation, rate) > 0.0:
        return []
    slip, reach = abs(cause.size) / _OF_SLIDER, _YIELDS * elongation  # where a slider yields
    branch = abs(cause.size) / (_OF_RELAXING * elongation)  # the stiffness of a spring that relaxes
    starts = {
        "bouc-wen": {"F": slip, "x0": reach, "s": 0.5},
        "dahl": {"Fc": slip, "sigma": slip / reach},
        "zener": {"k1": branch, "c1": branch * elongation / rate},
    }
    names = [parameter.name for parameter in selection.structure.parameters]
    fitted = dict(zip(names, selection.fit.values.tolist(), strict=True))
    hypotheses = []
    for pair, given in enumerate(search.candidates.pairs):
        if cause.where in (given.name, *(link.name for link in given.stated)):
            for law in laws:
                own = _Hypothesis.of(search, selection.chosen, pair, law)
                values = fitted | {f"{cause.where}.{key}": v for key, v in starts.get(law, {}).items()}
                if all(parameter.name in values for parameter in own.structure.parameters):
                    start = np.array([values[parameter.name] for parameter in own.structure.parameters])
                    hypotheses.append(replace(own, valleys=(Start(start, 0.0),)))
    return hypotheses


def _evidence(
    own: _Hypothesis, chosen: Selection, fits: Sequence[_Hypothesis], selection: Selection, search: TermSearch
) -> tuple[MemoryEvidence, ...]:
    """The evidence for the best hypothesis, and for other laws on its link that explain the records as well.

    A fit that did not leave its start says nothing of a law.
    """
    noise, penalty = chosen.noise, chosen.quadratic.penalty
    compared = own.criterion(noise, penalty)
    excess = {fitted: fitted.criterion(noise, penalty) - compared for fitted in fits}
    others = [value for fitted, value in excess.items() if fitted.pair != own.pair]
    rest = [fitted for fitted in fits if fitted.pair == own.pair and fitted.law != own.law]
    left = [rival for rival in rest if rival.fit and rival.fit.status is not AnnealingStatus.STUCK]
    laws = {fitted.law: excess[fitted] for fitted in left}
    none = [_criterion(selection.structure, selection.fit, noise, penalty)]
    for rival in _in_place_of_memory(search.candidates, own.pair, chosen):
        fit = _fit_without_memory(own, rival, chosen, search)
        if fit is not None:
            none.append(_criterion(chosen.structure, fit, noise, penalty))
    link = own.search.candidates.pairs[own.pair]
    evidence = MemoryEvidence(
        link=link.name,
        between=link.between,
        law=own.law,
        kept=True,
        coefficients=own.memory,
        over_links=min(others, default=np.inf),
        over_laws=min(laws.values(), default=np.inf),
        over_none=min(none) - _criterion(chosen.structure, chosen.fit, noise, penalty),
        unambiguous=chosen.settled,
    )
    exact = {fitted.law for fitted in fits if fitted.is_exact}
    as_well = {law: value for law, value in laws.items() if law in exact and value < _ALIKE}
    not_kept = replace(evidence, kept=False, coefficients=())
    return (evidence, *(replace(not_kept, law=law, over_laws=-value) for law, value in as_well.items()))


def _in_place_of_memory(candidates: Candidates, number: int, chosen: Selection) -> Iterator[Link]:
    """A link with usual forms of d and v that were not offered, and one with friction that saturates at an unknown rate."""
    pair, offered = candidates.pairs[number], {term.text for term in candidates.terms}
    summands = {f"g{k}": form for k, form in enumerate(_FORMS) if form not in offered}
    forms = Law.parse(" + ".join(f"{name}*({form})" for name, form in summands.items()) or "0")
    yield Link(pair.name, pair.between, forms, dict.fromkeys(summands, Coefficient.unknown()))
    rate = link_rates(chosen)[pair.name]
    saturating = Coefficient.unknown(_SATURATING * rate, lower=_SHARPEST * rate, upper=rate)
    friction = {"g": Coefficient.unknown(), "v_g": saturating}
    yield Link(pair.name, pair.between, Law.parse("g*tanh(v/v_g)"), friction)


def _fit_without_memory(
    own: _Hypothesis, rival: Link, chosen: Selection, search: TermSearch
) -> LikelihoodFit | None:
    """A fit of the structure chosen with the law of `rival` in place of memory; None where it fails."""
    candidates = search.candidates.with_link(own.pair, rival)
    linear = {e.name for e in candidates.entries if e.pair == own.pair and e.term.text in _LINEAR}
    structure = candidates.structure((chosen.chosen & candidates.by_name.keys()) | linear)
    try:
        start = starting_values(search.records, structure)
        return replace(search, start=lambda _: start).first_fit(structure)
    except (IdentificationError, np.linalg.LinAlgError):
        return None
