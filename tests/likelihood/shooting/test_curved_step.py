"""Steps along the curvature of the flow: friction that bends within a part of a sample, beside the optimum."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from structures import oscillator

import linkwise as lw
from linkwise.likelihood.fit import Optimum, likelihood_fit
from linkwise.likelihood.shooting import curved_step
from linkwise.likelihood.shooting.anneal import AnnealingFit, AnnealingSchedule, AnnealingStatus, anneal
from linkwise.likelihood.shooting.residuals import evaluate

LAW = "k*d + k3*d**3 + F*tanh(v/0.02) + c*v"
VALUES: dict[str, Any] = {"k": 3000.0, "k3": 2e9, "F": 1.5, "c": 0.1}
HITS = "80*exp(-((t - 0.02)/0.002)**2) + 60*exp(-((t - 0.17)/0.002)**2)"
TOLERANCE = 2.0 * AnnealingSchedule.tolerance  # of two searches that end at one optimum


@cache
def optimum(seed: int) -> Optimum:
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
    start = optimum(seed)
    monkeypatch.setattr(curved_step, "_OF_FEW", getattr(curved_step, rules))
    tight, loose = (with_other_noise(start, seed, q) for q in (start.q, 0.1))
    assert tight.status is loose.status is AnnealingStatus.CONVERGED
    assert tight.misfit.cost(start.q) < loose.misfit.cost(start.q) + TOLERANCE
    monkeypatch.setattr(curved_step, "_OF_FEW", replace(curved_step._OF_FEW, most=0))
    straight = with_other_noise(start, seed, start.q)
    assert (
        straight.status is not AnnealingStatus.CONVERGED
    )  # full steps are refused, and damped ones gain little
    assert len(straight.path) > 5 * len(tight.path)
    assert straight.misfit.cost(start.q) > tight.misfit.cost(start.q) + 1.0
