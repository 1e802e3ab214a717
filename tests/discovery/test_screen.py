"""The weak screen: what stands above the noise before the likelihood decides, and displacements where none was measured."""

from __future__ import annotations

import numpy as np
import pytest
from judged import masses
from present import some
from problems import chain_record, linear_chain

import linkwise as lw
from linkwise.discovery import screen as module
from linkwise.discovery.candidates import Candidates, candidates_for
from linkwise.discovery.screen import ScreenResult, screen
from linkwise.discovery.selection import QuadraticModel
from linkwise.weak.displacements import read_displacements, with_displacements

#: The elastic terms of the chain of four masses under the names of the candidates.
ELASTIC = {"m1-ground.k", "m3-m1.k", "m2-m1.k", "m2-m1.k3", "m4-m3.k", "m4-m3.k3"}


def noisy_record(decibel: float, seed: int) -> lw.Record:
    clean = chain_record(4)
    return clean.with_noise(decibel, seed=seed)


def run(record: lw.Record, structure: lw.Structure) -> tuple[ScreenResult, Candidates]:
    pool = candidates_for([record], masses(structure), "cubic")
    displaced = with_displacements(record, pool.masses)
    return screen([displaced], [read_displacements(displaced, pool.full_structure)], pool), pool


def elastic(names: frozenset[str], pool: Candidates) -> set[str]:
    return {name for name in names if pool.by_name[name].term.elastic}


@pytest.mark.parametrize(("decibel", "seed"), [(40.0, 1000), (30.0, 1001), (20.0, 1002)])
def test_every_spring_and_cubic_term_of_the_chain_stands(decibel: float, seed: int) -> None:
    screened, pool = run(noisy_record(decibel, seed), lw.bnes_chain(4))
    assert elastic(screened.significant, pool) == ELASTIC
    assert screened.tested == frozenset(pool.by_name)


def test_where_a_spring_stands_its_damper_goes_along() -> None:
    """The weak form can hardly see dampers, so every link that stands takes one to the likelihood."""
    screened, pool = run(noisy_record(20.0, 1000), lw.bnes_chain(4))
    for name in some(elastic(screened.significant, pool)):
        assert f"{name.split('.')[0]}.c" in screened.significant


def test_a_linear_chain_shows_no_cubic_term() -> None:
    linear = linear_chain(4)
    screened, pool = run(linear.clean.with_noise(30.0, seed=1000), linear.structure)
    assert elastic(screened.significant, pool) == {"m1-ground.k", "m3-m1.k", "m2-m1.k", "m4-m3.k"}


def test_mass_by_mass_nothing_true_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """For many masses a first sieve looks at one equation at a time."""
    record = noisy_record(30.0, 1000)
    together, pool = run(record, lw.bnes_chain(4))
    monkeypatch.setattr(module, "_TOGETHER", 2)
    screened, _ = run(record, lw.bnes_chain(4))
    true = ELASTIC | {"m1-ground.c", "m3-m1.c", "m2-m1.c", "m4-m3.c"}
    assert true <= screened.tested < frozenset(pool.by_name)
    assert elastic(screened.significant, pool) == elastic(together.significant, pool)


@pytest.mark.parametrize(("left", "expected"), [(range(12), range(12)), (range(40), range(2))])
def test_elimination_that_left_nearly_all_does_not_count(
    left: range, expected: range, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Elimination finds links that additions one by one miss, but not where it ends with most columns."""

    class Regression:
        names = ()

        def quadratic(self, bias: float) -> float:
            return bias

    monkeypatch.setattr(module, "forward_selection", lambda *_: [0, 1])
    monkeypatch.setattr(module, "_significant", lambda *_: list(left))
    pool = candidates_for([noisy_record(30.0, 1000)], masses(lw.bnes_chain(4)), "cubic")
    assert module._significant_in_one(Regression(), pool) == set(expected)  # type: ignore[arg-type]


def test_additions_to_a_column_that_is_noise_leave_some_bias_in() -> None:
    """A stated link that hardly moves: without the noise bias its column may have a negative square."""
    pool = candidates_for([noisy_record(30.0, 1000)], masses(lw.bnes_chain(4)), "cubic")
    first, second, *_ = pool.by_name

    class Regression:
        names = ("stiff.k", first, second)

        def quadratic(self, bias: float) -> QuadraticModel:
            return QuadraticModel(
                self.names, np.diag([0.2 * bias - 0.05, 1.0, 1.0]), np.array([0.1, 9.0, 0.1]), np.eye(3)
            )

    assert module._significant_in_one(Regression(), pool) == {0, 1}  # type: ignore[arg-type]


def test_measured_displacements_stay_as_they_are() -> None:
    record = noisy_record(30.0, 1000)
    assert with_displacements(record, lw.bnes_chain(4).masses) is record


@pytest.mark.parametrize("kind", ["v", "a"])
def test_displacements_are_summed_up_where_none_was_measured(kind: str) -> None:
    """What swings is found to a few parts in a hundred; where the mass stands is not."""
    chain = lw.bnes_chain(2)
    whole = chain_record(2, sensors=("x", "v", "a")).with_noise(40.0, seed=1000)
    selected = whole.select(("x:m2", f"{kind}:m1"))
    displaced = with_displacements(selected, chain.masses)
    assert displaced.channels == ("x:m2", f"{kind}:m1", "x:m1")
    np.testing.assert_array_equal(displaced.values[:, :2], selected.values)
    x, true = displaced.channel("x:m1"), whole.channel("x:m1")
    middle = slice(1000, 3000)
    swing = true[middle] - true[middle].mean()
    error = x[middle] - x[middle].mean() - swing
    # white noise of 1 % of a velocity sums up to a random walk; of an acceleration it would to far more, but for the high-pass
    omega = np.sqrt(chain.coefficient("spring1.k").value / chain.mass_values[0])
    speed = 0.01 * omega * np.std(true)
    walk = speed * 1e-3 * np.sqrt(len(error))
    assert np.sqrt(np.mean(error**2)) < walk
    # what is found swings at a few parts in a hundred of error; a fifth is allowed
    assert np.sqrt(np.mean(swing**2)) > 5.0 * walk
    assert displaced.noise["x:m1"] == pytest.approx(
        0.01 * np.std(x), rel=0.05
    )  # the share of the channel that it came from
    assert "x:m1" not in selected.noise


def test_noise_bias_that_was_left_in_is_taken_out_step_by_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without all of it the matrix is not positive definite until the weakest coefficient is gone."""
    tried: list[float] = []

    class Regression:
        names = ("m1-ground.k", "m1-ground.c")

        def quadratic(self, bias: float) -> float:
            return bias

    def eliminate(bias: float, chosen: list[int], always: frozenset[int], limit: float) -> list[int]:
        tried.append(bias)
        if len(chosen) == 2 and bias < max(module._BIAS):
            raise np.linalg.LinAlgError
        return [0]

    monkeypatch.setattr(module, "backward_elimination", eliminate)
    pool = candidates_for([noisy_record(30.0, 1000)], masses(lw.bnes_chain(4)), "cubic")
    assert module._significant(Regression(), pool, 4.0) == [0]  # type: ignore[arg-type]
    levels = list(module._BIAS)
    assert levels == sorted(levels) and len(levels) > 1
    assert tried == [*levels, *levels[-2::-1]]
