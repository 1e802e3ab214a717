"""Searches from several sides end at one optimum, with one covariance."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from present import present
from structures import CANTILEVER, CANTILEVER_SHAPES, NES, host, link, oscillator, structure

import linkwise as lw
from linkwise.likelihood.fit import LikelihoodFit, Optimum, likelihood_fit
from linkwise.likelihood.optima.hidden_wells import fit_about_rest
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting import steps
from linkwise.likelihood.shooting.linear_model import covariance, firm_border, linear_model
from linkwise.likelihood.shooting.minimise import (
    AnnealingFit,
    AnnealingSchedule,
    AnnealingStatus,
    ChordEquations,
    anneal,
)
from linkwise.likelihood.shooting.normal_equations import Linearization, linearise
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.shooting.steps import DampedEquations, damped_step

Q = AnnealingSchedule.final_q


def chain_optimum(masses: int) -> Optimum:
    chain = lw.bnes_chain(masses)
    record = lw.simulate(chain, release={"v:m1": 2.0}, duration=2.0, rate=1000.0).with_noise(
        20.0, seed=5206910
    )
    asked = chain.unknown("all")
    start = np.array([chain.coefficient(p.name).value for p in asked.parameters])
    return likelihood_fit([record], asked, start).optimum


def noisy_again(start: Optimum, seed: int, share: float = 1.0) -> Optimum:
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
    start = noisy_again(chain_optimum(masses), 1, share=0.05)
    chords, begin = first_step(start, Q)
    end = present(chords.followed(begin, Q, 1e-3))
    monkeypatch.setattr(ChordEquations, "followed", lambda *_: None)
    reference = searched(start)
    assert reference.status is AnnealingStatus.CONVERGED
    assert end.misfit.cost(Q) < reference.misfit.cost(Q) + 5e-3
    deviations = np.sqrt(np.diag(reference.covariance))
    assert np.max(np.abs(end.misfit.point.border - reference.point.border) / deviations) < 0.05


LAW = "k*d + k3*d**3 + F*tanh(v/0.02) + c*v"
VALUES: dict[str, Any] = {"k": 3000.0, "k3": 2e9, "F": 1.5, "c": 0.1}
HITS = "80*exp(-((t - 0.02)/0.002)**2) + 60*exp(-((t - 0.17)/0.002)**2)"
TOLERANCE = 2.0 * AnnealingSchedule.tolerance  # of two searches that end at one optimum


@cache
def friction_optimum(seed: int) -> Optimum:
    """Of accelerations at 30 dB, with tight links between the segments."""
    rough = oscillator(LAW, mass=0.1, **VALUES)
    record = lw.simulate(rough, forces={"m1": HITS}, duration=0.3, rate=2000.0, sensors=["a:m1"])
    unknown = rough.unknown("all")
    fit = likelihood_fit([record.with_noise(30.0, seed=seed)], unknown, np.array(list(VALUES.values())))
    assert fit.status is AnnealingStatus.CONVERGED and fit.optimum.q == AnnealingSchedule.final_q
    return fit.optimum


def with_other_noise(start: Optimum, seed: int, initial_q: float) -> AnnealingFit:
    """The search from this optimum with another draw of the noise: the new one is about a standard error away."""
    segments = start.segments
    still = evaluate(segments, start.point, start.scales, start.loss)
    noise = np.random.default_rng(seed).normal(size=segments.samples.shape) - still.residuals
    return anneal(
        replace(segments, samples=segments.samples + segments.observed * noise * start.scales.sigma[:, None]),
        start.point,
        start.scales,
        AnnealingSchedule(initial_q=initial_q, final_q=start.q),
        loss=start.loss,
    )


@pytest.mark.parametrize("rules", ["_OF_FEW", "_OF_MANY"])
@pytest.mark.parametrize("seed", [4201, 4203])
def test_tight_links_lead_to_the_optimum_that_loose_ones_find(
    seed: int, rules: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the corrections that steps of few masses are worth, and by those of many."""
    start = friction_optimum(seed)
    monkeypatch.setattr(steps, "_OF_FEW", getattr(steps, rules))
    tight, loose = (with_other_noise(start, seed, q) for q in (start.q, 0.1))
    assert tight.status is loose.status is AnnealingStatus.CONVERGED
    assert tight.misfit.cost(start.q) < loose.misfit.cost(start.q) + TOLERANCE
    monkeypatch.setattr(steps, "_OF_FEW", replace(steps._OF_FEW, most=0))
    straight = with_other_noise(start, seed, start.q)
    # full steps are refused, and damped ones gain little
    assert straight.status is not AnnealingStatus.CONVERGED
    assert len(straight.path) > 5 * len(tight.path)
    assert straight.misfit.cost(start.q) > tight.misfit.cost(start.q) + 1.0


BLOCKS = 3


def _linear(fit: LikelihoodFit) -> Linearization:
    optimum = fit.optimum
    return linearise(optimum.segments, fit.misfit, optimum.scales, optimum.loss, blocks=BLOCKS)


def test_a_covariance_where_a_hidden_mass_rests_far_away_does_not_depend_on_rounding() -> None:
    """A coefficient that moves the well moves all nodes, by far more than the continuity of the segments lets pass."""
    sink = {"alpha": -60.0, "beta": 2e6, "c": 0.1}
    beam = host("beam", CANTILEVER, 0.01, CANTILEVER_SHAPES)
    true = structure({"sink": 0.03}, link("nes", "beam.tip-sink", NES, **sink), hosts=[beam])
    asked = structure({"sink": 0.03}, link("nes", "beam.tip-sink", NES), hosts=[beam])
    record = lw.simulate(
        true,
        forces={"beam.root": "0.3*exp(-((t - 0.1)/0.003)**2)"},
        release={"x:sink": -((60.0 / 2e6) ** 0.5)},
        duration=1.5,
        rate=1000.0,
        sensors=("a:beam.tip", "a:beam.mid", "a:beam.root"),
    ).with_noise(30.0, seed=5215301)
    fit = fit_about_rest([record], asked, LikelihoodOptions(model_error=False))
    assert fit is not None
    linear, tight, loose = _linear(fit), 1e-5, 1e-3  # both far below where the laws are loosened
    errors = [
        np.sqrt(covariance(factor, fit.optimum.scales, fit.free).diagonal())
        for factor in (linear.factor(tight), firm_border(linear, tight), firm_border(linear, loose))
    ]
    assert not np.allclose(errors[0], errors[1], rtol=0.2)  # what rounding makes of the same equations
    np.testing.assert_allclose(errors[1], errors[2], rtol=0.01)  # the noise of a loosened law
    np.testing.assert_allclose(np.sqrt(fit.covariance.diagonal()), errors[1], rtol=0.1)  # at a step before
