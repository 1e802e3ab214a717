"""The search in pieces at one relaxation leads where that in one piece does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import present

import linkwise as lw
from linkwise.likelihood.fit import Optimum, likelihood_fit
from linkwise.likelihood.shooting import pieces as pieces_module
from linkwise.likelihood.shooting.anneal import AnnealingFit, AnnealingSchedule, AnnealingStatus, anneal
from linkwise.likelihood.shooting.joint_search import JointEnd, JointSearch
from linkwise.likelihood.shooting.linear_model import covariance
from linkwise.likelihood.shooting.pieces import InCaller
from linkwise.progress import ProgressReport

Q = 1e-4


@pytest.fixture(scope="module")
def optimum() -> Optimum:
    """The optimum of a chaotic record, whose noise is then drawn again in part, so that the optimum is elsewhere."""
    chain = lw.bnes_chain(2)
    forces = {"m1": "60*sin(150*t) + 40*sin(190*t)"}
    record = lw.simulate(chain, duration=4.0, rate=1000.0, forces=forces).with_noise(20.0, seed=5441120)
    asked = chain.unknown("all")
    start = np.array([chain.coefficient(p.name).value for p in asked.parameters])
    found = likelihood_fit([record], asked, start).optimum
    noise = 0.3 * np.random.default_rng(3).normal(size=found.segments.samples.shape)
    samples = found.segments.samples + noise * found.scales.sigma[:, None]
    return replace(found, segments=replace(found.segments, samples=samples))


@pytest.fixture(scope="module")
def reference(optimum: Optimum) -> AnnealingFit:
    schedule = AnnealingSchedule(initial_q=Q, final_q=Q)
    fit = anneal(optimum.segments, optimum.point, optimum.scales, schedule, loss=optimum.loss)
    assert fit.status is AnnealingStatus.CONVERGED
    return fit


@pytest.fixture
def search(optimum: Optimum, monkeypatch: pytest.MonkeyPatch) -> JointSearch:
    monkeypatch.setattr(pieces_module, "_LENGTH", 200)
    return JointSearch(optimum.segments, optimum.scales, optimum.loss, InCaller())


def ended(search: JointSearch, optimum: Optimum) -> JointEnd:
    return present(search.at(Q, optimum.point, little=0.02, most=8))


def test_it_ends_at_the_same_optimum(search: JointSearch, optimum: Optimum, reference: AnnealingFit) -> None:
    end = ended(search, optimum)
    deviations = np.sqrt(reference.covariance.diagonal())
    assert end.straight and not end.interrupted
    assert np.max(np.abs(optimum.point.border - reference.point.border) / deviations) > 0.3
    assert np.max(np.abs(end.point.border - reference.point.border) / deviations) < 0.02
    assert end.cost == pytest.approx(reference.misfit.cost(Q), abs=0.02)
    free = np.ones(len(deviations), dtype=bool)
    found = np.sqrt(covariance(end.factor, search.scales, free).diagonal())
    np.testing.assert_allclose(found, deviations, rtol=0.01)  # at a point 0.02 standard errors away
    assert [step.step for step in end.path] == list(range(len(end.path)))


def test_its_cost_rises_beside_the_optimum_as_the_covariance_says(
    search: JointSearch, optimum: Optimum
) -> None:
    end = ended(search, optimum)
    root = np.linalg.cholesky(
        covariance(end.factor, search.scales, np.ones(len(optimum.scales.theta), dtype=bool))
    )
    step = np.asarray(2.0 * root[:, 0], dtype=float)
    *_, rises = search.rises_beside(end, [step, -step])
    assert np.mean(rises) == pytest.approx(4.0, rel=0.1)
    nodes = end.point.nodes + 0.02 * optimum.scales.state[:, None] * np.random.default_rng(1).normal(
        size=end.point.nodes.shape
    )
    unsettled = replace(end, point=replace(end.point, nodes=nodes))
    *_, settled = search.rises_beside(unsettled, [step, -step])
    np.testing.assert_allclose(settled, rises, atol=0.3)


class Interrupting:
    """A progress that interrupts at one of its calls."""

    def __init__(self, at: int) -> None:
        self.calls, self.at = 0, at

    def __call__(self, report: ProgressReport, /) -> None:
        self.calls += 1
        if self.calls == self.at:
            raise KeyboardInterrupt


def test_an_interrupt_ends_it_with_the_best_so_far(search: JointSearch, optimum: Optimum) -> None:
    end = ended(replace(search, progress=Interrupting(2)), optimum)
    assert end.interrupted and len(end.path) == 2
    assert end.cost < end.path[0].cost


def test_a_search_that_does_not_gain_what_was_predicted_is_not_straight(
    search: JointSearch, optimum: Optimum
) -> None:
    """From states at rest, with links so tight that the motion along the way bends within a segment."""
    start = replace(optimum.point, nodes=np.zeros_like(optimum.point.nodes))
    end = present(search.at(1e-5, start, little=0.02, most=3))
    assert not end.straight
