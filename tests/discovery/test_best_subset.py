"""The parabola in all candidates against least squares done anew, and the search on it against all choices there are."""

from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations, product
from typing import Self

import numpy as np
import pytest

from linkwise.discovery.criterion import Penalty, QuadraticModel


@dataclass(frozen=True, eq=False)
class Regression:
    """y (N,) = columns (N, p) c + noise of deviation 1."""

    columns: np.ndarray
    y: np.ndarray

    @classmethod
    def drawn(cls, seed: int, size: int = 7, samples: int = 60) -> Self:
        """Columns of sizes over six decades that lean on each other."""
        random = np.random.default_rng(seed)
        columns = random.normal(size=(samples, size)) @ (
            np.eye(size) + 0.4 * random.normal(size=(size, size))
        )
        true = random.normal(size=size)
        y = columns @ true + random.normal(size=samples)
        return cls(columns * 10.0 ** random.uniform(-3.0, 3.0, size), y)

    @property
    def quadratic(self) -> QuadraticModel:
        names = tuple(f"c{number}" for number in range(self.columns.shape[1]))
        free = Penalty(0.0, 0.0, np.full(len(names), -1), frozenset())
        return QuadraticModel(names, self.columns.T @ self.columns, self.columns.T @ self.y, free)

    def least_squares(self, chosen: list[int]) -> tuple[np.ndarray, np.ndarray, float]:
        """Values, z, and the squares that are left less those of y itself."""
        part = self.columns[:, chosen]
        values, *_ = np.linalg.lstsq(part, self.y)
        deviation = np.sqrt(np.linalg.inv(part.T @ part).diagonal())
        left = self.y - part @ values
        return values, values / deviation, float(left @ left - self.y @ self.y)


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
