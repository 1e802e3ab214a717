"""Links whose displacement no sensor shows, so that their law may be another one about another origin.

A force alpha*d + beta*d**3 with two wells is k*d + k2*d**2 + k3*d**3 about the one in which the motion stays. Velocities and
accelerations cannot distinguish them; a law that is odd about its origin has no other with as few terms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.discovery.candidates import Candidates
from linkwise.discovery.selection import Selection
from linkwise.estimates.estimate import Estimate
from linkwise.model.structure import GROUND
from linkwise.records.record import Record

_ODD = 1e-9  # of the largest force: rounding
_REMARK = (
    "The law of {} is not odd, and no sensor shows its displacement: about another origin another law, such as one with two "
    "wells, may be the same force. Measure the displacement, or excite the link until it moves through all of its wells."
)


@dataclass(frozen=True)
class UnknownOrigin:
    """A link `between` two ends with a law that is not odd about an origin that is not known, and its `terms` by number."""

    between: tuple[str, str]
    terms: tuple[int, ...]


def unknown_origins(
    estimate: Estimate, records: Sequence[Record], selection: Selection, candidates: Candidates
) -> tuple[UnknownOrigin, ...]:
    """The links that were found whose force is not odd in their motion, and whose displacement is not in the records."""
    channels = [channel for record in records for channel in record.channels]
    placed = {GROUND, *(channel.place for channel in channels if channel.kind == "x")}
    origins = []
    for index, link in enumerate(estimate.structure.links):
        if placed.issuperset(link.between) or link.law.states:
            continue
        d, v = estimate.motion.d[:, index], estimate.motion.v[:, index]
        force = link.force(d, v)
        if np.max(np.abs(force + link.force(-d, -v))) > _ODD * np.max(np.abs(force)):
            terms = [
                number
                for number, name in enumerate(selection.quadratic.names)
                if (entry := candidates.by_name.get(name)) is not None
                and set(candidates.pairs[entry.pair].between) == set(link.between)
            ]
            origins.append(UnknownOrigin(link.between, tuple(terms)))
    return tuple(origins)


def origin_remarks(origins: Sequence[UnknownOrigin]) -> tuple[str, ...]:
    """A sentence on these links, if there are any."""
    if not origins:
        return ()
    return (_REMARK.format(" and ".join("-".join(origin.between) for origin in origins)),)
