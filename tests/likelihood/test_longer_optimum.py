"""Score tests in longer segments: those of short ones, at a part of the cost."""

from __future__ import annotations

import numpy as np
import pytest
from problems import chain_record

import linkwise as lw
from linkwise.likelihood import diagnosis
from linkwise.likelihood.fit import LikelihoodFit, Optimum, likelihood_fit
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.single_tests import SingleTests, single_tests
from linkwise.likelihood.starts.values import starting_values


def in_short_segments(fit: LikelihoodFit) -> tuple[Optimum, Misfit]:
    return fit.optimum, fit.misfit


@pytest.mark.parametrize("masses", [2, 4])
def test_score_tests_are_those_of_short_segments(monkeypatch: pytest.MonkeyPatch, masses: int) -> None:
    """Gains to within a hundredth of what chance gives them, sizes and deviations to a tenth of the latter.

    Of causes that hardly differ from coefficients, single precision leaves no more.
    """
    record = chain_record(masses, duration=2.0).with_noise(25.0, seed=71)
    asked = lw.bnes_chain(masses).unknown("all")
    theta, spread = starting_values([record], asked, None)
    fit = likelihood_fit([record], asked, theta, spread=spread)
    assert fit.model_error == 0.0
    values = {p.name: float(v) for p, v in zip(asked.parameters, fit.values, strict=True)}

    def tests() -> tuple[SingleTests, int]:
        tested = diagnosis.tested_causes(fit, asked.with_values(values), record.channels, terms=False)
        of_each = single_tests(tested.curvature, tested.slope, tested.scatter, len(theta))
        return of_each, tested.errors.values.shape[-1]

    longer, few = tests()
    monkeypatch.setattr(diagnosis, "in_longer_segments", in_short_segments)
    short, many = tests()
    assert few == -(-many // 4)
    assert np.max(np.abs(longer.gains - short.gains)) < 0.02
    assert np.max(np.abs(longer.sizes - short.sizes) / short.deviations) < 0.1
    assert np.max(np.abs(longer.deviations / short.deviations - 1.0)) < 0.1
