"""From a record and the masses to the structure: who is linked to whom, and by which law."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates, candidates
from linkwise.discovery.data_checks import check_data
from linkwise.discovery.displacements import with_displacements
from linkwise.discovery.evidence import evidence, exchange_remarks, path, runners_up
from linkwise.discovery.inactive_terms import inactive_remark, inactive_terms
from linkwise.discovery.result import Discovery
from linkwise.discovery.screen import screen, weak_start
from linkwise.discovery.selection import Selection, select_structure
from linkwise.discovery.spanning_tree import tree
from linkwise.discovery.terms import DEFAULT, parse_terms
from linkwise.errors import IdentificationError, LinkwiseError, StructureError
from linkwise.likelihood.anneal import AnnealingStatus, AnnealingStep
from linkwise.likelihood.estimate import estimate_of
from linkwise.likelihood.fit import LikelihoodFit, LikelihoodOptions, likelihood_fit
from linkwise.likelihood.starts.coefficients import law_start
from linkwise.likelihood.starts.inverse_dynamics import needs_integration
from linkwise.model.coefficient import Coefficient
from linkwise.model.link import Link, Mass
from linkwise.model.structure import Structure
from linkwise.model.toml_file import Known
from linkwise.records.channel import BASE, Channel
from linkwise.records.record import Record
from linkwise.runtime import one_blas_thread
from linkwise.signals.channel_noise import channel_noise
from linkwise.units import to_si
from linkwise.verdict import Verdict, is_trusted
from linkwise.weak.displacements import MeasuredDisplacements, read_displacements
from linkwise.weak.estimate import weak_search

Tell = Callable[[float, str], None]

_SCREENED = 0.1  # of the bar, when the screen is done
_SUMMED = (
    "Some displacements were summed up from velocities or accelerations, which lose their constants: links or terms may be "
    "false. Measure displacements, or check the structure with identify on a second record."
)
_INEXACT = (
    "No choice among the terms on offer leaves only noise, so those found may stand in for others: offer more terms, and "
    "check the units and the zeros of the channels, and the masses."
)
_UNSETTLED = "The search for the structure did not settle: the links are the best so far."


def discover(
    record: Record | Sequence[Record],
    masses: Mapping[str, float | str] | Structure | Known,
    *,
    terms: str | Sequence[str] = DEFAULT,
    progress: Tell = lambda fraction, now: None,
) -> Discovery:
    """The structure behind `record`, or behind several records of it, with no prior but the masses (METHODS section 9).

    `masses` are their values by name, in kg or with a unit ("10 g"); a Structure or a Known in their place also says which
    links and terms are known to be there (they stay) and which are not (a law or a coefficient of 0). `terms` are what any
    link may have, as text: functions of d and v, or families of them ("cubic, friction(0.01)"). `progress` is told the
    fraction done and the stage.

    Raises IdentificationError where the records cannot tell: a mass without a sensor, a base that moves without its
    displacement, no motion above the noise, too few samples, a mass that nothing seems to hold.
    """
    begun = perf_counter()
    records = [record] if isinstance(record, Record) else list(record)
    pool = candidate_pool(records, masses, terms)
    ahead = check_data(records, pool)
    pool, remarks = pool.without(ahead.resting), ahead.told
    records = [_of(each, pool.masses) for each in records]
    progress(0.0, f"screening {len(pool.entries)} candidates")
    with one_blas_thread():
        shown = [with_displacements(each, pool.masses) for each in records]
        motions = [read_displacements(each, pool.everything) for each in shown]
        inactive = inactive_terms(motions, [each.rate for each in shown], pool)
        pool, remarks = replace(pool, inactive=frozenset(inactive)), (*remarks, *inactive_remark(inactive))
        seen = all(each is other for each, other in zip(shown, records, strict=True))
        sieve = screen(shown, motions, pool)
        first = sieve.kept if seen else tree(shown, motions, pool) or sieve.kept
    found = select_structure(
        records,
        pool,
        first,
        tested=sieve.tested,
        start=lambda structure: _start(records, shown, motions, structure),
        report=lambda number, done: progress(*_stage(number, done)),
    )
    fit = _finished(records, found)
    estimate = estimate_of(fit, found.structure, records)
    search = [
        (fit.model_error > 0.0, Verdict.TERMS_MAY_BE_MISSING, _INEXACT),
        (not seen, Verdict.DISPLACEMENTS_INTEGRATED, _SUMMED),
        (not found.settled, Verdict.SEARCH_UNSETTLED, _UNSETTLED),
    ]
    verdicts = (*estimate.verdicts, *(verdict for holds, verdict, _ in search if holds))
    remarks = (
        *(remark for holds, _, remark in search if holds),
        *remarks,
        *_dropped_unseen(len(pool.entries) - len(sieve.tested)),
        *(exchange_remarks(found) if estimate.trusted and found.settled else ()),
    )
    seconds = perf_counter() - begun
    return Discovery(
        estimate=replace(estimate, seconds=seconds),
        terms=evidence(found, pool, trusted=is_trusted(verdicts), alike=ahead.alike),
        path=path(found),
        runners_up=runners_up(found),
        remarks=remarks,
        verdicts=verdicts, rounds=found.rounds, seconds=seconds,
    )  # fmt: skip


def foreseen(
    record: Record | Sequence[Record],
    masses: Mapping[str, float | str] | Structure | Known,
    *,
    terms: str | Sequence[str] = DEFAULT,
) -> tuple[str, ...]:
    """What `discover` will not be able to tell from these records, in sentences, before any time is spent.

    Raises what `discover` would raise at once.
    """
    records = [record] if isinstance(record, Record) else list(record)
    return check_data(records, candidate_pool(records, masses, terms)).told


def candidate_pool(
    records: Sequence[Record],
    masses: Mapping[str, float | str] | Structure | Known,
    terms: str | Sequence[str],
) -> Candidates:
    """All candidates between the masses of the records."""
    if not records:
        raise IdentificationError("there is no record to discover from")
    if isinstance(masses, Structure | Known):
        given, stated = masses.masses, masses.links
    else:
        given = tuple(
            Mass(name, Coefficient.number(_kilograms(name, value))) for name, value in masses.items()
        )
        stated = ()
    if not given:
        raise IdentificationError(
            'there is no mass to link: give them by name, as in {"m1": 1.0, "m2": "10 g"}'
        )
    moved = any("x:base" in record.channels for record in records)
    return candidates(given, parse_terms(terms), stated=stated, base=moved)


def _kilograms(name: str, value: float | str) -> float:
    try:
        return to_si(value, "kg")
    except LinkwiseError as error:
        raise StructureError(str(error), f'mass "{name}"') from error


def _dropped_unseen(count: int) -> tuple[str, ...]:
    """What to say of candidates that the screen left out, if there are any."""
    if not count:
        return ()
    return (
        f"{count} candidates that stood out of the noise in the equation of neither of their masses were dropped "
        "without a test by likelihood.",
    )


def _of(record: Record, masses: Sequence[Mass]) -> Record:
    """`record` without the channels of other masses; itself where it has none."""
    names = {BASE, *(mass.name for mass in masses)}
    kept = [channel for channel in record.channels if Channel.parse(channel).mass in names]
    return record if len(kept) == len(record.channels) else record.select(kept)


def _start(
    records: Sequence[Record],
    shown: Sequence[Record],
    motions: Sequence[MeasuredDisplacements],
    structure: Structure,
) -> tuple[Floats, Floats | None]:
    """theta and, where they are known, its deviations (p,): from the forces where `records` without displacements tell those,
    else by the weak form, by its search where a stated law is not linear in an unknown.
    """
    if needs_integration(records[0], structure):
        found = law_start(records[0], structure, channel_noise(records[0]), {})
        return np.array([found[parameter.name] for parameter in structure.parameters]), None
    curved = any(set(link.law.nonlinear) & set(_unknown(link)) for link in structure.links)
    with one_blas_thread():
        if not curved:
            return weak_start(shown, motions, structure)
        fit = weak_search(shown[0], structure, motions[0])[1]
    return fit.values, np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))


def _unknown(link: Link) -> list[str]:
    return [name for name, coefficient in link.coefficients.items() if not coefficient.known]


def _finished(records: Sequence[Record], found: Selection) -> LikelihoodFit:
    """The fit of the chosen structure: that of the last round, or one with a model error where the laws need it."""
    last = found.fit
    if (found.exact and not last.chi_square_off) or last.status is AnnealingStatus.INTERRUPTED:
        return last
    spread = np.sqrt(np.maximum(np.nan_to_num(last.covariance.diagonal()), 0.0))
    return likelihood_fit(
        records,
        found.structure,
        last.values,
        spread=spread,
        options=LikelihoodOptions(nodes=last.optimum.point.nodes),
    )


def _stage(number: int, done: AnnealingStep) -> tuple[float, str]:
    """Fraction and text: every round takes half of what is left of the bar."""
    within = min(max(np.log10(done.q) / -5.0, 0.0), 1.0)
    fraction = _SCREENED + (1.0 - _SCREENED) * (1.0 - 0.5 ** (number - 1.0 + within))
    return float(fraction), f"round {number}: q {done.q:.0e}, chi-square {done.data_per_sample:.3f}"
