"""From a selection of terms to the discovery: its estimate, the evidence for each term, and why it may not be trusted."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.evidence import (
    DroppedTerms,
    dropped_terms_remark,
    exchange_remarks,
    opposed_damping,
    path_parabolas,
    runners_up,
    selection_path,
    term_evidence,
    unit_shares,
    widened,
)
from linkwise.discovery.inexact import free_run_remarks, larger_model_remarks, simplest_model_remarks
from linkwise.discovery.model_average import MemoryEvidence, PathPoint, model_average
from linkwise.discovery.prediction import terms_without_gain
from linkwise.discovery.result import Discovery, TermEvidence
from linkwise.discovery.rivals import (
    RivalError,
    RivalForm,
    allowing_for,
    link_exchange_remarks,
    link_exchanges,
    origin_remarks,
    rival_errors,
    rival_form_remarks,
    rival_forms,
    rival_offsets,
    rival_remarks,
    unknown_origins,
)
from linkwise.discovery.screened_records import DataChecks, ScreenedRecords
from linkwise.discovery.selection import Selection
from linkwise.discovery.term_parameters import without_values
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.likelihood.estimate import estimate_of
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.records.record import Record
from linkwise.verdict import Verdict, admit_intervals

_INTEGRATED = (
    "Some displacements were integrated from velocities or accelerations, without their constants, and the laws leave more "
    "than noise: links or terms may be false. Measure displacements, or offer more terms."
)
_INEXACT = (
    "No selection of the terms that were offered leaves only noise, so those found may stand in for others: offer more terms, "
    "and check the units and the zeros of the channels, and the masses."
)
_STATED_WRONG = (
    "The laws explain the record to within its noise, and an error of what was stated would do so with fewer terms: no "
    "interval is given. Check the stated value that the findings name, or let it be unknown."
)
_OFF_ZERO = (
    "A zero offset of a sensor would explain the record with fewer terms than were found: no interval is given. Check the "
    "zero of the channel that the findings name, or let its offset be estimated."
)
_NO_VALUES = (
    "No fit found the parameters of {}, which have numbers of a grid: what was found beside them may be false. Offer fewer "
    "terms, or terms with numbers."
)
_OPPOSED = (
    "Of the terms of damping in {} one gives energy that another takes: together they stand in for a form of damping that was "
    "not offered, such as v*abs(v). Offer more forms, or fewer of these."
)
_STAND_INS = (
    "A form of force that was not offered explains the record better than terms that stand in for it."
)
_MEMORY_IN_DOUBT = (
    "Whether {} has memory is in doubt: memory in another link, or a common function of d and v, explains the records "
    "nearly as well. "
    "Offer more terms, record with less noise or for longer, or drive the link over a wider range."
)
_UNSETTLED = "The search for the structure did not settle: this is the best structure it visited."


def judged_discovery(
    records: Sequence[Record],
    checks: DataChecks,
    screened: ScreenedRecords,
    selection: Selection,
    delays: Mapping[str, float] | None = None,
    memory: Sequence[MemoryEvidence] = (),
    frequencies: Sequence[RivalError] = (),
) -> Discovery:
    """The estimate of the selected structure and the evidence for it, for `memory` of a link, too.

    `delays` in s were found by channel; `frequencies` of hosts explain the records in place of links.
    """
    fit, candidates = selection.fit, screened.candidates
    estimate = estimate_of(selection.structure, fit, records, delays, offered=candidates.full_structure)
    dropped = DroppedTerms.of(selection.quadratic, selection.penalty, len(estimate.parameters))
    alone, estimate = _errors(estimate), widened(estimate, dropped.covariance)
    told, names = admit_intervals(estimate.verdicts), selection.quadratic.names
    tested = (firm := told and selection.settled) and not fit.random_forces
    rivals = (*frequencies, *rival_errors(selection, estimate.structure)) if tested else ()
    offsets = rival_offsets(selection, candidates, records[0].channels) if tested else ()
    forms = rival_forms(selection, candidates) if tested else ()
    moved = link_exchanges(selection, candidates) if tested or (told and candidates.hosts) else ()
    estimate = allowing_for(_beside_rivals(estimate, rivals, offsets), forms)
    parabolas = path_parabolas(selection, candidates)
    needless = terms_without_gain(selection, parabolas, estimate.model_error)
    origins = unknown_origins(estimate, records, selection, candidates) if screened.integrated else ()
    others: tuple[_Rival, ...] = (*rivals, *offsets, *moved, *forms, *origins, *needless)
    memory = tuple(replace(law, unambiguous=law.unambiguous and told) for law in memory)
    search = [*_doubts_of_search(screened, selection, estimate, forms), *_doubts_of_memory(memory)]
    trusted = admit_intervals(verdicts := (*estimate.verdicts, *(verdict for verdict, _ in search)))
    path = selection_path(selection, parabolas)
    discovery = Discovery(
        estimate=estimate,
        terms=_evidence(
            selection,
            candidates,
            checks,
            estimate,
            trusted=trusted,
            replaceable=_replaceable(selection, estimate, alone, others),
        ),
        path=path,
        runners_up=runners_up(selection),
        average=model_average(selection, candidates, alone),
        remarks=(
            *(remark for _, remark in search),
            *rival_form_remarks(forms, selection),
            *_of_choice(selection, path),
            *(term.remark(names) for term in needless),
            *rival_remarks((*rivals, *offsets), names),
            *link_exchange_remarks(moved),
            *origin_remarks(origins),
            *checks.remarks,
            *screened.remarks,
            *(exchange_remarks(selection) if firm else ()),
        ),
        verdicts=verdicts,
        rounds=selection.rounds,
        seconds=estimate.seconds,
        memory=memory,
        untested=screened.untested,
    )
    return _with_doubts(discovery, dropped, alone, fit) if trusted else discovery


def _of_choice(selection: Selection, path: Sequence[PathPoint]) -> tuple[str, ...]:
    """Sentences on why beside a model error these terms were selected, and neither fewer nor more of them."""
    return (
        *free_run_remarks(selection),
        *simplest_model_remarks(selection),
        *larger_model_remarks(path, inexact=selection.fit.model_error > 0.0),
    )


def _evidence(
    selection: Selection,
    candidates: Candidates,
    checks: DataChecks,
    estimate: Estimate,
    *,
    trusted: bool,
    replaceable: Collection[int],
) -> tuple[TermEvidence, ...]:
    """The evidence for every candidate, beside the `estimate`; terms that are `replaceable` are given by number."""
    return term_evidence(
        selection,
        candidates,
        trusted=trusted,
        collinear=checks.collinear,
        in_proportion=checks.in_proportion,
        replaceable=replaceable,
        shares=unit_shares(selection, candidates) if trusted else {},
        added=np.asarray(estimate.for_dropped_terms).diagonal(),
    )


def _beside_rivals(
    estimate: Estimate, errors: Sequence[RivalError], offsets: Sequence[RivalError]
) -> Estimate:
    """The estimate, without intervals where errors of stated values, or offsets of sensors, explain more than its terms."""
    for rivals, message in ((errors, _STATED_WRONG), (offsets, _OFF_ZERO)):
        if any(rival.is_preferred for rival in rivals):
            return replace(estimate, fit_verdicts=(Verdict.MEASUREMENT_ERROR,), message=message)
    return estimate


class _Rival(Protocol):
    """What may be there in place of some terms, by number."""

    @property
    def terms(self) -> tuple[int, ...]: ...


def _replaceable(
    selection: Selection, estimate: Estimate, alone: Floats, rivals: Sequence[_Rival]
) -> set[int]:
    """The numbers of the terms that something else, or nothing, may replace; `alone` (p,) are errors beside the terms kept."""
    absent = _held_at_zero(estimate.values, alone if selection.is_exact else _errors(estimate))
    return {*absent, *(term for rival in rivals for term in rival.terms)}


def _held_at_zero(values: Floats, errors: Floats) -> list[int]:
    """The coefficients, by number, whose intervals hold zero: blocks of the records, or missing terms, say more than chance.

    The criterion may keep such a term beside a model error, or where residuals hint at another one; it is not certain.
    """
    return np.flatnonzero(np.abs(values) <= NORMAL_95 * errors).tolist()


def _errors(estimate: Estimate) -> Floats:
    """(p,) the standard errors of all coefficients."""
    return np.asarray(np.sqrt(np.maximum(np.asarray(estimate.covariance).diagonal(), 0.0)))


def _doubts_of_search(
    screened: ScreenedRecords, selection: Selection, estimate: Estimate, forms: Sequence[RivalForm]
) -> list[tuple[Verdict, str]]:
    """The verdicts that forbid trust in a search, each with a sentence."""
    valueless = without_values(screened.candidates, selection)
    opposed = opposed_damping(selection, screened.candidates)
    inexact = not (selection.is_exact and admit_intervals(estimate.verdicts))
    search = [
        (bool(opposed), Verdict.TERMS_MAY_BE_MISSING, _OPPOSED.format(" and ".join(opposed))),
        (
            selection.is_exact and any(form.is_better for form in forms),
            Verdict.TERMS_MAY_BE_MISSING,
            _STAND_INS,
        ),
        (bool(valueless), Verdict.TERMS_MAY_BE_MISSING, _NO_VALUES.format(" and ".join(valueless))),
        (
            not selection.is_exact and not admit_intervals(estimate.verdicts),
            Verdict.TERMS_MAY_BE_MISSING,
            _INEXACT,
        ),
        (screened.integrated and inexact, Verdict.DISPLACEMENTS_INTEGRATED, _INTEGRATED),
        (not selection.settled, Verdict.SEARCH_UNSETTLED, _UNSETTLED),
    ]
    return [(verdict, remark) for applies, verdict, remark in search if applies]


def _doubts_of_memory(memory: Sequence[MemoryEvidence]) -> list[tuple[Verdict, str]]:
    """The verdict on memory that is not certain, with a sentence."""
    return [
        (Verdict.LINKS_IN_DOUBT, _MEMORY_IN_DOUBT.format(law.link))
        for law in memory
        if law.kept and law.unambiguous and not law.certain
    ]


def _with_doubts(discovery: Discovery, dropped: DroppedTerms, alone: Floats, fit: LikelihoodFit) -> Discovery:
    """A trusted discovery without intervals of links in doubt; not trusted if no link is certain.

    Nor is it where some are in doubt and the `fit` has coloured noise of a sensor: white noise was refused, and what wrong
    links leave follows the motion as such noise may. `alone` (p,) are the standard errors beside the terms kept alone.
    """
    estimate = replace(discovery.estimate, links_in_doubt=frozenset(discovery.in_doubt))
    remarks = (*discovery.remarks, *dropped_terms_remark(dropped, estimate, alone))
    described = replace(discovery, estimate=estimate, remarks=remarks)
    if len(described.in_doubt) < len(described.structure.links) and (
        fit.optimum.coloured is None or not described.in_doubt
    ):
        return described
    return replace(
        described,
        verdicts=(*described.verdicts, Verdict.LINKS_IN_DOUBT),
        terms=tuple(replace(term, unambiguous=False) for term in described.terms),
    )
