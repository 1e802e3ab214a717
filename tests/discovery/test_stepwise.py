"""The search for the best choice against all choices there are."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from present import some
from regressions import Regression

from linkwise.discovery.selection import (
    MoveKind,
    Penalty,
    QuadraticModel,
    backward_elimination,
    best_subset,
    forward_selection,
    local_search,
    ranked_moves,
)

SAME = 1e-8  # the same sums in another order
SIZE = 8
DRAWS = range(1000, 1040)


def problem(seed: int) -> tuple[QuadraticModel, Penalty]:
    """Eight coefficients of four links, three of them small or none, in columns that lean on each other."""
    random = np.random.default_rng(seed)
    columns = random.normal(size=(80, SIZE)) @ (np.eye(SIZE) + 0.4 * random.normal(size=(SIZE, SIZE)))
    true = random.normal(size=SIZE) * random.choice([0.0, 0.2, 1.0], size=SIZE)
    y = columns @ true + random.normal(size=80)
    penalty = Penalty(term=6.0, link=7.0, pair=np.arange(SIZE) // 2, stated=frozenset())
    return Regression(columns, y).quadratic, penalty


def criterion(quadratic: QuadraticModel, penalty: Penalty, chosen: list[int]) -> float:
    return quadratic.cost(chosen) + penalty.total(chosen)


@cache
def least(seed: int) -> float:
    """The least criterion of all 256 choices."""
    quadratic, penalty = problem(seed)
    choices = (list(some) for size in range(SIZE + 1) for some in combinations(range(SIZE), size))
    return min(criterion(quadratic, penalty, some) for some in choices)


@pytest.mark.parametrize("swaps", [False, True])
def test_a_move_gains_what_it_says(swaps: bool) -> None:
    quadratic, penalty = problem(1)
    chosen = [0, 3, 5]
    moves = ranked_moves(quadratic, penalty, chosen, swaps=swaps)
    assert [move.gain for move in moves] == sorted((move.gain for move in moves), reverse=True)
    assert {move.kind for move in moves} == {MoveKind.ADD, MoveKind.DROP, *([MoveKind.SWAP] if swaps else [])}
    assert len(moves) == 5 + 3 + 3 * swaps
    before = criterion(quadratic, penalty, chosen)
    for move in moves:
        after = sorted({*chosen, *([] if move.added is None else [move.added])} - {move.dropped})
        assert move.gain == pytest.approx(before - criterion(quadratic, penalty, after), rel=1e-8, abs=1e-8)


def test_exchanges_of_many_coefficients_are_the_best_of_each() -> None:
    """45 chosen of 60, tried at once, against every exchange by itself; a stated pair, and one that nothing may replace."""
    random = np.random.default_rng(4)
    columns = random.normal(size=(300, 60)) @ (np.eye(60) + 0.1 * random.normal(size=(60, 60)))
    quadratic = Regression(columns, columns @ random.normal(size=60) + random.normal(size=300)).quadratic
    pair = np.concatenate([[-1], np.arange(59) // 3])
    penalty = Penalty(term=6.0, link=7.0, pair=pair, stated=frozenset({2}))
    chosen = sorted([0, *random.permutation(np.arange(1, 60))[:44].tolist()])
    swaps = [
        move for move in ranked_moves(quadratic, penalty, chosen, swaps=True) if move.kind is MoveKind.SWAP
    ]
    assert len(swaps) == len(chosen) - 1
    before = criterion(quadratic, penalty, chosen)
    outside = sorted(set(range(60)) - set(chosen))
    for move in some(swaps):
        remaining = sorted(set(chosen) - {move.dropped})
        gains = [before - criterion(quadratic, penalty, sorted([*remaining, added])) for added in outside]
        assert move.gain == pytest.approx(max(gains), rel=SAME, abs=SAME * abs(before))
        assert move.added == outside[int(np.argmax(gains))]


@pytest.mark.parametrize("search", [local_search, best_subset])
@pytest.mark.parametrize("start", [[], list(range(SIZE)), [1, 6]], ids=str)
def test_a_search_ends_where_no_single_move_gains_and_never_above_its_start(
    search: Callable[..., list[int]], start: list[int]
) -> None:
    for seed in DRAWS:
        quadratic, penalty = problem(seed)
        end = search(quadratic, penalty, start)
        assert criterion(quadratic, penalty, end) <= criterion(quadratic, penalty, start) + SAME
        assert ranked_moves(quadratic, penalty, end, swaps=True)[0].gain <= SAME


@pytest.mark.parametrize("start", [[], list(range(SIZE)), [1, 6]], ids=str)
def test_the_best_of_all_choices_is_found_most_of_the_time(start: list[int]) -> None:
    is_best = []
    for seed in DRAWS:
        quadratic, penalty = problem(seed)
        reached = criterion(quadratic, penalty, best_subset(quadratic, penalty, start))
        assert reached >= least(seed) - SAME
        is_best.append(reached < least(seed) + SAME)
    # 84, 92 and 96 % of the draws 2000 to 2079 from these three starts; 40 draws scatter by 5 %
    assert np.mean(is_best) >= 0.8


def test_one_search_alone_is_caught_more_often() -> None:
    """Three starts are there for a reason: on the same draws the first alone misses more."""
    missed = {local_search: 0, best_subset: 0}
    for seed in DRAWS:
        quadratic, penalty = problem(seed)
        for search in missed:
            missed[search] += (
                criterion(quadratic, penalty, search(quadratic, penalty, [])) > least(seed) + 1e-9
            )
    assert missed[best_subset] < missed[local_search]


def test_what_has_no_price_is_never_taken_away_or_added() -> None:
    quadratic, penalty = problem(2)
    free = Penalty(
        penalty.term, penalty.link, np.where(np.arange(SIZE) == 3, -1, penalty.pair), penalty.stated
    )
    heavy = Penalty(1e9, 1e9, free.pair, free.stated)
    assert local_search(quadratic, heavy, [0, 3, 5]) == [3] == best_subset(quadratic, heavy, [0, 3, 5])
    assert not [move for move in ranked_moves(quadratic, free, [0, 5], swaps=True) if move.added == 3]


def test_a_term_on_a_link_that_stands_is_taken_before_one_on_a_new_link() -> None:
    """One may stand for the other: the damper belongs where a spring is, even where it fits a little less well."""
    h = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.98], [0.0, 0.98, 1.0]])
    g = np.array([100.0, 4.0, 4.2])
    penalty = Penalty(term=6.0, link=7.0, pair=np.array([0, 0, 1]), stated=frozenset())
    quadratic = QuadraticModel(("spring", "its damper", "a damper elsewhere"), h, g)
    assert best_subset(quadratic, penalty, [0]) == [0, 1]
    assert best_subset(quadratic, penalty, [0, 2]) == [0, 1]


def test_a_pair_that_is_stated_has_its_link_for_nothing() -> None:
    h, g = np.eye(2), np.array([3.0, 3.0])
    pair = np.array([0, 1])
    quadratic = QuadraticModel(("on a stated link", "on another"), h, g)
    assert best_subset(quadratic, Penalty(6.0, 7.0, pair, frozenset({0})), []) == [0]
    assert best_subset(quadratic, Penalty(6.0, 7.0, pair, frozenset()), []) == []


def test_pruned_keeps_what_stands_above_the_limit_and_what_must_stay() -> None:
    beside = []
    for seed in DRAWS:
        quadratic, _ = problem(seed)
        left = backward_elimination(quadratic, list(range(SIZE)), frozenset({2}), 3.0)
        z = np.abs(quadratic.solve(left).z)
        assert 2 in left
        beside += [score for score, number in zip(z, left, strict=True) if number != 2]
    assert min(some(beside)) >= 3.0  # the limit that was given
    assert backward_elimination(quadratic, list(range(SIZE)), frozenset(), 0.0) == list(range(SIZE))
    assert backward_elimination(quadratic, list(range(SIZE)), frozenset(), np.inf) == []


def test_pruned_goes_gently() -> None:
    """Two columns that are nearly one hide each other; once the weaker is gone the other stands."""
    random = np.random.default_rng(3)
    column = random.normal(size=500)
    columns = np.column_stack([column, column + 0.03 * random.normal(size=500), random.normal(size=500)])
    quadratic = Regression(columns, column + random.normal(size=500)).quadratic
    z = np.abs(quadratic.solve(range(3)).z)
    assert np.all(z < 3.0)  # all at once, all would go
    assert len(backward_elimination(quadratic, [0, 1, 2], frozenset(), 3.0)) == 1


def test_columns_that_are_one_and_the_same_do_not_stop_the_search() -> None:
    regression = Regression.drawn(7, size=3)
    doubled = Regression(np.column_stack([regression.columns, regression.columns[:, 1]]), regression.y)
    penalty = Penalty(6.0, 7.0, np.array([0, 1, 2, 3]), frozenset())
    chosen = best_subset(doubled.quadratic, penalty, [0, 1])
    assert len({1, 3} & set(chosen)) <= 1
    assert (
        criterion(doubled.quadratic, penalty, chosen) <= criterion(doubled.quadratic, penalty, [0, 1]) + SAME
    )


def test_forward_selection_leaves_nothing_significant_outside() -> None:
    inside, outside = [], []
    for seed in DRAWS:
        quadratic, _ = problem(seed)
        chosen = forward_selection(quadratic, frozenset({2}), 3.0)
        z = np.abs(quadratic.solve(chosen).z)
        assert 2 in chosen
        inside += [score for score, number in zip(z, chosen, strict=True) if number != 2]
        outside += np.abs(quadratic.additions(chosen).z).tolist()
    assert min(some(inside)) >= 3.0 > max(some(outside))


def test_forward_selection_takes_one_of_two_equal_columns() -> None:
    regression = Regression.drawn(7, size=3)
    doubled = Regression(np.column_stack([regression.columns, regression.columns[:, 1]]), regression.y)
    alone = forward_selection(regression.quadratic, frozenset(), 3.0)
    assert 1 in alone
    chosen = forward_selection(doubled.quadratic, frozenset(), 3.0)
    assert {1 if number == 3 else number for number in chosen} == set(alone) and len(chosen) == len(alone)


def test_dependent_columns_at_the_start_are_chosen_among() -> None:
    """An offset of a sensor is what the terms of a law up to its highest power add up to, so that all at once are singular."""
    random = np.random.default_rng(7)
    columns = np.round(64.0 * random.normal(size=(80, 4))) / 64.0  # of which sums of products are exact
    columns[:, 3] = columns[:, :3].sum(axis=1)
    quadratic = Regression(columns, 5.0 * columns[:, 3] + random.normal(size=80)).quadratic
    penalty = Penalty(term=6.0, link=7.0, pair=np.arange(4), stated=frozenset())
    with pytest.raises(np.linalg.LinAlgError):
        quadratic.solve(range(4))
    assert best_subset(quadratic, penalty, range(4)) == [3]
