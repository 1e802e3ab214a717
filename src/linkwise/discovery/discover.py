"""From a record and the masses to the structure: who is linked to whom, and by which law."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from math import inf
from time import perf_counter
from typing import Unpack

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates, DiscoveryKeywords, DiscoveryOptions, candidates_for
from linkwise.discovery.data_checks import DataChecks, check_data
from linkwise.discovery.inexact import (
    select_beyond_white_noise,
    select_nearly_right,
    select_with_random_forces,
)
from linkwise.discovery.judgement import judged_discovery
from linkwise.discovery.memory import no_memory_remark, select_memory
from linkwise.discovery.result import Discovery, MemoryEvidence
from linkwise.discovery.rivals import Rival, rival_frequencies
from linkwise.discovery.screen import weak_start
from linkwise.discovery.screened_records import ScreenedRecords
from linkwise.discovery.selection import Selection, TermSearch
from linkwise.discovery.term_parameters import select_with_parameters
from linkwise.errors import IdentificationError, options_given
from linkwise.estimates.causes import GAIN_DRIFT, NONLINEARITY, Cause
from linkwise.likelihood.admitted import answer_with_sensors, distinct_error
from linkwise.likelihood.explained import WHITE
from linkwise.likelihood.fit import LikelihoodFit, with_denoised
from linkwise.likelihood.harmonics import harmonic_forces, with_harmonics
from linkwise.likelihood.options import LikelihoodOptions, errors_to_find, with_error
from linkwise.likelihood.problem import require_force_scale
from linkwise.likelihood.random_forces import (
    random_forces,
    refuse_beside_random_forces,
    with_noise_of_signals,
)
from linkwise.likelihood.remarks import with_added
from linkwise.likelihood.starts.memory import memory_starts
from linkwise.likelihood.starts.values import starting_values
from linkwise.likelihood.terms import (
    Delay,
    Gain,
    OfMotion,
    Term,
    frequencies_by_channel,
    of_kind,
    unknown_gains,
)
from linkwise.likelihood.tests.score_test import MEMORY_TERMS
from linkwise.model.structure import Structure
from linkwise.model.structure_file import PartialStructure
from linkwise.progress import Progress, ProgressReport, part, rising, silent
from linkwise.records.channel import BASE
from linkwise.records.channel_units import in_units_of
from linkwise.records.joining import joined_notes, record_list
from linkwise.records.record import Record
from linkwise.runtime import one_blas_thread
from linkwise.signals.base_frame import framed_records
from linkwise.signals.force_window import with_force_windows
from linkwise.verdict import Grade, Verdict, admit_intervals

_SCREENED = 0.1  # of the progress, when the screen is done
_SEARCHED = 0.99  # of the progress, when a selection is judged
_LOOSE = 0.1  # relative deviation of the gain of a force
_ERRORS = 2  # of sensors, that are added at most by themselves: each takes a search
_STANDS_FOR_LAWS = "force gain", "offset", GAIN_DRIFT, NONLINEARITY
"""Errors that other masses, or laws about another position of rest, explain as well: these are asked for, not added."""
_MEMORY = 0.03  # of the forces, left without memory, from which it is looked for where it was not offered


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
        If a mass is listed twice or unknown, a stated link ends at something that is not a mass, or one to be tested is none.
    LawError
        If a term is not a valid expression.
    TypeError
        If the records or masses have another type.

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
    chosen = options_given(DiscoveryOptions, options, keywords)
    records = [with_force_windows(one) for one in record_list(record, "discover(record, masses): record")]
    candidates = candidates_for(records, masses, chosen.terms).asking_for(chosen.tested)
    if candidates.hosts or any(one.units for one in records):  # of points that turn
        records = [in_units_of(one, candidates.full_structure) for one in records]
    checks = _checked(records, candidates)
    candidates = candidates.without_masses(checks.at_rest)
    places = {BASE, *candidates.places}
    records = [
        one.select([c for c in one.channels if c.kind == "signal" or c.place in places]) for one in records
    ]
    progress = rising(progress)
    progress(ProgressReport(0.0, f"screening {len(candidates.entries)} candidates"))
    records, noise = with_noise_of_signals(records, chosen.input_noise, candidates.full_structure)
    sensors = _sensors(replace(chosen, input_noise=noise), records, candidates.full_structure)
    if candidates.memory and (
        sensors.random or of_kind(sensors.errors, Delay) or {"delay", "clock"} & set(chosen.admit)
    ):
        raise IdentificationError(
            f"laws with memory cannot be found together with random forces, noise of inputs or delays: leave out either "
            f"{', '.join(candidates.memory)} or those"
        )
    if sensors.random:
        refuse_beside_random_forces(sensors.errors, chosen.admit, robust=False, records=records)
    found: dict[LikelihoodFit, Discovery] = {}

    def search(records: Sequence[Record], sensors: LikelihoodOptions) -> LikelihoodFit:
        fit, discovery = _select(candidates, checks, progress, records, sensors)
        # which are followed once more, without the noise of their channels
        if any(isinstance(one, OfMotion) for one in sensors.errors):
            denoised = replace(sensors, errors=with_denoised(fit, records, sensors.errors))
            fit, discovery = _select(candidates, checks, progress, records, denoised)
        found[fit] = discovery
        return fit

    driven, sensors = with_harmonics(search, records, sensors)

    def answered(options: LikelihoodOptions) -> Discovery:
        return answer_with_sensors(search, driven, options, chosen.admit, lambda fit, _: found[fit])

    discovery = answered(sensors)
    if not (chosen.as_stated or chosen.admit or sensors.random or candidates.memory):
        discovery = _beside_errors(discovery, answered, sensors, driven)
    seconds = perf_counter() - started
    estimate = replace(discovery.estimate, seconds=seconds, notes=joined_notes(records))
    return replace(discovery, estimate=estimate, seconds=seconds)


def _beside_errors(
    stated: Discovery,
    answered: Callable[[LikelihoodOptions], Discovery],
    options: LikelihoodOptions,
    records: Sequence[Record],
) -> Discovery:
    """The discovery as `stated`, or that beside errors of sensors which its diagnosis names, where they leave only noise."""

    discovery, added = stated, list[Cause]()
    with suppress(IdentificationError):  # of errors that are not told from what is there
        while len(added) < _ERRORS and discovery.grade is not Grade.EXPLAINED:
            error = distinct_error(discovery.diagnosis)
            if error is None or error.kind in _STANDS_FOR_LAWS:
                break
            wider = with_error(options, error, records[0])
            if wider is None:
                break
            options, discovery = wider, answered(wider)
            added.append(error)
    estimate = discovery.estimate
    white = (estimate.chi_square_per_sample or 0.0) < WHITE
    if not added or discovery.grade is not Grade.EXPLAINED or not white:
        return stated
    return replace(discovery, estimate=with_added(estimate, added))


def _sensors(chosen: DiscoveryOptions, records: Sequence[Record], structure: Structure) -> LikelihoodOptions:
    """The errors of sensors, and the forces that no channel shows, which every fit of a search finds."""
    errors = errors_to_find(records, chosen)
    _require_force_scale(records, structure, errors)
    return LikelihoodOptions(
        errors,
        harmonics=harmonic_forces(frequencies_by_channel(chosen.harmonics), records[0], structure),
        random=random_forces(chosen.ambient, chosen.input_noise, records[0], structure),
    )


def _require_force_scale(records: Sequence[Record], structure: Structure, errors: Sequence[Term]) -> None:
    """IdentificationError where nothing tells the scale of all masses and terms, or a calibration that is too loose for tests.

    A test of a term is linear, in which the scale could shrink all of them to nothing at the cost of the calibration alone.
    """
    unknown = unknown_gains(errors)
    of_forces = [gain for gain in of_kind(errors, Gain) if gain.channel.startswith("force:")]
    loose = [gain.channel for gain in of_forces if _LOOSE < gain.deviation < inf]
    require_force_scale(records, structure, unknown)
    try:
        require_force_scale(records, structure, (*unknown, *loose))
    except IdentificationError:
        raise IdentificationError(
            f"terms cannot be decided on where a calibration as loose as that of {loose[0]} is all that tells the scale of "
            f"masses and terms: up to {100.0 * _LOOSE:g} % is supported. Discover without it, and identify the structure "
            "found with it",
            arguments=("calibration",),
        ) from None


def _select(
    candidates: Candidates,
    checks: DataChecks,
    progress: Progress,
    records: Sequence[Record],
    sensors: LikelihoodOptions,
) -> tuple[LikelihoodFit, Discovery]:
    """Screen the candidates, and select among them with the errors of `sensors`: the fit of what is found, and the discovery.

    Exact laws come first. Where they leave more than white noise, coloured noise of a sensor may explain it, then memory in a
    link, then a model error; laws that seem exact and yet lack a term are searched once more with a model error.
    """
    with one_blas_thread():
        framed = framed_records(records, candidates.full_structure)
        screened = ScreenedRecords.of(framed, candidates, part(progress, 0.0, _SCREENED))

    def judged(
        selection: Selection, memory: Sequence[MemoryEvidence] = (), frequencies: Sequence[Rival] = ()
    ) -> tuple[LikelihoodFit, Discovery]:
        discovery = judged_discovery(checks, screened, selection, records, memory, frequencies)
        return selection.fit, discovery

    search = TermSearch(
        records,
        screened.candidates,
        screened.tested,
        start=partial(_starting_values, records, screened),
        progress=part(progress, _SCREENED, 1.0),
        sensors=sensors,
        restarts=screened.integrated or bool(candidates.hosts),
    )
    if sensors.random:
        return judged(select_with_random_forces(search, screened.first))
    search, exact = select_with_parameters(search, screened.first, screened.measured)
    exact = select_beyond_white_noise(search, exact)
    if candidates.memory:
        remembering = select_memory(search, screened, exact)
        if remembering is not None:
            return judged(*remembering)
        screened = replace(screened, remarks=(*screened.remarks, no_memory_remark(candidates.memory)))
    selection = exact if exact.is_exact else select_nearly_right(search, exact)
    frequencies = rival_frequencies(search, selection) if candidates.hosts else ()
    progress(ProgressReport(_SEARCHED, "judging the terms selected"))
    fit, discovery = judged(selection, frequencies=frequencies)
    if not candidates.memory and _may_remember(selection, discovery):
        remembering = select_memory(search, screened, exact, *discovery.diagnosis[:1])
        if remembering is not None:
            return judged(*remembering)
    if selection.is_exact and _lacks_a_term(discovery):
        simpler = select_nearly_right(search, selection, screened.first)
        reduced = judged(simpler)
        follows = Verdict.SYSTEMATIC_MISFIT in discovery.verdicts
        # links may stand in for terms that were not offered
        fewer = simpler.settled and len(simpler.structure.links) < len(selection.structure.links)
        if (follows and admit_intervals(reduced[1].verdicts)) or fewer:
            return reduced
    return fit, discovery


def _starting_values(
    records: Sequence[Record], screened: ScreenedRecords, structure: Structure
) -> tuple[Floats, Floats | None]:
    """Starting values of the parameters of a structure; with signals by the regression for links with memory.

    Terms that hardly stand above the noise have values from weak equations in which a part of its bias is left.
    """
    if structure.signals:
        framed = framed_records(records, structure, integrated=True)
        return memory_starts(framed, structure, {})[0].values, None
    try:
        return starting_values(records, structure)
    except IdentificationError:
        links = structure.links
        linear = all(link.coefficients[name].known for link in links for name in link.law.nonlinear)
        if not (screened.measured and linear):
            raise
        return weak_start(screened.measured, screened.candidates, structure)


def _may_remember(selection: Selection, discovery: Discovery) -> bool:
    """Whether a force with memory would explain most of what the laws leave, or they leave much and are not trusted."""
    if any(cause.term in MEMORY_TERMS for cause in discovery.diagnosis[:1]):
        return True
    untrusted = not (selection.is_exact or admit_intervals(discovery.verdicts))
    return untrusted and discovery.estimate.model_error > _MEMORY


def _lacks_a_term(discovery: Discovery) -> bool:
    """Whether what the laws leave follows the motion; noise of an input may seem to leave it, where a term does so as well."""
    kinds = {cause.kind for cause in discovery.diagnosis}
    noise = Verdict.MEASUREMENT_ERROR in discovery.verdicts and discovery.diagnosis[:1]
    as_well = bool(noise) and discovery.diagnosis[0].kind == "input noise" and "term" in kinds
    return Verdict.SYSTEMATIC_MISFIT in discovery.verdicts or as_well


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
    >>> lw.discovery.check_discovery(record, {"m1": 1.0, "m2": 0.01})
    ('102 samples for 12 candidates are few: weak terms will be missed; record for longer.',)
    """
    chosen = options_given(DiscoveryOptions, options, keywords)
    records = record_list(record, "check_discovery(record, masses): record")
    candidates = candidates_for(records, masses, chosen.terms).asking_for(chosen.tested)
    errors_to_find(records, chosen)  # refuses those of other channels
    return _checked(records, candidates).remarks


def _checked(records: Sequence[Record], candidates: Candidates) -> DataChecks:
    """What the records cannot show, and which of their channels are not used."""
    checks = check_data(framed_records(records, candidates.full_structure), candidates)
    unused = [channel for channel in records[0].channels if channel.of_link]
    if not unused:
        return checks
    remark = f"{', '.join(unused)} were not used: discovery does not take forces and states of links."
    return replace(checks, remarks=(*checks.remarks, remark))
