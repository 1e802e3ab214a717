"""From a record and the masses to the structure: who is linked to whom, and by which law."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Unpack

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates, candidates_for
from linkwise.discovery.coloured_noise import select_coloured
from linkwise.discovery.data_checks import DataChecks, check_data
from linkwise.discovery.dropped_terms import DroppedTerms, dropped_terms_remark, widened
from linkwise.discovery.evidence import (
    exchange_remarks,
    opposed_damping,
    runners_up,
    selection_path,
    term_evidence,
)
from linkwise.discovery.inexact_laws import select_inexact
from linkwise.discovery.link_exchanges import link_exchange_remarks, link_exchanges
from linkwise.discovery.options import DiscoveryKeywords, DiscoveryOptions
from linkwise.discovery.power import unit_shares
from linkwise.discovery.random_forces import select_with_random_forces
from linkwise.discovery.result import Discovery
from linkwise.discovery.rival_errors import rival_errors, rival_remarks
from linkwise.discovery.rival_forms import RivalForm, allowing_for, rival_form_remarks, rival_forms
from linkwise.discovery.screened_records import ScreenedRecords, weak_values
from linkwise.discovery.selection import Selection, TermSearch
from linkwise.discovery.term_parameters import select_with_parameters, without_values
from linkwise.estimates.estimate import Estimate
from linkwise.likelihood.estimate import estimate_of
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.random_forces import random_forces, refuse_beside_random_forces
from linkwise.likelihood.sensor_priors import errors_to_find
from linkwise.likelihood.sensor_unknowns import answer_with_sensors
from linkwise.likelihood.shooting.anneal import AnnealingStatus
from linkwise.likelihood.starts.values import starting_values
from linkwise.model.structure import Structure
from linkwise.model.toml_file import PartialStructure
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.records.channel import BASE, Channel, of_links
from linkwise.records.record import Record
from linkwise.records.repetition import joined_notes
from linkwise.runtime import one_blas_thread
from linkwise.signals.base_frame import framed_records
from linkwise.verdict import Verdict, is_trusted

_SCREENED = 0.1  # of the progress, when the screen is done
_INTEGRATED = (
    "Some displacements were integrated from velocities or accelerations, without their constants: links or terms may be "
    "false. Measure displacements, or check the structure with identify on a second record."
)
_INEXACT = (
    "No selection of the terms that were offered leaves only noise, so those found may stand in for others: offer more terms, "
    "and check the units and the zeros of the channels, and the masses."
)
_STATED_WRONG = (
    "The laws explain the record to within its noise, and an error of what was stated would do so with fewer terms: no "
    "interval is given. Check the stated value that the findings name, or let it be unknown."
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
_UNSETTLED = "The search for the structure did not settle: this is the best structure it visited."


@np.errstate(over="ignore", invalid="ignore")  # what overflows is found not to be finite, and refused
def discover(
    record: Record | Sequence[Record],
    masses: Mapping[str, float | str] | Structure | PartialStructure,
    options: DiscoveryOptions | None = None,
    *,
    progress: Progress = silent,
    **keywords: Unpack[DiscoveryKeywords],
) -> Discovery:
    """Discover which masses are linked, and by which law, from records and the masses alone.

    All terms are candidates on the links between every pair of masses, every mass and the ground, and every mass and a
    recorded base; points of hosts are ends of links as masses are. A weak form screens them, or beside hosts a Kalman filter,
    and maximum likelihood and an extended BIC select (METHODS section 9).

    Parameters
    ----------
    record : Record or sequence of Record
        One or several records of the structure. Every mass needs a channel of its displacement (m), velocity (m/s) or
        acceleration (m/s2); only measured displacements give an answer to be trusted. Beside hosts accelerations at some
        points and masses are enough.
    masses : mapping of str to float or str, Structure or PartialStructure
        The masses by name, in kg or with a unit ("10 g"). A structure also states links: those links and terms
        are part of the answer, except links whose law is 0 and terms whose coefficient is 0, which are known to be absent.
    options : DiscoveryOptions, optional
        The candidate terms, and the errors of sensors that are found with them.
    progress : Progress
        Called with a `ProgressReport` at every step of the search.
    **keywords
        In place of `options`: its fields, such as `terms`.

    Returns
    -------
    Discovery
        The structure with intervals, the evidence for each term, and the next best models.

    Raises
    ------
    IdentificationError
        If the records determine no structure: a mass without a sensor, a moving base without its displacement, no motion
        above the noise, too few samples, or a mass to which no link was found.
    RecordError
        If two records hold the same samples, or the noise stated of a channel is far more than its samples.
    StructureError
        If a mass is listed twice or unknown, or a stated link ends at something that is not a mass.
    LawError
        If a term is not a valid expression.

    See Also
    --------
    check_discovery : What the records cannot show, before any time is spent.
    term_score : Compare a discovered structure with the true one.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> found = lw.discover(record, {"m1": 1.0, "m2": "10 g"})
    >>> [(link.name, link.law.text) for link in found.structure.links]
    [('m1-ground', 'k*d + c*v'), ('m2-m1', 'k*d + k3*d**3 + c*v')]
    >>> found.trusted
    True
    """
    started = perf_counter()
    chosen = DiscoveryOptions.given(options, keywords)
    records = [record] if isinstance(record, Record) else list(record)
    candidates = candidates_for(records, masses, chosen.terms)
    checks = _checked(records, candidates)
    candidates = candidates.without_masses(checks.at_rest)
    records = [_channels_of(record, candidates.places) for record in records]
    progress(ProgressReport(0.0, f"screening {len(candidates.entries)} candidates"))
    sensors = LikelihoodOptions(
        **errors_to_find(
            records,
            offsets=chosen.offsets,
            gains=chosen.gains,
            calibration=chosen.calibration,
            delays=chosen.delays,
        ),
        random=random_forces(chosen.ambient, chosen.input_noise, records[0], candidates.full_structure),
    )
    if sensors.random:
        refuse_beside_random_forces(chosen.delays, chosen.admit, (), robust=False, records=records)
    discovery = answer_with_sensors(
        partial(_found, candidates, checks, progress), records, sensors, chosen.admit, _Found.reported
    )
    seconds = perf_counter() - started
    estimate = replace(discovery.estimate, seconds=seconds, notes=joined_notes(records))
    return replace(discovery, estimate=estimate, seconds=seconds)


@dataclass(frozen=True, eq=False)
class _Found:
    """What a search found, and what it was found from."""

    checks: DataChecks
    screened: ScreenedRecords
    selection: Selection
    discovery: Discovery

    @property
    def status(self) -> AnnealingStatus:
        return self.selection.fit.status

    @property
    def chi_square(self) -> float:
        return self.selection.fit.chi_square

    @property
    def chi_square_off(self) -> bool:
        return self.selection.fit.chi_square_off

    @property
    def model_error(self) -> float:
        return self.selection.fit.model_error

    @property
    def delays(self) -> Mapping[str, float]:
        return self.selection.fit.delays

    def reported(self, records: Sequence[Record], delays: Mapping[str, float]) -> Discovery:
        """The discovery, which tells `delays` in s that were found by channel."""
        if not delays:
            return self.discovery
        return _discovery(records, self.checks, self.screened, self.selection, delays)


def _found(
    candidates: Candidates,
    checks: DataChecks,
    progress: Progress,
    records: Sequence[Record],
    sensors: LikelihoodOptions,
) -> _Found:
    """Screen the candidates, and select among them with the errors of `sensors`."""
    with one_blas_thread():
        screened = ScreenedRecords.of(framed_records(records, candidates.full_structure), candidates)
    search = TermSearch(
        records,
        screened.candidates,
        screened.result.tested,
        start=partial(starting_values, records, weak=partial(weak_values, screened)),
        progress=part(progress, _SCREENED, 1.0),
        sensors=sensors,
        restarts=screened.integrated or bool(candidates.hosts),
    )
    if sensors.random:
        selection = select_with_random_forces(search, screened.first)
        return _Found(checks, screened, selection, _discovery(records, checks, screened, selection))
    rates = [record.rate for record in screened.records]
    search, selection = select_with_parameters(search, screened.first, screened.motions, rates)
    screened = replace(screened, candidates=search.candidates)
    selection = select_coloured(search, selection) or selection
    if not selection.is_exact:
        selection = select_inexact(search, selection)
    discovery = _discovery(records, checks, screened, selection, selection.fit.delays)
    if Verdict.SYSTEMATIC_MISFIT in discovery.verdicts and selection.is_exact:
        simpler = select_inexact(search, selection, screened.first)
        reduced = _discovery(records, checks, screened, simpler, simpler.fit.delays)
        if reduced.trusted or simpler.has_fewer_links(selection):
            selection, discovery = simpler, reduced
    return _Found(checks, screened, selection, discovery)


def check_discovery(
    record: Record | Sequence[Record],
    masses: Mapping[str, float | str] | Structure | PartialStructure,
    options: DiscoveryOptions | None = None,
    **keywords: Unpack[DiscoveryKeywords],
) -> tuple[str, ...]:
    """Check whether records suffice to discover a structure, before any time is spent.

    Parameters
    ----------
    record : Record or sequence of Record
        As in `discover`.
    masses : mapping of str to float or str, Structure or PartialStructure
        As in `discover`, in kg.
    options : DiscoveryOptions, optional
        As in `discover`.
    **keywords
        As in `discover`.

    Returns
    -------
    tuple of str
        A sentence for everything that `discover` will not be able to decide from these records; none if they suffice.

    Raises
    ------
    IdentificationError, StructureError, LawError
        As `discover` raises them before its search.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=0.05, rate=1000.0).with_noise(40.0, seed=1)
    >>> lw.check_discovery(record, {"m1": 1.0, "m2": 0.01})
    ('102 samples for 12 candidates are few: weak terms will be missed; record for longer.',)
    """
    chosen = DiscoveryOptions.given(options, keywords)
    records = [record] if isinstance(record, Record) else list(record)
    candidates = candidates_for(records, masses, chosen.terms)
    errors_to_find(records, calibration=chosen.calibration)  # refuses those of other channels
    return _checked(records, candidates).remarks


def _checked(records: Sequence[Record], candidates: Candidates) -> DataChecks:
    """What the records cannot show, and which of their channels are not used."""
    checks = check_data(framed_records(records, candidates.full_structure), candidates)
    unused = of_links(records[0].channels)
    if not unused:
        return checks
    remark = f"{', '.join(unused)} were not used: a discovery takes no forces and states of links."
    return replace(checks, remarks=(*checks.remarks, remark))


def _channels_of(record: Record, places: Sequence[str]) -> Record:
    """`record` without the channels of other masses; the same object if it has none."""
    names = {BASE, *places}
    channels = [channel for channel in record.channels if Channel.parse(channel).mass in names]
    return record if len(channels) == len(record.channels) else record.select(channels)


def _discovery(
    records: Sequence[Record],
    checks: DataChecks,
    screened: ScreenedRecords,
    selection: Selection,
    delays: Mapping[str, float] | None = None,
) -> Discovery:
    """The estimate of the selected structure and the evidence for it; `delays` in s were found by channel."""
    fit = selection.fit
    estimate = estimate_of(selection.structure, fit, records, delays)
    dropped = DroppedTerms.of(selection.quadratic, selection.penalty, len(estimate.parameters))
    alone = np.sqrt(np.maximum(np.asarray(estimate.covariance).diagonal(), 0.0))
    estimate = widened(estimate, dropped.covariance)
    firm = estimate.trusted and selection.settled
    rivals = rival_errors(selection, estimate.structure) if firm and not fit.random_forces else ()
    moves = estimate.trusted and bool(screened.candidates.hosts)
    moved = link_exchanges(selection, screened.candidates) if moves else ()
    if any(rival.is_preferred for rival in rivals):
        estimate = replace(estimate, fit_verdicts=(Verdict.MEASUREMENT_ERROR,), message=_STATED_WRONG)
    forms = rival_forms(selection, screened.candidates) if firm and not fit.random_forces else ()
    estimate = allowing_for(estimate, forms)
    search = _doubts_of_search(screened, selection, estimate, forms)
    verdicts = (*estimate.verdicts, *(verdict for verdict, _ in search))
    trusted = is_trusted(verdicts)
    discovery = Discovery(
        estimate=estimate,
        terms=term_evidence(
            selection,
            screened.candidates,
            trusted=trusted,
            collinear=checks.collinear,
            in_proportion=checks.in_proportion,
            replaceable={
                *(term for rival in rivals for term in rival.terms),
                *(term for exchange in moved for term in exchange.terms),
                *(term for form in forms for term in form.terms),
            },
            shares=unit_shares(selection, screened.candidates) if trusted else {},
            added=np.asarray(estimate.for_dropped_terms).diagonal(),
        ),
        path=selection_path(selection),
        runners_up=runners_up(selection),
        remarks=(
            *(remark for _, remark in search),
            *rival_form_remarks(forms, selection),
            *rival_remarks(rivals, selection.quadratic.names),
            *link_exchange_remarks(moved),
            *checks.remarks,
            *screened.remarks,
            *(exchange_remarks(selection) if firm else ()),
        ),
        verdicts=verdicts,
        rounds=selection.rounds,
        seconds=estimate.seconds,
    )
    return _with_doubts(discovery, dropped, alone, fit) if trusted else discovery


def _doubts_of_search(
    screened: ScreenedRecords, selection: Selection, estimate: Estimate, forms: Sequence[RivalForm]
) -> list[tuple[Verdict, str]]:
    """What takes trust from a search, each with a sentence."""
    valueless = without_values(screened.candidates, selection)
    opposed = opposed_damping(selection, screened.candidates)
    search = [
        (bool(opposed), Verdict.TERMS_MAY_BE_MISSING, _OPPOSED.format(" and ".join(opposed))),
        (bool(forms) and selection.is_exact, Verdict.TERMS_MAY_BE_MISSING, _STAND_INS),
        (bool(valueless), Verdict.TERMS_MAY_BE_MISSING, _NO_VALUES.format(" and ".join(valueless))),
        (not selection.is_exact and not estimate.trusted, Verdict.TERMS_MAY_BE_MISSING, _INEXACT),
        (screened.integrated, Verdict.DISPLACEMENTS_INTEGRATED, _INTEGRATED),
        (not selection.settled, Verdict.SEARCH_UNSETTLED, _UNSETTLED),
    ]
    return [(verdict, remark) for applies, verdict, remark in search if applies]


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
