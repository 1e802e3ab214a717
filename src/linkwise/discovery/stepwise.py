"""The best choice near a given one: terms are added, taken away or exchanged while misfit plus price falls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from linkwise.discovery.criterion import Penalty
from linkwise.discovery.quadratic_model import QuadraticModel

_MOVES = 400  # far more than any search takes; a search that needs them goes in circles
_GAIN = 1e-6  # a move that gains less is none
_AT_ONCE = 3  # every so manieth of the weakest coefficients falls in one round of `backward_elimination`


class MoveKind(Enum):
    ADD = "add"
    DROP = "drop"
    SWAP = "swap"


@dataclass(frozen=True)
class Move:
    """A change of a choice: coefficients that go `out` and come `in_`, by number, None for none; `gain` on cost and price."""

    kind: MoveKind
    out: int | None
    in_: int | None
    gain: float


def ranked_moves(
    quadratic: QuadraticModel, penalty: Penalty, chosen: Sequence[int], *, swaps: bool
) -> list[Move]:
    """All moves from `chosen`, best first; exchanges only where `swaps` says so, one for each term that can go: the best."""
    inside = np.asarray(chosen, dtype=np.intp)
    z = quadratic.solve(inside).z
    free = np.flatnonzero(penalty.pair[inside] >= 0)
    found = _additions(quadratic, penalty, list(chosen), None, 0.0)
    for place in free:
        left = np.delete(inside, place).tolist()
        saved = penalty.total(list(chosen)) - penalty.total(left) - float(z[place] ** 2)
        out = int(inside[place])
        found.append(Move(MoveKind.DROP, out, None, saved))
        if swaps:
            others = [move for move in _additions(quadratic, penalty, left, out, saved) if move.in_ != out]
            found += sorted(others, key=lambda move: -move.gain)[:1]
    return sorted(found, key=lambda move: -move.gain)


def _additions(
    quadratic: QuadraticModel, penalty: Penalty, chosen: list[int], out: int | None, saved: float
) -> list[Move]:
    """Every coefficient added to `chosen`; with `out` gone before, which saved `saved`."""
    numbers, _, z, _ = quadratic.outside(chosen)
    pairs = penalty.pair[numbers]
    linked = np.isin(pairs, [*set(penalty.pair[chosen].tolist()), *penalty.stated])
    gain = saved + z**2 - penalty.term - np.where(linked, 0.0, penalty.link)
    kind = MoveKind.ADD if out is None else MoveKind.SWAP
    return [
        Move(kind, out, int(number), float(each))
        for number, each, pair in zip(numbers, gain, pairs, strict=True)
        if pair >= 0
    ]


def local_search(quadratic: QuadraticModel, penalty: Penalty, start: Sequence[int]) -> list[int]:
    """The choice at which no single addition, removal or exchange lowers misfit plus price any more."""
    chosen = sorted(start)
    for _ in range(_MOVES):
        move = _best_move(quadratic, penalty, chosen)
        if move is None or move.gain <= _GAIN:
            break
        chosen = sorted({*chosen, *([] if move.in_ is None else [move.in_])} - {move.out})
    return chosen


def _best_move(quadratic: QuadraticModel, penalty: Penalty, chosen: list[int]) -> Move | None:
    """The one that gains most, an exchange only where nothing else gains; None where every coefficient was stated."""
    for swaps in (False, True):
        ranked = ranked_moves(quadratic, penalty, chosen, swaps=swaps)
        if ranked and (swaps or ranked[0].gain > _GAIN):
            return ranked[0]
    return None


def best(quadratic: QuadraticModel, penalty: Penalty, start: Sequence[int]) -> list[int]:
    """The best of three searches: from `start`, from every term of the links that `start` has, and from all there is.

    The second finds the dampers for which one of a link that is not there may stand in, the third links that lie elsewhere.
    """
    linked = np.isin(penalty.pair, [*(set(penalty.pair[list(start)].tolist()) - {-1}), *penalty.stated])
    always = frozenset(np.flatnonzero(penalty.pair < 0).tolist())
    limit = float(np.sqrt(penalty.term))
    found = [local_search(quadratic, penalty, start)]
    for wide in ({*start, *np.flatnonzero(linked).tolist()}, set(range(len(penalty.pair)))):
        try:
            found.append(
                local_search(quadratic, penalty, backward_elimination(quadratic, sorted(wide), always, limit))
            )
        except np.linalg.LinAlgError:
            continue
    return min(found, key=lambda chosen: quadratic.cost(chosen) + penalty.total(chosen))


def backward_elimination(
    quadratic: QuadraticModel, start: Sequence[int], always: frozenset[int], limit: float
) -> list[int]:
    """`start` without what stays below `limit` deviations, the weakest third of it going first, until all stand above."""
    chosen = sorted(start)
    while True:
        z = np.abs(quadratic.solve(chosen).z)
        weak = [k for k, number in enumerate(chosen) if z[k] < limit and number not in always]
        if not weak:
            return chosen
        weak.sort(key=lambda k: z[k])
        falling = set(weak[: max(1, len(weak) // _AT_ONCE)])
        chosen = [number for k, number in enumerate(chosen) if k not in falling]
