"""What a search for a structure starts from: candidates that the records show, displacements, and a first subset.

The subset is that of the weak screen, or of the Kalman filter beside hosts. Where displacements were integrated, it is the
tree of links that the accelerations determine (`force_tree`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.discovery.candidates import Candidates, CandidateTerm
from linkwise.discovery.force_tree import tree_of_forces
from linkwise.discovery.screen import Measured, screen, screen_links
from linkwise.discovery.term_parameters import first_values
from linkwise.errors import IdentificationError
from linkwise.progress import Progress
from linkwise.records.record import Record, common_samples
from linkwise.signals.gaps import short_gaps_bridged
from linkwise.weak.displacements import read_densely, with_displacements

# samples in which a term is not zero: noise alone gives a few beyond the range of the motion
_LEAST_ACTIVE = 8
_NAMED = 6  # terms that a remark names


def _inactive_terms(measured: Measured, candidates: Candidates) -> tuple[str, ...]:
    """The names of candidates that were zero throughout the motion, but for a few samples.

    A stop that no motion reached is such a term; no record of these determines it. A smooth one is zero at isolated points.
    """

    def active(entry: CandidateTerm) -> int:
        count = 0
        for record, motion in measured:
            ends = candidates.rows(entry.pair)
            d = np.subtract(*motion.displacements[ends])
            absent = (
                () if motion.missing is None else motion.missing[[k for k in ends if k < len(motion.missing)]]
            )
            force = np.broadcast_to(entry.term.law.force(d, np.gradient(d) * record.rate, {}), d.shape)
            count += int(np.count_nonzero(force[~np.any(absent, axis=0)]))
        return count

    laws = ((entry, entry.term.law) for entry in candidates.entries)
    kinked = (entry for entry, law in laws if law.kinks and not law.signals)
    return tuple(entry.name for entry in kinked if active(entry) < _LEAST_ACTIVE)


@dataclass(frozen=True, eq=False)
class ScreenedRecords:
    """The screen of records `measured`, with displacements of all masses, and the `first` subset that a search starts from.

    Beside hosts there are no displacements. `integrated` says whether some displacement was not measured; `tested` are the
    names of the candidates that the likelihood is to test, and `remarks` sentences on those that it is not.
    """

    measured: Measured
    candidates: Candidates
    integrated: bool
    tested: frozenset[str]
    first: frozenset[str]
    remarks: tuple[str, ...]

    @classmethod
    def of(cls, records: Sequence[Record], candidates: Candidates, progress: Progress) -> ScreenedRecords:
        """Screen what the records show of the candidates, less those that were never active.

        Short gaps are bridged where there are not enough windows without one.
        """
        if candidates.hosts:
            first = screen_links(records[0], candidates)
            return cls((), candidates, False, frozenset(candidates.by_name), first, ())
        records = [common_samples(record) or record for record in records]
        try:
            return cls._of_masses(records, candidates, progress)
        except IdentificationError:
            bridged = [short_gaps_bridged(record) or record for record in records]
            if bridged == records:
                raise
        return cls._of_masses(bridged, candidates, progress)

    @classmethod
    def _of_masses(
        cls, records: Sequence[Record], candidates: Candidates, progress: Progress
    ) -> ScreenedRecords:
        """The screen without hosts, of records at one rate."""
        whole = candidates
        candidates = replace(whole, terms=tuple(term for term in whole.terms if not term.law.signals))
        displaced = [with_displacements(record, candidates.masses) for record in records]
        integrated = any(ours is not given for ours, given in zip(displaced, records, strict=True))
        measured = [read_densely(record, candidates.full_structure) for record in displaced]
        candidates = first_values(candidates, measured)
        inactive = _inactive_terms(measured, candidates)
        candidates = replace(candidates, inactive=frozenset(inactive))
        first, tested = screen(measured, candidates, progress)
        tested |= candidates.on_pairs(
            {k for k, p in enumerate(candidates.pairs) if p.name in candidates.asked_for}
        )
        if integrated:
            first = tree_of_forces(records, candidates) or first
            # a constant force may only shift elongations that were not measured, so that the equations are singular
            first -= {entry.name for entry in candidates.entries if entry.term.is_constant}
        remarks = []
        if inactive:
            more = f" and {len(inactive) - _NAMED} more" if len(inactive) > _NAMED else ""
            remarks.append(
                f"{', '.join(inactive[:_NAMED])}{more} were never active in this record and are left out; record a motion "
                "that reaches them."
            )
        if len(tested) < len(candidates.by_name):
            remarks.append(
                f"{len(candidates.by_name) - len(tested)} candidates that were significant in the equation of neither of "
                "their masses were dropped without a test by likelihood. The result folder lists them as untested; one or all "
                "of these links can be asked for."
            )
        if len(whole.terms) > len(candidates.terms):  # whose signals the weak form does not take
            candidates = replace(candidates, terms=whole.terms)
            tested |= {entry.name for entry in candidates.entries if entry.term.law.signals}
        return cls(measured, candidates, integrated, tested, first, tuple(remarks))
