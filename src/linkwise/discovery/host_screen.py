"""Which candidate links of a structure with hosts exert forces, before anything is known of their laws.

The modes and the stated links with known linear laws are a linear system. A candidate link is a random force between its ends
(`likelihood.starts.hosts`), and a Kalman filter gives the likelihood of the samples with it. Links are added one at a time,
the likeliest first, as long as the likelihood rises by more than the penalty on a link.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import Candidates
from linkwise.discovery.criterion import Penalty
from linkwise.errors import IdentificationError
from linkwise.likelihood.starts.kalman import log_likelihood, tuned_modes
from linkwise.likelihood.starts.linear_part import LinearModel, LinearPart, inputs_of, samples_of
from linkwise.likelihood.starts.values import require_supported
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.noise import channel_noise

_TRIED = 2000  # samples that decide which links there are
_CHANGES = 10.0 ** np.arange(
    -3.0, 2.0
)  # of a force over a sample, relative to its size: tried one after the other
_ALLOWED = 1e-3  # of the size of accelerations: white forces on the modes, which keep the filter steady
_MOST = 12  # links that are added


def screen_links(record: Record, candidates: Candidates) -> frozenset[str]:
    """The names of all candidates on the links whose forces a record shows; those of stated links are among them.

    Raises IdentificationError if the record determines the modes too poorly.
    """
    structure = candidates.full_structure
    require_supported(record, structure)
    noise = channel_noise(record)
    try:
        chosen = _added_links(_Filter.of(record, structure, noise), structure, candidates)
        free = [
            p.name
            for p in structure.parameters
            if p.name.owner in structure.mass_names and not p.name.is_shape
        ]
        if free:  # stated as they are known beforehand, which links may make up for
            names = _candidates_on(chosen, structure, candidates)
            tuned = tuned_modes(record, candidates.structure(names), noise)
            changed = structure.with_values({name: tuned[name] for name in free})
            chosen = _added_links(_Filter.of(record, changed, noise), structure, candidates)
    except np.linalg.LinAlgError:
        raise IdentificationError(
            "no links can be found: the record is too short, has too few samples, or its sensors do not show the modes of the "
            "host; give a longer record, or more sensors"
        ) from None
    return _candidates_on(chosen, structure, candidates)


def _candidates_on(links: Collection[int], structure: Structure, candidates: Candidates) -> frozenset[str]:
    """The names of the candidates on some `links` of the structure of all, and on stated ones."""
    names = {structure.links[number].name for number in links}
    return frozenset(
        entry.name
        for entry in candidates.entries
        if candidates.pairs[entry.pair].name in names or candidates.pairs[entry.pair].stated
    )


def _added_links(tried: _Filter, structure: Structure, candidates: Candidates) -> list[int]:
    """The links, by number, that raise the likelihood by more than their penalty, and one at least for every mass."""
    stated = {link.name for pair in candidates.pairs for link in pair.stated}
    chosen = [number for number in tried.linear.open if structure.links[number].name in stated]
    others = [number for number in tried.linear.open if number not in chosen]
    samples = int(np.isfinite(tried.samples).sum())
    least = 0.5 * Penalty.of(candidates, (), samples).link
    current = tried.evidence(chosen)
    while others and len(chosen) < _MOST:
        loose = _loose(chosen, structure, candidates)
        evidence_with = {number: tried.evidence((*chosen, number)) for number in others}
        best = max(evidence_with, key=lambda number: evidence_with[number])
        if evidence_with[best] < current + least:
            around = [number for number in others if not loose.isdisjoint(structure.links[number].between)]
            if not around:
                break
            best = max(around, key=lambda number: evidence_with[number])
        chosen.append(best)
        others.remove(best)
        current = evidence_with[best]
    return chosen


def _loose(chosen: Collection[int], structure: Structure, candidates: Candidates) -> set[str]:
    """The masses to which none of the `chosen` links goes, nor one whose law is known."""
    open_links = {pair.name for pair in candidates.pairs if not pair.stated}
    linked = {
        end
        for number, link in enumerate(structure.links)
        if number in chosen or link.name not in open_links
        for end in link.between
    }
    return {mass.name for mass in candidates.masses} - linked


@dataclass(frozen=True, eq=False)
class _Filter:
    """The linear system of all candidates with the forces of some as random inputs, and what it has to explain."""

    linear: LinearPart
    record: Record
    noise: Mapping[str, float]

    @classmethod
    def of(cls, record: Record, structure: Structure, noise: Mapping[str, float]) -> _Filter:
        """That of the first samples of a record."""
        return cls(LinearPart.of(structure), record[: min(_TRIED, len(record))], noise)

    @property
    def samples(self) -> Floats:
        """(N, C) samples of the record."""
        return samples_of(self.record, replace(self.linear, open=()))

    def evidence(self, links: Sequence[int]) -> float:
        """Log likelihood of the samples with random forces in `links` alone, of the likeliest rate of their change."""
        part = replace(self.linear, open=tuple(links))
        samples, inputs = samples_of(self.record, part), inputs_of(self.record)
        best = -np.inf
        for change in _CHANGES if links else _CHANGES[:1]:
            model = part.model(self.record, self.noise, float(change))
            model = _with_random_modes(model, self.linear.structure.size, self.record.step)
            bounds = model.noise[len(model.noise) - len(links) :]  # of elongations, which are no samples
            with np.errstate(all="ignore"):
                log_evidence = log_likelihood(model, samples, inputs) + 0.5 * len(samples) * float(
                    np.log(bounds).sum()
                )
            best = max(best, log_evidence) if np.isfinite(log_evidence) else best
        return best


def _with_random_modes(model: LinearModel, size: int, step: float) -> LinearModel:
    """A model with a small white random force on each of its `size` modes and masses, for what is wrong with the host."""
    x, v = np.sqrt(model.first.diagonal()[[0, size]])
    process = model.process.copy()
    rows = np.arange(size, 2 * size)
    process[rows, rows] += (_ALLOWED * v**2 / x * step) ** 2
    return replace(model, process=process)
