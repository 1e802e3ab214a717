"""Searches that are taken up again where they ended before they converged."""

from __future__ import annotations

from dataclasses import replace

import pytest
from problems import chain_record

import linkwise as lw
import linkwise.likelihood.fit as likelihood_fit_module
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.problem import ShootingProblem
from linkwise.likelihood.search import searched
from linkwise.likelihood.shooting.anneal import Annealer, AnnealingFit, AnnealingSchedule, AnnealingStatus
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments

EXHAUSTED, CONVERGED = AnnealingStatus.EXHAUSTED, AnnealingStatus.CONVERGED


class EndingAs:
    """Searches that end with the statuses `ends` in turn, their residuals `excess` times what they are in power."""

    def __init__(self, annealer: Annealer, ends: list[tuple[AnnealingStatus, float]]) -> None:
        self.annealer, self.loss, self.ends = annealer, annealer.loss, ends

    def __call__(
        self, segments: Segments, start: Iterate, scales: Scales, schedule: AnnealingSchedule
    ) -> AnnealingFit:
        fit = self.annealer(segments, start, scales, schedule)
        if not self.ends:
            return fit
        status, excess = self.ends.pop(0)
        misfit = replace(fit.misfit, data=excess * fit.misfit.data)
        return replace(fit, status=status, misfit=misfit, chi_square=excess * fit.chi_square)


@pytest.mark.parametrize(
    ("second", "excess"),
    [
        ((EXHAUSTED, 1.8), 1.3),
        ((EXHAUSTED, 1.1), 1.1),
        ((CONVERGED, 1.4), 1.4),
        ((AnnealingStatus.INTERRUPTED, 1.8), 1.3),
        ((AnnealingStatus.INTERRUPTED, 1.1), 1.1),
    ],
)
def test_the_better_of_two_searches_is_the_result(
    second: tuple[AnnealingStatus, float], excess: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that converged, else the one with the lower cost; an interrupt stays one."""
    results: list[AnnealingFit] = []

    def ending(
        problem: ShootingProblem, spread: object, options: LikelihoodOptions, annealer: Annealer
    ) -> tuple[Segments, Iterate, AnnealingFit, float]:
        wrapped = EndingAs(annealer, [(EXHAUSTED, 1.3), second])
        found = searched(problem, spread, options, wrapped)  # type: ignore[arg-type]
        results.append(found[2])
        return found

    monkeypatch.setattr(likelihood_fit_module, "searched", ending)
    record = chain_record(2, duration=1.0).with_noise(30.0, seed=21)
    lw.identify(record, lw.bnes_chain(2).unknown("nes1.alpha"))
    fit = results[0]
    assert fit.status is second[0]
    assert fit.misfit.data / fit.samples == pytest.approx(excess, rel=0.1)  # whose own chi-square is 1
