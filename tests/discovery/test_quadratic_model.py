"""The parabola in all candidates against least squares done anew for every choice, and the price of a model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import some
from regressions import Regression
from structures import bodies, link, structure

from linkwise.discovery.candidates import all_candidates
from linkwise.discovery.selection import Penalty, QuadraticModel
from linkwise.discovery.terms import parse_terms

SAME = 1e-8  # the same sums in another order


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
    regression = Regression.drawn(2)
    numbers, values, z, part = regression.quadratic.additions(chosen)
    assert numbers.tolist() == [number for number in range(7) if number not in chosen]
    for number, value, score, stands in zip(some(numbers), values, z, part, strict=True):
        together, deviations, _ = regression.least_squares([*chosen, number])
        assert value == pytest.approx(together[-1], rel=SAME)
        assert score == pytest.approx(deviations[-1], rel=SAME)
        column = regression.columns[:, number]
        lean = regression.columns[:, chosen] @ np.linalg.lstsq(regression.columns[:, chosen], column)[0]
        assert stands == pytest.approx(np.sum((column - lean) ** 2) / np.sum(column**2), rel=SAME)


def test_z_squared_is_what_a_coefficient_takes_off_the_cost() -> None:
    quadratic = Regression.drawn(3).quadratic
    numbers, _, z, _ = quadratic.additions([1, 4])
    for number, score in zip(some(numbers), z, strict=True):
        gain = quadratic.cost([1, 4]) - quadratic.cost([1, 4, number])
        assert score**2 == pytest.approx(gain, rel=SAME)


def test_another_scatter_gives_the_sandwich() -> None:
    """Noisy columns: g scatters by something else than H."""
    regression, random = Regression.drawn(4), np.random.default_rng(4)
    h, g = regression.quadratic.h, regression.quadratic.g
    root = random.normal(size=(7, 7)) * np.sqrt(h.diagonal())[:, None]
    scatter = root @ root.T
    quadratic = QuadraticModel(regression.quadratic.names, h, g, scatter)
    inverse = np.linalg.inv(h)
    deviation = np.sqrt((inverse @ scatter @ inverse).diagonal())
    np.testing.assert_allclose(quadratic.solve(range(7)).z, inverse @ g / deviation, rtol=SAME)
    numbers, values, z, _ = quadratic.additions([0, 2, 3])
    for number, value, score in zip(some(numbers.tolist()), values, z, strict=True):
        block = np.ix_([0, 2, 3, number], [0, 2, 3, number])
        inverse = np.linalg.inv(h[block])
        assert value == pytest.approx((inverse @ g[[0, 2, 3, number]])[-1], rel=SAME)
        assert score == pytest.approx(value / np.sqrt((inverse @ scatter[block] @ inverse)[-1, -1]), rel=SAME)


def test_no_variance_is_less_than_blocks_tell() -> None:
    """Of two matrices, one that scatters less than H in all directions and one that scatters more in some."""
    regression, random = Regression.drawn(6), np.random.default_rng(6)
    plain = regression.quadratic
    vector = 5.0 * random.normal(size=7) * np.sqrt(plain.h.diagonal())
    quadratic = replace(plain, by_blocks=(0.5 * plain.h, np.outer(vector, vector)))
    inverse = np.linalg.inv(plain.h)
    deviation = np.sqrt(np.maximum(inverse.diagonal(), (inverse @ vector) ** 2))
    np.testing.assert_allclose(quadratic.solve(range(7)).z, inverse @ plain.g / deviation, rtol=SAME)
    assert quadratic.cost(range(7)) == plain.cost(range(7))
    before, after = plain.additions([0, 2, 3]), quadratic.additions([0, 2, 3])
    for number, value, score, alone in zip(
        some(after.numbers.tolist()), after.values, after.z, before.z, strict=True
    ):
        block = np.ix_([0, 2, 3, number], [0, 2, 3, number])
        by_blocks = (np.linalg.inv(plain.h[block]) @ vector[[0, 2, 3, number]])[-1]
        assert abs(score) == pytest.approx(min(abs(alone), abs(value / by_blocks)), rel=SAME)


def test_a_column_that_is_another_one_cannot_be_told() -> None:
    regression = Regression.drawn(5, size=3)
    doubled = Regression(np.column_stack([regression.columns, 2.0 * regression.columns[:, 1]]), regression.y)
    numbers, values, z, part = doubled.quadratic.additions([0, 1])
    assert numbers.tolist() == [2, 3]
    assert np.isfinite(values[0]) and z[0] != 0.0
    assert np.isnan(values[1]) and z[1] == 0.0 and abs(part[1]) < SAME


def test_columns_that_move_together_have_no_solution() -> None:
    columns = np.random.default_rng(6).normal(size=(50, 2))
    together = Regression(np.column_stack([columns, columns[:, 0]]), columns[:, 1])
    with pytest.raises(np.linalg.LinAlgError):
        together.quadratic.solve([0, 2])
    empty = Regression(columns * [1.0, 0.0], columns[:, 1])
    with pytest.raises(np.linalg.LinAlgError, match="a column is zero"):
        empty.quadratic.solve([0, 1])


POOL = all_candidates(bodies(dict.fromkeys("abc", 1.0)), parse_terms("v, d, d**3"))
NAMES = tuple(POOL.by_name)  # of a-ground, b-ground, b-a, c-ground, c-a and c-b


def test_a_model_pays_for_its_terms_and_for_its_links() -> None:
    penalty = Penalty.of(POOL, NAMES, 1000)
    naming = np.log(1000.0)
    assert penalty.term == pytest.approx(naming + 2.0 * np.log(3))
    assert penalty.link == pytest.approx(naming + 2.0 * np.log(6))
    assert penalty.total([]) == 0.0
    assert penalty.total([0]) == penalty.term + penalty.link
    assert penalty.total([0, 1]) == 2.0 * penalty.term + penalty.link  # a second term on the same link
    assert penalty.total([0, 3]) == 2.0 * penalty.term + 2.0 * penalty.link  # the first of another


def test_what_is_stated_costs_nothing() -> None:
    stated = structure({"a": 1.0}, link("frame", "a-ground", "k*d"))
    pool = all_candidates(stated.masses, parse_terms("v, d, d**3"), stated=stated.links)
    penalty = Penalty.of(pool, ("frame.k", "frame.c", "frame.k3"), 100)
    assert penalty.pair.tolist() == [-1, 0, 0]
    assert penalty.total([0]) == 0.0
    assert penalty.total([0, 1]) == penalty.term  # the link is there anyhow


def test_a_longer_record_asks_for_more_evidence() -> None:
    assert Penalty.of(POOL, NAMES, 10_000).term > Penalty.of(POOL, NAMES, 1000).term
