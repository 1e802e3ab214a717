"""Fits from several starts: one whose motion is not finite does not end the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from structures import oscillator

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.anneal import AnnealingStatus
from linkwise.likelihood.starts.memory import Valley
from linkwise.likelihood.valleys import fit_from_valleys

TRUE = np.array([400.0, 1.0])
TRULY = oscillator("k*d + c*v", mass=1.0, k=400.0, c=1.0)


def search(values: Floats) -> LikelihoodFit:
    if values[0] < 0.0:
        raise lw.IdentificationError("the motion runs to infinity")
    record = lw.simulate(TRULY, release={"v:m1": 1.0}, duration=2.0, rate=100.0).with_noise(30.0, seed=1)
    return likelihood_fit([record], TRULY.unknown("all"), values)


def test_a_start_that_runs_to_infinity_leaves_the_others() -> None:
    found = fit_from_valleys(search, [Valley(-TRUE, 0.1), Valley(1.01 * TRUE, 0.2)])
    assert found.values == pytest.approx(search(1.01 * TRUE).values, rel=1e-9)  # the same search


def test_no_finite_start_is_told() -> None:
    with pytest.raises(lw.IdentificationError, match="runs to infinity"):
        fit_from_valleys(search, [Valley(-TRUE, 0.1), Valley(-2.0 * TRUE, 0.2)])


def test_a_glance_puts_the_starts_after_the_first_in_order() -> None:
    """The misfit of their forces says little where these are known roughly: the near one has the largest here."""
    searched: list[float] = []

    def from_near(values: Floats) -> LikelihoodFit:
        searched.append(float(values[0]))
        fit = search(values)
        return (
            fit if abs(values[0] / TRUE[0] - 1.0) < 0.05 else replace(fit, status=AnnealingStatus.EXHAUSTED)
        )

    def glance(values: Floats) -> LikelihoodFit:
        record = lw.simulate(TRULY, release={"v:m1": 1.0}, duration=2.0, rate=100.0).with_noise(30.0, seed=1)
        return likelihood_fit([record], TRULY.unknown("all"), values, options=LikelihoodOptions(steps=1))

    starts = [
        Valley(factor * TRUE, misfit)
        for factor, misfit in ((4.0, 0.1), (3.0, 0.11), (-1.0, 0.12), (1.01, 0.13))
    ]
    fit = fit_from_valleys(from_near, starts, glance=glance)
    assert searched == [4.0 * TRUE[0], 1.01 * TRUE[0]]
    assert fit.status is AnnealingStatus.CONVERGED


def test_an_interrupt_at_a_glance_ends_the_search_with_the_best_so_far() -> None:
    searched, glanced = [], []

    def from_far(values: Floats) -> LikelihoodFit:
        searched.append(values)
        return replace(search(values), status=AnnealingStatus.EXHAUSTED)

    def glance(values: Floats) -> LikelihoodFit:
        glanced.append(values)
        return replace(search(values), status=AnnealingStatus.INTERRUPTED)

    starts = [Valley(factor * TRUE, 0.1) for factor in (1.01, 1.02, 1.03)]
    fit = fit_from_valleys(from_far, starts, glance=glance)
    assert len(searched) == len(glanced) == 1
    assert fit.status is AnnealingStatus.EXHAUSTED
