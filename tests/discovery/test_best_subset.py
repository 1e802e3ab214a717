"""The parabola in all candidates against least squares done anew, and the search on it against all choices there are."""

from dataclasses import replace
from functools import cache
from itertools import combinations, product

import numpy as np
import pytest
from present import some
from regressions import Regression

from linkwise.discovery.criterion import Penalty, QuadraticModel

SAME = 1e-8  # the same sums in another order
SIZE = 8
DRAWS = range(1000, 1015)
CHOICES = [[0], [2, 5], [0, 1, 3, 6], [0, 1, 2, 3, 4, 5, 6]]


@pytest.mark.parametrize("chosen", CHOICES, ids=str)
def test_a_choice_is_its_least_squares(chosen: list[int]) -> None:
    regression = Regression.drawn(1)
    values, z, cost = regression.least_squares(chosen)
    solved = regression.quadratic.solve(chosen)
    np.testing.assert_allclose(solved.values, values, rtol=SAME)
    np.testing.assert_allclose(solved.z, z, rtol=SAME)
    assert regression.quadratic.cost(chosen) == pytest.approx(cost, rel=SAME)


@pytest.mark.parametrize("chosen", [[], *CHOICES[:-1]], ids=str)
def test_what_is_outside_is_tried_one_by_one(chosen: list[int]) -> None:
    """z squared is what a coefficient takes off the cost."""
    regression = Regression.drawn(2)
    numbers, values, z = regression.quadratic.additions(chosen)
    assert numbers.tolist() == [number for number in range(7) if number not in chosen]
    for number, value, score in zip(some(numbers), values, z, strict=True):
        together, deviations, cost = regression.least_squares([*chosen, number])
        assert value == pytest.approx(together[-1], rel=SAME)
        assert score == pytest.approx(deviations[-1], rel=SAME)
        assert score**2 == pytest.approx(regression.quadratic.cost(chosen) - cost, rel=SAME)


@pytest.mark.parametrize("by_blocks", [False, True])
def test_an_exchange_is_an_addition_to_the_others(by_blocks: bool) -> None:
    quadratic = Regression.drawn(3).quadratic
    if by_blocks:
        quadratic = replace(
            quadratic, scatter=2.0 * quadratic.h, by_blocks=(np.diag(quadratic.h.diagonal()),)
        )
    chosen = [0, 2, 3, 6]
    for place, exchanged in enumerate(quadratic.exchanges(chosen)):
        added = quadratic.additions([k for k in chosen if k != chosen[place]])
        others = np.isin(added.numbers, exchanged.numbers)
        np.testing.assert_allclose(exchanged.values, added.values[others], rtol=SAME)
        np.testing.assert_allclose(exchanged.z, added.z[others], rtol=SAME)


@pytest.mark.parametrize("by_blocks", [False, True])
def test_another_scatter_gives_the_sandwich(by_blocks: bool) -> None:
    """As the scatter of g, or as that which blocks tell, where this is the larger one."""
    regression, random = Regression.drawn(4), np.random.default_rng(4)
    plain = regression.quadratic
    root = 5.0 * random.normal(size=(7, 7)) * np.sqrt(plain.h.diagonal())[:, None]
    scatter = root @ root.T
    told = {"by_blocks": (0.5 * plain.h, scatter)} if by_blocks else {"scatter": scatter}
    quadratic = replace(plain, **told)
    least = plain.h if by_blocks else 0.0 * plain.h

    def deviations(chosen: list[int]) -> np.ndarray:
        block = np.ix_(chosen, chosen)
        inverse = np.linalg.inv(plain.h[block])
        variances = [(inverse @ matrix[block] @ inverse).diagonal() for matrix in (least, scatter)]
        return np.sqrt(np.maximum(*variances))

    solved = quadratic.solve(range(7))
    np.testing.assert_allclose(solved.z, solved.values / deviations([*range(7)]), rtol=SAME)
    assert quadratic.cost(range(7)) == plain.cost(range(7))
    numbers, values, z = quadratic.additions([0, 2, 3])
    for number, value, score in zip(some(numbers.tolist()), values, z, strict=True):
        assert score == pytest.approx(value / deviations([0, 2, 3, number])[-1], rel=SAME)


def problem(seed: int) -> QuadraticModel:
    """Eight coefficients of four links, three of them small or none, in columns that lean on each other."""
    random = np.random.default_rng(seed)
    columns = random.normal(size=(80, SIZE)) @ (np.eye(SIZE) + 0.4 * random.normal(size=(SIZE, SIZE)))
    true = random.normal(size=SIZE) * random.choice([0.0, 0.2, 1.0], size=SIZE)
    y = columns @ true + random.normal(size=80)
    penalty = Penalty(term=6.0, link=7.0, pair=np.arange(SIZE) // 2, stated=frozenset())
    return replace(Regression(columns, y).quadratic, penalty=penalty)


@cache
def least(seed: int) -> float:
    """The least criterion of all 256 choices."""
    choices = (list(some) for size in range(SIZE + 1) for some in combinations(range(SIZE), size))
    return min(map(problem(seed).criterion, choices))


@pytest.mark.slow
def test_the_best_of_all_choices_is_found_most_of_the_time() -> None:
    """Else one where no single move gains, never above the start."""
    is_best = []
    for seed, start in product(DRAWS, ([], range(SIZE), [1, 6])):
        quadratic = problem(seed)
        end = quadratic.best_subset(start)
        reached = quadratic.criterion(end)
        assert least(seed) - SAME <= reached <= quadratic.criterion(start) + SAME
        assert quadratic.moves(end, swaps=True)[0].gain <= SAME
        is_best.append(reached < least(seed) + SAME)
    # 84, 92 and 96 % of the draws 2000 to 2079 from these three starts; 45 scatter by 5 %
    assert np.mean(is_best) >= 0.8


def test_dependent_columns_at_the_start_are_chosen_among() -> None:
    """An offset of a sensor is what the terms of a law up to its highest power add up to, so that all at once are singular."""
    random = np.random.default_rng(7)
    columns = np.round(64.0 * random.normal(size=(80, 4))) / 64.0  # of which sums of products are exact
    columns[:, 3] = columns[:, :3].sum(axis=1)
    quadratic = Regression(columns, 5.0 * columns[:, 3] + random.normal(size=80)).quadratic
    penalty = Penalty(term=6.0, link=7.0, pair=np.arange(4), stated=frozenset())
    with pytest.raises(np.linalg.LinAlgError):
        quadratic.solve(range(4))
    assert replace(quadratic, penalty=penalty).best_subset(range(4)) == [3]
