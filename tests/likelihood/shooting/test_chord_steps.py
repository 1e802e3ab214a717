"""Chord steps lead where steps with equations of their own lead, and are not tried where they would not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import present
from problems import chain_record

import linkwise as lw
from linkwise.likelihood.fit import Optimum, likelihood_fit
from linkwise.likelihood.shooting import chord_steps as module
from linkwise.likelihood.shooting.anneal import AnnealingFit, AnnealingSchedule, AnnealingStatus, anneal
from linkwise.likelihood.shooting.chord_steps import ChordEquations
from linkwise.likelihood.shooting.damped_step import DampedEquations, damped_step
from linkwise.likelihood.shooting.linear_model import linear_model
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.starts.values import starting_values

Q = AnnealingSchedule.final_q


def optimum(masses: int) -> Optimum:
    chain = lw.bnes_chain(masses)
    record = lw.simulate(chain, release={"v:m1": 2.0}, duration=2.0, rate=1000.0).with_noise(
        20.0, seed=5206910
    )
    asked = chain.unknown("all")
    start = np.array([chain.coefficient(p.name).value for p in asked.parameters])
    return likelihood_fit([record], asked, start).optimum


def with_other_noise(start: Optimum, seed: int, share: float = 1.0) -> Optimum:
    """The same point with another draw of a share of the noise: the optimum is elsewhere."""
    noise = np.random.default_rng(seed).normal(size=start.segments.samples.shape)
    samples = start.segments.samples + share * noise * start.scales.sigma[:, None]
    return replace(start, segments=replace(start.segments, samples=samples))


def first_step(start: Optimum, q: float, damping: float = 0.0) -> tuple[ChordEquations, Misfit]:
    """The equations at a point, and the misfit behind the step to which they lead."""
    segments, scales, loss = start.segments, start.scales, start.loss
    misfit = evaluate(segments, start.point, scales, loss)
    linear = linear_model(segments, misfit, scales, loss)
    damped = DampedEquations.of(linear, q, damping)
    point, _ = present(damped_step(segments, damped, misfit, scales, 1.0))
    return ChordEquations(segments, linear, damped, misfit, scales, loss), evaluate(
        segments, point, scales, loss
    )


def searched(start: Optimum) -> AnnealingFit:
    schedule = AnnealingSchedule(initial_q=Q, tolerance=1e-3)
    return anneal(start.segments, start.point, start.scales, schedule, loss=start.loss)


@pytest.mark.parametrize("masses", [2, 10, 14])
def test_they_end_at_the_optimum_of_full_steps(masses: int, monkeypatch: pytest.MonkeyPatch) -> None:
    start = with_other_noise(optimum(masses), 1, share=0.05)
    chords, begin = first_step(start, Q)
    end = present(chords.followed(begin, Q, 1e-3))
    monkeypatch.setattr(ChordEquations, "followed", lambda *_: None)
    reference = searched(start)
    assert reference.status is AnnealingStatus.CONVERGED
    assert end.misfit.cost(Q) < reference.misfit.cost(Q) + 5e-3
    deviations = np.sqrt(np.diag(reference.covariance))
    assert np.max(np.abs(end.misfit.point.border - reference.point.border) / deviations) < 0.05


def test_equations_of_looser_links_lead_to_tight_ones() -> None:
    start = with_other_noise(optimum(10), 2, share=0.05)
    chords, begin = first_step(start, 10.0 * Q)
    end = present(chords.followed(begin, Q, 1e-3))
    assert not end.settled  # their covariance is another one
    reference = searched(start)
    assert end.misfit.cost(Q) < reference.misfit.cost(Q) + 0.1 < begin.cost(Q)


def test_equations_of_looser_links_serve_only_where_their_steps_arrive(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From half-way on, tight links would hold the search to a motion far from that of the laws."""
    start = with_other_noise(optimum(10), 2, share=0.05)
    chords, begin = first_step(start, 10.0 * Q)
    assert present(chords.followed(begin, Q, 1e-4)).left < 1e-2
    monkeypatch.setattr(module, "_MOST", 1)
    assert chords.followed(begin, Q, 1e-4) is None


def test_an_end_of_equations_nearby_counts_only_where_it_is_the_optimum() -> None:
    """A lower cost half-way there may lie behind a bend along which no linearization leads on."""
    chords, begin = first_step(with_other_noise(optimum(10), 1, share=0.05), Q)
    assert present(chords.followed(begin, Q, 1e-3)).settled
    assert chords.followed(begin, Q, 0.0) is None


@pytest.mark.parametrize(
    ("left", "remaining"),
    [
        ([], np.inf),
        ([4.0], 16.0),  # at half the distance a step: 1 / (1 - 1/2)^2 of it
        ([4.0, 1.0], 4.0),
        ([9.0, 4.0], 36.0),  # two thirds of the distance
        ([1.0, 1.0], np.inf),
        ([1.0, 2.0], np.inf),
        ([1.0, np.nan], np.inf),
    ],
)
def test_what_is_before_steps_that_come_nearer_slowly_counts(left: list[float], remaining: float) -> None:
    assert module._remaining(left) == pytest.approx(remaining, rel=1e-12)


def test_steps_that_rise_before_they_fall_spare_linearizations() -> None:
    """The flow bends in several directions more than the equations know; chords that give up early leave a dozen steps."""
    asked, record = lw.bnes_chain(20).unknown("all"), chain_record(20).with_noise(20.0, seed=5730003)
    theta, spread = starting_values([record], asked)
    path = likelihood_fit([record], asked, theta, spread=spread).path
    assert path[-1].q == Q
    assert len(path) <= 8


@pytest.mark.parametrize(("standard_errors", "settled"), [(0.2, True), (1.5, False)])
def test_equations_serve_for_a_covariance_within_half_a_standard_error(
    standard_errors: float, settled: bool
) -> None:
    """However much the defects at their point cost, which tight links multiply."""
    start = optimum(10)
    fit = searched(start)
    deviation = np.sqrt(np.diag(fit.covariance))
    moved = start.point.border + np.where(np.arange(len(deviation)) == 3, standard_errors * deviation, 0.0)
    noise = 1e-4 * np.random.default_rng(4).normal(size=start.point.nodes.shape)
    point = start.point.moved(start.point.nodes + noise * start.scales.state[:, None], moved)
    chords, begin = first_step(replace(start, point=point), Q)
    assert chords.misfit.cost(Q) - begin.cost(Q) > 0.005 * start.segments.observed.sum()
    end = present(chords.followed(begin, Q, 1e-2))
    assert end.settled == settled
    assert end.misfit.cost(Q) < fit.misfit.cost(Q) + 0.02


def test_they_are_not_tried_by_damped_or_far_equations_or_under_wrong_laws() -> None:
    start = with_other_noise(optimum(2), 3, share=0.05)
    for q, damping in ((Q, 0.1), (100.0 * Q, 0.0)):
        chords, begin = first_step(start, q, damping)
        assert chords.followed(begin, Q, 1e-3) is None
    chords, begin = first_step(with_other_noise(start, 4), Q)
    assert begin.data > 1.5 * start.segments.observed.sum()
    assert chords.followed(begin, Q, 1e-3) is None
