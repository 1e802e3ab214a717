"""From a selection of terms to the discovery: its estimate, the evidence for each term, and why it may not be trusted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.data_checks import DataChecks
from linkwise.discovery.evidence import (
    DroppedTerms,
    dropped_terms_remark,
    opposed_damping,
    runners_up,
    selection_path,
    term_evidence,
    widened,
)
from linkwise.discovery.inexact import choice_remarks
from linkwise.discovery.model_average import model_average
from linkwise.discovery.result import Discovery, MemoryEvidence
from linkwise.discovery.rivals import (
    Rival,
    rival_errors,
    rival_forms,
    rival_links,
    rival_origins,
    rival_remarks,
    rival_terms,
)
from linkwise.discovery.screened_records import ScreenedRecords
from linkwise.discovery.selection import Selection
from linkwise.discovery.term_parameters import without_values
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.likelihood.estimate import estimate_of
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.options import OF_FORCE, is_admissible
from linkwise.records.record import Record
from linkwise.verdict import Verdict, admit_intervals

_NOT_TESTED = (
    "With random forces it is not tested whether terms stand in for a form that was not offered, or for an error of what "
    "was stated."
)


def judged_discovery(
    checks: DataChecks,
    screened: ScreenedRecords,
    selection: Selection,
    records: Sequence[Record],
    memory: Sequence[MemoryEvidence] = (),
    frequencies: Sequence[Rival] = (),
) -> Discovery:
    """The estimate of the selected structure and the evidence for it, for `memory` of a link, too.

    `frequencies` of hosts explain the records in place of links.
    """
    fit, offered = selection.fit, selection.candidates.full_structure
    estimate = estimate_of(selection.structure, fit, records, offered=offered)
    dropped = DroppedTerms.of(selection.quadratic, len(estimate.parameters))
    alone, estimate = _errors(estimate), widened(estimate, dropped.covariance)
    told = admit_intervals(estimate.verdicts)
    rivals = _rivals_beside(selection, estimate, records, frequencies) if told else ()
    for message in [rival.untrusted for rival in rivals if rival.untrusted][:1]:
        estimate = replace(estimate, fit_verdicts=(Verdict.MEASUREMENT_ERROR,), message=message)
    moves = [rival.moved for rival in rivals if rival.moved is not None]
    for moved in moves:
        estimate = widened(estimate, np.outer(moved, moved))
    path = selection_path(selection)
    rivals += rival_origins(selection, estimate, records) if screened.integrated else ()
    memory = tuple(replace(law, unambiguous=law.unambiguous and told) for law in memory)
    doubts = [*_doubts(screened, selection, estimate, bool(moves), memory)]
    verdicts = (*estimate.verdicts, *(verdict for verdict, _ in doubts))
    trusted = admit_intervals(verdicts)
    # beside a model error, or where residuals hint at another term, the criterion may keep one whose interval holds zero
    absent = np.abs(estimate.values) <= NORMAL_95 * (alone if selection.is_exact else _errors(estimate))
    discovery = Discovery(
        estimate=estimate,
        terms=term_evidence(
            selection,
            np.asarray(estimate.for_dropped_terms).diagonal(),
            trusted=trusted,
            checks=checks,
            replaceable={*np.flatnonzero(absent).tolist(), *(k for rival in rivals for k in rival.terms)},
        ),
        path=path,
        runners_up=runners_up(selection),
        average=model_average(selection, alone),
        remarks=(
            *(remark for _, remark in doubts),
            *(() if told else _advice(estimate)),
            *((_NOT_TESTED,) if fit.random_forces else ()),
            *choice_remarks(selection, path),
            *rival_remarks(rivals),
            *checks.remarks,
            *screened.remarks,
        ),
        verdicts=verdicts,
        rounds=selection.rounds,
        seconds=estimate.seconds,
        memory=memory,
        untested=tuple(e.name for e in screened.candidates.entries if e.name not in screened.tested),
    )
    return _with_doubts(discovery, dropped, alone, fit) if trusted else discovery


def _advice(estimate: Estimate) -> Iterator[str]:
    """How the error of a sensor or a force that the diagnosis names first is found with the structure."""
    for cause in estimate.diagnosis[:1]:
        kind = cause.kind.removeprefix(OF_FORCE)
        if is_admissible(cause):
            yield (
                f"Links or terms may stand in for the {kind} of {cause.where}: look for it with the structure, by "
                f'--let "{kind}" on the command line or admit="{kind}" in Python.'
            )


def _rivals_beside(
    selection: Selection, estimate: Estimate, records: Sequence[Record], frequencies: Sequence[Rival]
) -> tuple[Rival, ...]:
    """The rivals of a selection; beside random forces, and where it did not settle, other links of hosts alone."""
    terms = rival_terms(selection) if selection.settled else ()
    if selection.settled and not selection.fit.random_forces:
        errors = rival_errors(selection, estimate.structure, records[0].channels)
        return (*frequencies, *errors, *rival_links(selection), *rival_forms(selection), *terms)
    return (*(rival_links(selection) if selection.candidates.hosts else ()), *terms)


def _errors(estimate: Estimate) -> Floats:
    """(p,) the standard errors of all coefficients."""
    return np.asarray(np.sqrt(np.maximum(estimate.covariance.diagonal(), 0.0)))


def _doubts(
    screened: ScreenedRecords,
    selection: Selection,
    estimate: Estimate,
    moved: bool,
    memory: Sequence[MemoryEvidence],
) -> Iterator[tuple[Verdict, str]]:
    """The verdicts that forbid trust in a search, or in memory that it found, each with a sentence.

    Terms are `moved` where a form that was not offered would change them.
    """
    sound, exact = admit_intervals(estimate.verdicts), selection.is_exact
    if opposed := opposed_damping(selection):
        yield (
            Verdict.TERMS_MAY_BE_MISSING,
            f"Of the terms of damping in {' and '.join(opposed)} one gives energy that another takes: together they stand in "
            "for a form of damping that was not offered, such as v*abs(v). Offer more forms, or fewer of these.",
        )
    if exact and moved:
        yield (
            Verdict.TERMS_MAY_BE_MISSING,
            "A form of force that was not offered explains the record better than terms that stand in for it.",
        )
    if valueless := without_values(selection):
        yield (
            Verdict.TERMS_MAY_BE_MISSING,
            f"No fit found the parameters of {' and '.join(valueless)}, which have numbers of a grid: what was found beside "
            "them may be false. Offer fewer terms, or terms with numbers.",
        )
    if not exact and not sound:
        yield (
            Verdict.TERMS_MAY_BE_MISSING,
            "No selection of the terms that were offered leaves only noise, so those found may stand in for others: offer "
            "more terms, and check the units and the zeros of the channels, and the masses.",
        )
    if screened.integrated and not (exact and sound):
        yield (
            Verdict.DISPLACEMENTS_INTEGRATED,
            "Some displacements were integrated from velocities or accelerations, without their constants, and the laws leave "
            "more than noise: links or terms may be false. Measure displacements, or offer more terms.",
        )
    if not selection.settled:
        yield (
            Verdict.SEARCH_UNSETTLED,
            "The search for the structure did not settle: this is the best structure it visited.",
        )
    for law in memory:
        if law.kept and law.unambiguous and not law.certain:
            yield (
                Verdict.LINKS_IN_DOUBT,
                f"Whether {law.link} has memory is in doubt: memory in another link, or a common function of d and v, "
                "explains the records nearly as well. Offer more terms, record with less noise or for longer, or drive the "
                "link over a wider range.",
            )


def _with_doubts(discovery: Discovery, dropped: DroppedTerms, alone: Floats, fit: LikelihoodFit) -> Discovery:
    """A trusted discovery without intervals of links in doubt; not trusted if no link is certain.

    Nor is it where some are in doubt and the `fit` has coloured noise of a sensor: white noise was refused, and what wrong
    links leave follows the motion as such noise may. `alone` (p,) are the standard errors beside the terms kept alone.
    """
    estimate = replace(discovery.estimate, links_in_doubt=frozenset(discovery.in_doubt))
    remarks = (*discovery.remarks, *dropped_terms_remark(dropped, estimate, alone))
    described = replace(discovery, estimate=estimate, remarks=remarks)
    some = len(described.in_doubt) < len(described.structure.links)
    if not described.in_doubt or (some and fit.optimum.coloured is None):
        return described
    return replace(
        described,
        verdicts=(*described.verdicts, Verdict.LINKS_IN_DOUBT),
        terms=tuple(replace(term, unambiguous=False) for term in described.terms),
    )
