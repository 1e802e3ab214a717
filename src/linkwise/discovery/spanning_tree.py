"""Where a search starts that saw no displacements: the tree of links that stand out most.

Velocities and accelerations lose the constants of the motion, so that sums of them suggest false links beside true ones. On
a tree accelerations tell the force of every link, and with it a start that does not need the constants
(`likelihood.lawstart`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree

from linkwise.discovery.candidates import Candidates
from linkwise.discovery.screen import z_scores
from linkwise.model.link import BASE, GROUND
from linkwise.records.record import Record
from linkwise.weak.displacements import MeasuredDisplacements


def tree(
    records: Sequence[Record], motions: Sequence[MeasuredDisplacements], candidates: Candidates
) -> frozenset[str]:
    """All candidates of the links that join every mass to the ground by those of its terms that stand highest in z.

    Empty where the links that stand do not reach every mass.
    """
    place = {mass.name: number for number, mass in enumerate(candidates.masses)}
    place |= {GROUND: len(place), BASE: len(place)}
    near, pairs = np.zeros((len(candidates.masses) + 1,) * 2), {}
    for name, height in z_scores(records, motions, candidates).items():
        entry = candidates.by_name.get(name)
        if entry is None or not entry.term.elastic:
            continue
        one, other = sorted(place[end] for end in candidates.pairs[entry.pair].between)
        if near[one, other] == 0.0 or 1.0 / height < near[one, other]:
            near[one, other], pairs[one, other] = 1.0 / height, entry.pair
    found = minimum_spanning_tree(near).tocoo()
    if found.nnz < len(candidates.masses):
        return frozenset()
    chosen = {pairs[int(one), int(other)] for one, other in zip(found.row, found.col, strict=True)}
    return frozenset(entry.name for entry in candidates.entries if entry.pair in chosen)
