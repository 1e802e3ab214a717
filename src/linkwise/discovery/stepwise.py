"""Stepwise search for the subset of coefficients with the least criterion: cost plus penalty.

Coefficients are added, dropped or exchanged one at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from linkwise.arrays import Indices
from linkwise.discovery.criterion import Penalty
from linkwise.discovery.quadratic_model import QuadraticModel

_MOST_MOVES = 400  # far more than any search takes; a search that reaches it is in a cycle
_LEAST_GAIN = 1e-6  # of the criterion: less is rounding
_MANY = 40  # coefficients from which all exchanges are tried at once, by one inverse
_ELIMINATED = 3  # one in so many of the weak coefficients is eliminated in a round


class MoveKind(Enum):
    """What a move does to a subset."""

    ADD = "add"
    DROP = "drop"
    SWAP = "swap"


@dataclass(frozen=True)
class Move:
    """A change of a subset that lowers the criterion by `gain`: coefficients `dropped` and `added`, by number, or None."""

    kind: MoveKind
    dropped: int | None
    added: int | None
    gain: float


def ranked_moves(
    quadratic: QuadraticModel, penalty: Penalty, chosen: Sequence[int], *, swaps: bool
) -> list[Move]:
    """All moves from the subset `chosen`, best first; with `swaps` also the best exchange for each selected coefficient."""
    inside = np.asarray(chosen, dtype=np.intp)
    z = quadratic.solve(inside).z
    moves = _additions(quadratic, penalty, list(chosen), None, 0.0)
    places = np.flatnonzero(penalty.pair[inside] >= 0)
    offered = np.delete(penalty.pair, inside) >= 0
    swaps = swaps and bool(offered.any())
    many = swaps and quadratic.scatter is None and not quadratic.by_blocks and len(inside) >= _MANY
    exchanged = _best_exchanges(quadratic, penalty, inside) if many else {}
    for place in places.tolist():
        remaining = np.delete(inside, place).tolist()
        saved = penalty.total(list(chosen)) - penalty.total(remaining) - float(z[place] ** 2)
        dropped = int(inside[place])
        moves.append(Move(MoveKind.DROP, dropped, None, saved))
        if place in exchanged:
            added, gain = exchanged[place]
            moves.append(Move(MoveKind.SWAP, dropped, added, saved + gain))
        elif swaps and not many:
            additions = _additions(quadratic, penalty, remaining, dropped, saved)
            others = [move for move in additions if move.added != dropped]
            moves += sorted(others, key=lambda move: -move.gain)[:1]
    return sorted(moves, key=lambda move: -move.gain)


def _additions(
    quadratic: QuadraticModel, penalty: Penalty, chosen: list[int], dropped: int | None, saved: float
) -> list[Move]:
    """Every coefficient added to `chosen`; `saved` is the gain of having dropped `dropped` before."""
    numbers, _, z, _ = quadratic.additions(chosen)
    pairs = penalty.pair[numbers]
    linked = np.isin(pairs, [*set(penalty.pair[chosen].tolist()), *penalty.stated])
    gains = saved + z**2 - penalty.term - np.where(linked, 0.0, penalty.link)
    kind = MoveKind.ADD if dropped is None else MoveKind.SWAP
    return [
        Move(kind, dropped, int(number), float(gain))
        for number, gain, pair in zip(numbers, gains, pairs, strict=True)
        if pair >= 0
    ]


def _best_exchanges(
    quadratic: QuadraticModel, penalty: Penalty, inside: Indices
) -> dict[int, tuple[int, float]]:
    """For each place among the chosen the best coefficient for it, and the gain of that with the place empty."""
    numbers, z = quadratic.exchanges(inside)
    offered = penalty.pair[numbers] >= 0
    if not offered.any():
        return {}
    numbers, z = numbers[offered], z[:, offered]
    pairs, own = penalty.pair[numbers], penalty.pair[inside]
    stated = np.isin(pairs, list(penalty.stated))
    best = {}
    for place in np.flatnonzero(own >= 0).tolist():
        linked = stated | np.isin(pairs, np.delete(own, place))
        gains = z[place] ** 2 - penalty.term - np.where(linked, 0.0, penalty.link)
        first = int(np.argmax(gains))
        best[place] = int(numbers[first]), float(gains[first])
    return best


def local_search(quadratic: QuadraticModel, penalty: Penalty, start: Sequence[int]) -> list[int]:
    """The subset, reached from `start`, at which no single addition, removal or exchange lowers the criterion."""
    chosen = sorted(start)
    for _ in range(_MOST_MOVES):
        move = _best_move(quadratic, penalty, chosen)
        if move is None or move.gain <= _LEAST_GAIN:
            break
        chosen = sorted({*chosen, *([] if move.added is None else [move.added])} - {move.dropped})
    return chosen


def _best_move(quadratic: QuadraticModel, penalty: Penalty, chosen: list[int]) -> Move | None:
    """The move that gains most, an exchange only if no other move gains; None if every coefficient was stated."""
    for swaps in (False, True):
        moves = ranked_moves(quadratic, penalty, chosen, swaps=swaps)
        if moves and (swaps or moves[0].gain > _LEAST_GAIN):
            return moves[0]
    return None


def best_subset(quadratic: QuadraticModel, penalty: Penalty, start: Sequence[int]) -> list[int]:
    """The best result of local searches from three subsets: `start`, all terms of its links, and all coefficients.

    Where the columns of `start` are linearly dependent, as those of an offset and of all powers that it adds up to are, one
    is built up from nothing in its place. The second start finds dampers for which one on a false link may substitute, the
    third links that `start` lacks.
    """
    linked = np.isin(penalty.pair, [*(set(penalty.pair[list(start)].tolist()) - {-1}), *penalty.stated])
    always = frozenset(np.flatnonzero(penalty.pair < 0).tolist())
    limit = float(np.sqrt(penalty.term))
    try:
        subsets = [local_search(quadratic, penalty, start)]
    except np.linalg.LinAlgError:
        subsets = [local_search(quadratic, penalty, forward_selection(quadratic, always, limit))]
    for wide in ({*start, *np.flatnonzero(linked).tolist()}, set(range(len(penalty.pair)))):
        try:
            reduced = backward_elimination(quadratic, sorted(wide), always, limit)
            subsets.append(local_search(quadratic, penalty, reduced))
        except np.linalg.LinAlgError:
            continue
    return min(subsets, key=lambda chosen: quadratic.cost(chosen) + penalty.total(chosen))


def backward_elimination(
    quadratic: QuadraticModel, start: Sequence[int], always: frozenset[int], limit: float
) -> list[int]:
    """Drop coefficients with |z| below `limit` from `start`, the weakest third of them first, until none is left.

    Those in `always` stay. Raises numpy.linalg.LinAlgError if the columns are linearly dependent.
    """
    chosen = sorted(start)
    while True:
        z = np.abs(quadratic.solve(chosen).z)
        weak = [k for k, number in enumerate(chosen) if z[k] < limit and number not in always]
        if not weak:
            return chosen
        weak.sort(key=lambda k: z[k])
        eliminated = set(weak[: max(1, len(weak) // _ELIMINATED)])
        chosen = [number for k, number in enumerate(chosen) if k not in eliminated]


def forward_selection(quadratic: QuadraticModel, always: frozenset[int], limit: float) -> list[int]:
    """Add the coefficient with the largest |z| to `always`, drop what it makes insignificant, until no |z| is above `limit`.

    Of hundreds of columns that the noise makes nearly dependent only a few are ever solved for together. Raises
    numpy.linalg.LinAlgError if the columns of `always` are linearly dependent.
    """
    chosen = sorted(always)
    visited: set[tuple[int, ...]] = set()
    refused: list[int] = []
    while True:
        additions = quadratic.additions(chosen)
        z = np.where(np.isin(additions.numbers, refused), 0.0, np.abs(additions.z))
        if not len(z) or not np.max(z) >= limit:
            return chosen
        added = int(additions.numbers[int(np.argmax(z))])
        try:
            after = backward_elimination(quadratic, [*chosen, added], always, limit)
        except np.linalg.LinAlgError:
            refused.append(added)
            continue
        if tuple(after) in visited:
            refused.append(added)
            continue
        visited.add(tuple(after))
        chosen = after
