"""Where the nodes of a graph are drawn: as far apart as there are links between them, as well as a plane allows.

Stress majorization (Gansner, Koren and North 2004) from a few seeded starts; the picture with the fewest crossings wins.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, shortest_path

from linkwise.arrays import Floats

Edges = Sequence[tuple[int, int]]

_STEPS = 150
_STARTS = 12
_LARGE = 60  # nodes from which fewer starts have to do
_GAP = 1.2  # between parts that nothing joins


def node_positions(count: int, edges: Edges) -> Floats:
    """(count, 2) positions of the nodes 0 to count - 1, read-only; a link is about 1 long, the picture wider than high.

    Parts that no edge joins stand above each other. The same graph gives the same picture.
    """
    return _node_positions(count, tuple(edges))


@lru_cache(maxsize=8)  # a graph is laid out for its size, its lines and its legend
def _node_positions(count: int, edges: Edges) -> Floats:
    graph = _graph(count, edges)
    parts, label = connected_components(graph, directed=False)
    positions, top = np.zeros((count, 2)), 0.0
    for part in range(parts):
        nodes = np.flatnonzero(label == part)
        number = {int(node): index for index, node in enumerate(nodes)}
        inner = [(number[a], number[b]) for a, b in edges if a in number]
        placed = _horizontal(_best(len(nodes), inner))
        placed[:, 1] += top - placed[:, 1].min()
        positions[nodes] = placed
        top = float(placed[:, 1].max()) + _GAP
    positions.setflags(write=False)
    return positions


def crossings(points: Floats, edges: Edges) -> int:
    """How many pairs of edges without a common node cross."""
    ends = np.array(sorted({(min(edge), max(edge)) for edge in edges}), dtype=np.intp).reshape(-1, 2)
    first, second = np.triu_indices(len(ends), k=1)
    left, right = ends[first], ends[second]
    apart = ~np.any(left[:, :, None] == right[:, None, :], axis=(1, 2))
    a, b, c, d = (points[nodes[apart]] for nodes in (left[:, 0], left[:, 1], right[:, 0], right[:, 1]))
    return int(np.sum((_turn(a, b, c) * _turn(a, b, d) < 0.0) & (_turn(c, d, a) * _turn(c, d, b) < 0.0)))


def _turn(a: Floats, b: Floats, c: Floats) -> Floats:
    """On which side of the line from a to b the point c lies."""
    return np.asarray((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def _graph(count: int, edges: Edges) -> csr_array:
    rows, columns = [a for a, _ in edges], [b for _, b in edges]
    return csr_array((np.ones(len(edges)), (rows, columns)), shape=(count, count))


def _best(count: int, edges: Edges) -> Floats:
    """Of one part: the layout with the fewest crossings, and of those the one with the least stress."""
    if count == 1:
        return np.zeros((1, 2))
    distance = shortest_path(_graph(count, edges), directed=False, unweighted=True)
    weight = 1.0 / np.where(distance > 0.0, distance, np.inf) ** 2
    laplacian = np.diag(weight.sum(axis=1)) - weight
    inverse = np.asarray(np.linalg.pinv(laplacian), dtype=float)
    rng = np.random.default_rng(0)
    starts = [rng.normal(size=(count, 2)) * np.sqrt(count) for _ in range(_STARTS if count < _LARGE else 3)]
    layouts = [_relaxed(start, distance, weight, inverse) for start in starts]
    return min(layouts, key=lambda layout: (crossings(layout, edges), _stress(layout, distance, weight)))


def _relaxed(points: Floats, distance: Floats, weight: Floats, inverse: Floats) -> Floats:
    """The layout to which stress majorization brings a start."""
    for _ in range(_STEPS):
        apart = _apart(points)
        pull = -weight * distance / np.where(apart > 0.0, apart, np.inf)
        np.fill_diagonal(pull, 0.0)
        np.fill_diagonal(pull, -pull.sum(axis=1))
        points = inverse @ (pull @ points)
    return points


def _stress(points: Floats, distance: Floats, weight: Floats) -> float:
    return float(np.sum(weight * (_apart(points) - distance) ** 2))


def _apart(points: Floats) -> Floats:
    return np.asarray(np.linalg.norm(points[:, None] - points[None], axis=2))


def _horizontal(points: Floats) -> Floats:
    """Turned so that the longest way goes from left to right, the lower node number leading."""
    centred = points - points.mean(axis=0)
    turned = centred @ np.linalg.svd(centred, full_matrices=False)[2].T if len(points) > 1 else centred
    signs = np.where(turned[0] > 0.0, -1.0, 1.0) * np.array([1.0, -1.0])
    return np.asarray(turned * signs)
