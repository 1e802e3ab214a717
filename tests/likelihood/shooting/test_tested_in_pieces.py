"""Equations with columns for what is tested: piece by piece they are those of the whole record."""

from __future__ import annotations

import numpy as np
import pytest
from present import present
from problems import chain_record

import linkwise as lw
from linkwise.likelihood import score_test
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.score_test import CandidateForce, augmented_quadratic, candidate_forces
from linkwise.likelihood.shooting import pieces as pieces_module
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.shooting.sensor_errors import SensorErrors
from linkwise.model.law import Law

SAME = 1e-6  # of the roots of diagonal entries: sensitivities are in single precision, summed in other parts


@pytest.mark.parametrize("with_errors", [False, True])
def test_they_are_those_of_the_whole(with_errors: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    chain = lw.bnes_chain(2)
    asked = chain.unknown("all")
    record = chain_record(2, duration=2.0).with_noise(20.0, seed=5441130)
    start = np.array([chain.coefficient(p.name).value for p in asked.parameters])
    optimum = likelihood_fit([record], asked, start).optimum
    misfit = evaluate(optimum.segments, optimum.point, optimum.scales, optimum.loss)
    forces = [CandidateForce(0, -1, Law.parse("d**3")), CandidateForce(1, 0, Law.parse("v*abs(v)"))]
    candidates, _ = candidate_forces(optimum, misfit, forces)
    errors = SensorErrors.of(optimum.segments, misfit) if with_errors else None
    whole = augmented_quadratic(optimum, misfit, candidates, errors)

    monkeypatch.setattr(pieces_module, "_LENGTH", 70)
    monkeypatch.setattr(score_test, "is_long", lambda segments: True)
    linear_models: list[object] = []
    monkeypatch.setattr(score_test, "linear_model", linear_models.append)
    in_pieces = augmented_quadratic(optimum, misfit, candidates, errors)
    assert not linear_models
    size = np.sqrt(whole.curvature.diagonal())
    np.testing.assert_allclose(
        in_pieces.curvature / np.outer(size, size),
        whole.curvature / np.outer(size, size),
        rtol=0.0,
        atol=SAME,
    )
    np.testing.assert_allclose(in_pieces.slope / size, whole.slope / size, rtol=0.0, atol=1e-3)
    assert present(in_pieces).growth == pytest.approx(whole.growth, rel=1e-6)
