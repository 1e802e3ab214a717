"""What a search for a structure starts from: candidates that the records show, displacements, and a first subset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.data_checks import inactive_remark, inactive_terms
from linkwise.discovery.force_tree import tree_of_forces
from linkwise.discovery.host_screen import screen_links
from linkwise.discovery.screen import ScreenResult, screen, weak_start
from linkwise.discovery.spanning_tree import most_significant_tree
from linkwise.discovery.term_parameters import first_values
from linkwise.errors import IdentificationError
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.progress import Progress, silent
from linkwise.records.joining import common_samples
from linkwise.records.record import Record
from linkwise.signals.gaps import short_gaps_bridged
from linkwise.weak.displacements import MeasuredDisplacements, read_densely, with_displacements
from linkwise.weak.estimate import weak_search


@dataclass(frozen=True, eq=False)
class ScreenedRecords:
    """The screen of some `records`, which have displacements of all masses, and the subset that a search starts from.

    Beside hosts there are no displacements, and the screen is that of `host_screen`. `integrated` says whether some
    displacement was not measured; `remarks` are sentences on candidates that are not tested by likelihood, and `untested` the
    names of those that the screen dropped.
    """

    records: Sequence[Record]
    motions: Sequence[MeasuredDisplacements]
    candidates: Candidates
    integrated: bool
    result: ScreenResult
    first: frozenset[str]
    remarks: tuple[str, ...]
    untested: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, records: Sequence[Record], candidates: Candidates, progress: Progress = silent
    ) -> ScreenedRecords:
        """Screen what the records show of the candidates, less those that were never active.

        Short gaps are bridged where there are not enough windows without one.
        """
        if candidates.hosts:
            first = screen_links(records[0], candidates)
            result = ScreenResult(first, frozenset(candidates.by_name))
            return cls(records, (), candidates, False, result, first, ())
        records = [common_samples(record) or record for record in records]
        try:
            return cls._of_masses(records, candidates, progress)
        except IdentificationError:
            bridged = [short_gaps_bridged(record) for record in records]
            if not any(bridged):
                raise
        filled = [ours or given for ours, given in zip(bridged, records, strict=True)]
        return cls._of_masses(filled, candidates, progress)

    @classmethod
    def _of_masses(
        cls, records: Sequence[Record], candidates: Candidates, progress: Progress
    ) -> ScreenedRecords:
        """The screen without hosts, of records at one rate."""
        displaced = [with_displacements(record, candidates.masses) for record in records]
        integrated = any(ours is not given for ours, given in zip(displaced, records, strict=True))
        read = [read_densely(record, candidates.full_structure) for record in displaced]
        displaced, motions = [record for record, _ in read], [motion for _, motion in read]
        rates = [record.rate for record in displaced]
        candidates = first_values(motions, rates, candidates)
        inactive = inactive_terms(motions, rates, candidates)
        candidates = replace(candidates, inactive=frozenset(inactive))
        result = screen(displaced, motions, candidates, progress)
        result = replace(result, tested=result.tested | candidates.always_tested)
        first = result.significant
        if integrated:
            first = (
                tree_of_forces(records, candidates)
                or most_significant_tree(displaced, motions, candidates)
                or result.significant
            )
            # a constant force may only shift elongations that were not measured, so that the equations are singular
            first -= {entry.name for entry in candidates.entries if entry.term.is_constant}
        untested = tuple(entry.name for entry in candidates.entries if entry.name not in result.tested)
        remarks = (*inactive_remark(inactive), *_untested_remark(len(untested)))
        return cls(displaced, motions, candidates, integrated, result, first, remarks, untested)


def _untested_remark(count: int) -> tuple[str, ...]:
    """A sentence on the candidates that the screen dropped, if there are any."""
    if not count:
        return ()
    return (
        f"{count} candidates that were significant in the equation of neither of their masses were dropped without a test by "
        "likelihood. The result folder lists them as untested; one or all of these links can be asked for.",
    )


def weak_values(
    screened: ScreenedRecords, structure: Structure, known: Mapping[str, float]
) -> tuple[Floats, Floats]:
    """The parameters (p,) of `structure` by the weak form, and their standard deviations (p,).

    By its search, from the `known` values, if a stated law is nonlinear in an unknown.
    """
    if not any(set(link.law.nonlinear) & set(_unknowns(link)) for link in structure.links):
        return weak_start(screened.records, screened.motions, structure)
    fit = weak_search(screened.records[0], structure, screened.motions[0], known)[1]
    return fit.values, np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))


def _unknowns(link: Link) -> list[str]:
    return [name for name, coefficient in link.coefficients.items() if not coefficient.known]
