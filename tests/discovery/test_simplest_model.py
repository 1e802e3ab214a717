"""The simplest model that predicts pieces of the records as well as the best one, where a law is a little wrong."""

from __future__ import annotations

import numpy as np
import pytest
from random_force import random_force
from structures import oscillator

import linkwise as lw
from linkwise.discovery import inexact
from linkwise.discovery.inexact import larger_model_remarks, simplest_model
from linkwise.discovery.prediction import BlockParabolas
from linkwise.discovery.selection import Penalty, QuadraticModel

BLOCKS = 10
RATE, DURATION = 200.0, 8.0


def model(
    values: list[float], pairs: list[int], *, in_one_block: int | None = None
) -> tuple[QuadraticModel, Penalty, BlockParabolas]:
    """Independent coefficients of standard error 1, with a penalty of 14, which all blocks say alike.

    That of the number `in_one_block` is said by one block only, the others say that it is zero.
    """
    p = len(values)
    names = tuple(f"k{k}" for k in range(p))
    curvatures = np.tile(np.eye(p) / BLOCKS, (BLOCKS, 1, 1))
    slopes = np.zeros((BLOCKS, p))
    if in_one_block is not None:
        slopes[:, in_one_block] = -values[in_one_block] / BLOCKS
        slopes[0, in_one_block] += values[in_one_block]
    numbers = {k: k for k in range(p)}
    return (
        QuadraticModel(names, np.eye(p), np.array(values)),
        Penalty(term=14.0, link=20.0, pair=np.array(pairs), stated=frozenset()),
        BlockParabolas(slopes, curvatures, np.array(values), numbers, p, {}),
    )


@pytest.mark.parametrize(
    ("values", "pairs", "in_one_block", "simplest"),
    [
        pytest.param([50.0, 4.0], [0, 0], 1, [0], id="in doubt, and asked for by one block"),
        pytest.param([50.0, 4.0], [0, 0], None, [0, 1], id="in doubt, and asked for by all blocks"),
        pytest.param([50.0, 5.0], [0, 0], 1, [0, 1], id="certain, and asked for by one block"),
        pytest.param([50.0, 4.0], [0, 1], 1, [0, 1], id="the only one of its link"),
        pytest.param([50.0, 4.0], [0, -1], 1, [0, 1], id="no term: a mass"),
    ],
)
def test_a_term_is_dropped_where_evidence_leaves_it_in_doubt_and_prediction_does_not_ask_for_it(
    values: list[float], pairs: list[int], in_one_block: int | None, simplest: list[int]
) -> None:
    quadratic, penalty, parabolas = model(values, pairs, in_one_block=in_one_block)
    assert simplest_model(quadratic, penalty, parabolas, [0, 1]) == simplest


def test_prediction_over_another_model() -> None:
    _, _, parabolas = model([50.0, 4.0, 7.0], [0, 0, 0], in_one_block=1)
    over_other = parabolas.prediction([0], than=[0, 1])
    first, second = parabolas.prediction([0]), parabolas.prediction([0, 1])
    assert over_other.excess == pytest.approx(first.excess - second.excess)
    assert parabolas.prediction([0, 1], than=[0, 1]).scatter == 0.0


def friction_record(dip: float, seed: int = 1067) -> lw.Record:
    """A hardening spring with a damper and friction of `dip` N at small rates only, under a random force."""
    truth = oscillator("k*d + c*v + k3*d**3 + q*exp(-(v/0.1)**2)*tanh(v/0.01)", k=987.0, c=6.0, k3=4e4, q=dip)
    force = random_force(np.random.default_rng(seed), DURATION, RATE)
    clean = lw.simulate(truth, forces={"m1": force}, duration=DURATION, rate=RATE)
    return clean.with_noise(40.0, seed=seed)


TERMS = "1, d, d**2, d**3, v, v*abs(v), v*d**2, d**5"


def test_a_term_that_stands_in_for_another_in_few_blocks_is_a_runner_up() -> None:
    """Quadratic damping stands in for a dip of friction, which is not on offer; evidence leaves it in doubt."""
    discovery = lw.discover(friction_record(0.2), {"m1": 1.0}, terms=TERMS)
    assert {term.term for term in discovery.kept} == {"d", "d**3", "v"}
    assert discovery.trusted and lw.Verdict.MODEL_ERROR_NEEDED in discovery.verdicts
    [dropped] = [term for term in discovery.terms if term.term == "v*abs(v)"]
    assert dropped.decision is lw.discovery.Decision.DOUBTFUL
    [remark] = [text for text in discovery.remarks if "are predicted as well without" in text]
    [runner_up] = [model for model in discovery.runners_up if model.change == f"with {dropped.name}"]
    way = "lower" if runner_up.margin < 0.0 else "higher"
    assert (
        f"without {dropped.name}, with which the criterion would be {abs(runner_up.margin):.3g} {way}"
        in remark
    )
    [larger] = [point for point in discovery.path if point.step == f"+ {dropped.name}"]
    assert larger.criterion == pytest.approx(runner_up.margin)
    assert -larger.prediction <= larger.scatter


def test_a_selection_stays_where_a_fit_without_the_term_asks_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A spring of which the evidence is beyond doubt, dropped against the rule."""

    def without_spring(quadratic: QuadraticModel, *_: object) -> list[int]:
        return [k for k, name in enumerate(quadratic.names[:3]) if name != "m1-ground.k3"]

    record = friction_record(0.2)
    monkeypatch.setattr(inexact, "simplest_model", without_spring)
    discovery = lw.discover(record, {"m1": 1.0}, terms="d, d**3, v")
    assert {term.term for term in discovery.kept} == {"d", "d**3", "v"}


def test_exact_laws_are_left_to_the_criterion(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def counted(
        quadratic: QuadraticModel, penalty: Penalty, parabolas: BlockParabolas, inside: list[int]
    ) -> list[int]:
        asked.append(inside)
        return simplest_model(quadratic, penalty, parabolas, inside)

    monkeypatch.setattr(inexact, "simplest_model", counted)
    discovery = lw.discover(friction_record(0.0), {"m1": 1.0}, terms=TERMS)
    assert discovery.trusted and discovery.estimate.model_error == 0.0
    assert not asked
    lw.discover(friction_record(0.2), {"m1": 1.0}, terms=TERMS)
    assert asked


@pytest.mark.parametrize(
    ("criterion", "prediction", "inexact", "why"),
    [
        (19.0, -33.0, True, "its criterion is 19 higher"),
        (-6.0, -33.0, True, "disagree on its terms"),
        (19.0, -8.0, True, None),
        (19.0, -33.0, False, None),
    ],
)
def test_why_a_larger_model_that_predicts_better_was_not_selected(
    criterion: float, prediction: float, why: str | None, *, inexact: bool
) -> None:
    """The scatter is 10."""
    path = (
        lw.discovery.PathPoint(4, 0.0, 0.0, "", chosen=True, prediction=0.0, scatter=0.0),
        lw.discovery.PathPoint(5, 0.0, criterion, "+ a.k", chosen=False, prediction=prediction, scatter=10.0),
    )
    remarks = larger_model_remarks(path, inexact=inexact)
    assert len(remarks) == (why is not None)
    assert all(why in remark and "by 33 with a scatter of 10" in remark for remark in remarks if why)
