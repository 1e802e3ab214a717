"""The spanning tree of the most significant links, for searches that start without displacements, and for links with memory.

Integrals of velocities and accelerations lack their constants, and suggest false links beside true ones. On a tree,
accelerations determine the force of every link, and with it a start that does not need the constants
(`likelihood.starts.coefficients`). `force_tree` finds it from these forces themselves, where all masses are known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree

from linkwise.discovery.candidates import Candidates
from linkwise.discovery.screen import z_scores
from linkwise.model.link import BASE, GROUND
from linkwise.records.record import Record
from linkwise.weak.displacements import MeasuredDisplacements

_STATED = 1e12  # in place of |z| of a stated link: larger than any


def most_significant_tree(
    records: Sequence[Record], motions: Sequence[MeasuredDisplacements], candidates: Candidates
) -> frozenset[str]:
    """All candidates on the links of the tree that joins every mass to the ground with the largest |z|.

    The |z| of a link is that of its most significant elastic term. Empty if the significant links do not reach every mass.
    """
    chosen = _tree(records, motions, candidates, {})
    return frozenset(entry.name for entry in candidates.entries if entry.pair in chosen)


def skeleton(
    records: Sequence[Record], motions: Sequence[MeasuredDisplacements], candidates: Candidates
) -> frozenset[int]:
    """The numbers of the pairs with stated links, and of those of the tree of the most significant links beside them.

    Only the former if the significant links do not reach every mass.
    """
    stated = {number: _STATED for number, pair in enumerate(candidates.pairs) if pair.stated}
    return frozenset(stated) | _tree(records, motions, candidates, stated)


def _tree(
    records: Sequence[Record],
    motions: Sequence[MeasuredDisplacements],
    candidates: Candidates,
    stated: Mapping[int, float],
) -> frozenset[int]:
    """The numbers of the pairs of the tree with the largest |z|; those of the `stated` are given by number."""
    z = dict(stated)
    for name, score in z_scores(records, motions, candidates).items():
        entry = candidates.by_name.get(name)
        if entry is not None and entry.term.elastic:
            z[entry.pair] = max(score, z.get(entry.pair, 0.0))
    node = {mass.name: number for number, mass in enumerate(candidates.masses)}
    node |= {GROUND: len(node), BASE: len(node)}
    distance, pairs = np.zeros((len(candidates.masses) + 1,) * 2), {}
    for pair, score in z.items():
        ends = tuple(sorted(node[end] for end in candidates.pairs[pair].between))
        if distance[ends] == 0.0 or 1.0 / score < distance[ends]:
            distance[ends], pairs[ends] = 1.0 / score, pair
    tree = minimum_spanning_tree(distance).tocoo()
    if tree.nnz < len(candidates.masses):
        return frozenset()
    return frozenset(pairs[int(first), int(second)] for first, second in zip(tree.row, tree.col, strict=True))
