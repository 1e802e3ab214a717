"""Which of the minima that parts of a record have is that of the whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import some
from rigs import measured, rig, run

from linkwise.likelihood.prescribed import fit as fits
from linkwise.likelihood.prescribed.problem import RigProblem
from linkwise.likelihood.prescribed.records import rig_forces
from linkwise.likelihood.prescribed.search import Minimum, minimise

TRUE = {"F": 100.0, "w": 400.0}  # up to 10 mm: sine waves of 16 mm, a valley of the squares beside others


def wavy() -> RigProblem:
    structure = rig("F*sin(w*d)", TRUE)
    record = measured(run(structure), 1)
    return RigProblem(structure.unknown("damper"), (rig_forces(record, structure),))


def valleys(problem: RigProblem, weights: np.ndarray) -> list[Minimum]:
    """A wrong valley, the right one, and another wrong one."""
    order = [parameter.name for parameter in problem.parameters]
    starts = [{"F": 20.0, "w": 1800.0}, {"F": 90.0, "w": 380.0}, {"F": 20.0, "w": 3000.0}]
    return [
        minimise(problem, np.array([start[name.split(".")[-1]] for name in order]), weights)
        for start in some(starts)
    ]


def test_the_lowest_minimum_of_the_whole_is_taken_not_that_of_the_part(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = wavy()
    weights = np.full(len(problem.cell(0)), 0.01)
    wrong, right, _ = valleys(problem, weights)
    assert wrong.cost > 10.0 * right.cost
    in_part = [replace(wrong, cost=1.0), replace(right, cost=1.1)]
    assert fits._on_whole(problem, in_part, weights)[0].cost == 1.0  # a record that was searched whole
    monkeypatch.setattr(fits, "_SEARCHED", 100)
    taken = fits._on_whole(problem, in_part, weights)
    assert [minimum.cost for minimum in taken] == pytest.approx([right.cost, wrong.cost], rel=1e-6)


def test_minima_far_above_the_lowest_of_the_part_are_not_searched_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = wavy()
    weights = np.full(len(problem.cell(0)), 0.01)
    wrong, right, other = valleys(problem, weights)
    monkeypatch.setattr(fits, "_SEARCHED", 100)
    in_part = [replace(right, cost=1.0), replace(wrong, cost=1.3), replace(other, cost=1.4)]
    assert len(fits._on_whole(problem, in_part, weights)) == 1
