"""Fits from several starts: one whose motion is not finite does not end the others, and short searches put them in order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import some
from structures import oscillator

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.anneal import AnnealingStatus
from linkwise.likelihood.starts.memory import Valley
from linkwise.likelihood.valleys import (
    SearchFrom,
    Stages,
    fit_from_free_runs,
    fit_from_valleys,
    fit_in_stages,
)

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


def staged(attempt: SearchFrom, glance: SearchFrom, finish: SearchFrom = search) -> Stages:
    return Stages(
        lambda values, _number, _count: glance(values), attempt, lambda values, _nodes: finish(values)
    )


def few_steps(values: Floats) -> LikelihoodFit:
    if values[0] < 0.0:
        raise lw.IdentificationError("the motion runs to infinity")
    record = lw.simulate(TRULY, release={"v:m1": 1.0}, duration=2.0, rate=100.0).with_noise(30.0, seed=1)
    return likelihood_fit([record], TRULY.unknown("all"), values, options=LikelihoodOptions(steps=1))


def test_the_search_begins_where_a_glance_leaves_least() -> None:
    """The misfit of their forces says little where these are known roughly: the near one has the largest here."""
    searched: list[float] = []

    def attempt(values: Floats) -> LikelihoodFit:
        searched.append(float(values[0]))
        return search(values)

    starts = [
        Valley(factor * TRUE, misfit)
        for factor, misfit in ((4.0, 0.1), (3.0, 0.11), (-1.0, 0.12), (1.01, 0.13))
    ]
    fit = fit_in_stages(staged(attempt, few_steps), starts)
    assert searched == [1.01 * TRUE[0]]
    assert fit.status is AnnealingStatus.CONVERGED


def test_attempts_that_do_not_end_are_tried_again_from_their_parameters() -> None:
    """The states of the records lead on with parameters that are nearly right."""
    searched: list[float] = []

    def attempt(values: Floats) -> LikelihoodFit:
        searched.append(float(values[0]))
        fit = search(values)
        return fit if len(searched) == 4 else replace(fit, status=AnnealingStatus.STUCK)

    starts = [Valley(factor * TRUE, 0.1) for factor in (1.01, 1.02, 1.03)]
    fit = fit_in_stages(staged(attempt, few_steps), starts)
    assert len(searched) == 4
    assert searched[3] == pytest.approx(search(TRUE).values[0], rel=1e-3)
    assert fit.status is AnnealingStatus.CONVERGED


def test_the_best_attempts_are_searched_to_their_ends_where_none_explains() -> None:
    finished = []

    def attempt(values: Floats) -> LikelihoodFit:
        return replace(search(values), status=AnnealingStatus.EXHAUSTED)

    def finish(values: Floats) -> LikelihoodFit:
        finished.append(values)
        return replace(search(values), chi_square_off=True)

    starts = [Valley(factor * TRUE, 0.1) for factor in (1.01, 1.02, 1.03, 1.04)]
    fit = fit_in_stages(staged(attempt, few_steps, finish), starts)
    assert len(finished) == 2
    assert fit.status is AnnealingStatus.CONVERGED


def test_no_finite_start_of_several_is_told() -> None:
    with pytest.raises(lw.IdentificationError, match="runs to infinity"):
        fit_in_stages(staged(search, few_steps), [Valley(-TRUE, 0.1), Valley(-2.0 * TRUE, 0.2)])


def test_an_interrupt_ends_the_search_with_the_best_so_far() -> None:
    searched, glanced = [], []

    def interrupted(values: Floats) -> LikelihoodFit:
        glanced.append(values)
        return replace(few_steps(values), status=AnnealingStatus.INTERRUPTED)

    def attempt(values: Floats) -> LikelihoodFit:
        searched.append(values)
        status = AnnealingStatus.EXHAUSTED if len(searched) == 1 else AnnealingStatus.INTERRUPTED
        return replace(search(values), status=status)

    starts = [Valley(factor * TRUE, 0.1) for factor in (1.01, 1.02, 1.03)]
    fit = fit_in_stages(staged(attempt, interrupted), starts)
    assert fit.status is AnnealingStatus.INTERRUPTED
    assert (len(glanced), len(searched)) == (1, 0)
    fit_in_stages(staged(attempt, few_steps), starts)
    assert len(searched) == 2


def test_glances_are_a_small_part_of_the_progress() -> None:
    reports: list[lw.estimates.ProgressReport] = []
    record = lw.simulate(TRULY, release={"v:m1": 1.0}, duration=2.0, rate=100.0).with_noise(30.0, seed=1)
    stages = Stages.of([record], TRULY.unknown("all"), LikelihoodOptions(progress=reports.append))
    fit_in_stages(stages, [Valley(factor * TRUE, 0.1) for factor in (1.3, 1.01)])
    fractions = [report.fraction for report in reports]
    glances = [report.fraction for report in some(reports) if report.activity.startswith("start ")]
    assert max(glances) <= 0.1
    assert fractions == sorted(fractions)
    assert fractions[-1] == pytest.approx(1.0)


def test_free_runs_that_come_near_lead_to_the_fit() -> None:
    stages = staged(search, search)
    found = fit_from_free_runs(stages, Valley(1.01 * TRUE, 0.01), None)
    assert found is not None
    assert found.values == pytest.approx(search(1.01 * TRUE).values, rel=1e-9)  # the same search


def test_free_runs_that_stay_away_or_run_to_infinity_lead_nowhere() -> None:
    stages = staged(search, search)
    assert fit_from_free_runs(stages, Valley(1.01 * TRUE, 0.6), None) is None
    assert fit_from_free_runs(stages, Valley(-TRUE, 0.01), None) is None


def test_an_inexact_fit_is_taken_only_where_free_runs_came_close() -> None:
    """It may be of another valley where they did not."""

    def inexact(values: Floats) -> LikelihoodFit:
        return replace(search(values), model_error=0.1)

    stages = staged(inexact, search, inexact)
    assert fit_from_free_runs(stages, Valley(TRUE, 0.2), None) is None
    assert some([fit_from_free_runs(stages, Valley(TRUE, 0.05), None)])[0] is not None
