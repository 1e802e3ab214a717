"""Long records are searched and tested in pieces: the same answer as that of the whole, or none."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from present import present
from problems import chain_record, truth

import linkwise as lw
from linkwise.likelihood import marginal as module
from linkwise.likelihood import search as search_module
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.marginal import is_long
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting import pieces as pieces_module
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.likelihood.shooting.residuals import SensorErrors, evaluate
from linkwise.likelihood.tests import score_test
from linkwise.likelihood.tests.score_test import CandidateForce, augmented_quadratic, candidate_forces
from linkwise.model.law import Law
from linkwise.progress import ProgressReport

CHAIN = lw.bnes_chain(2)
ASKED = CHAIN.unknown("all")
RATE = 1000.0


def driven(samples: int, seed: int, snr_db: float = 20.0) -> lw.Record:
    """The chain of two masses, driven chaotically over its sink's barrier."""
    forces = {"m1": "60*sin(150*t) + 40*sin(190*t)"}
    record = lw.simulate(CHAIN, duration=samples / RATE, rate=RATE, forces=forces)
    return record.with_noise(snr_db, seed=seed)


def fitted(record: lw.Record, options: LikelihoodOptions | None = None) -> LikelihoodFit:
    start = truth(CHAIN, ASKED)
    return likelihood_fit([record], ASKED, start, spread=1e-3 * np.abs(start), options=options)


@pytest.fixture(scope="module", autouse=True)
def short_ones_as_long() -> Iterator[None]:
    """Records a fifth as long as others are taken for long ones, in shorter pieces."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(module, "_LONG", 1_600)
        patched.setattr(module, "_OVERLAP", 200)
        patched.setattr(pieces_module, "_LENGTH", 400)
        yield


@pytest.fixture(scope="module")
def record() -> lw.Record:
    return driven(10_000, 5441140)


@pytest.fixture(scope="module")
def in_pieces(record: lw.Record) -> LikelihoodFit:
    return fitted(record)


def test_the_answer_is_that_of_a_search_of_the_whole(
    record: lw.Record, in_pieces: LikelihoodFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert is_long(in_pieces.segments) and in_pieces.status is AnnealingStatus.CONVERGED
    monkeypatch.setattr(search_module, "is_long", lambda segments: False)
    q = in_pieces.optimum.q
    options = LikelihoodOptions(
        nodes=in_pieces.optimum.point.nodes, relaxation=q, tightest=q, model_error=False, coloured_noise=False
    )
    whole = fitted(record, options)
    deviations = np.sqrt(whole.covariance.diagonal())
    assert whole.status is AnnealingStatus.CONVERGED and whole.optimum.q == q
    assert np.max(np.abs(in_pieces.values - whole.values) / deviations) < 0.05
    np.testing.assert_allclose(np.sqrt(in_pieces.covariance.diagonal()), deviations, rtol=0.01)
    cost = in_pieces.chi_square * in_pieces.segments.observed.sum()
    assert cost == pytest.approx(whole.chi_square * whole.segments.observed.sum(), abs=0.25)  # in five pieces


def test_values_are_as_far_off_as_their_errors_say(in_pieces: LikelihoodFit) -> None:
    off = in_pieces.values - truth(CHAIN, ASKED)
    square = off @ np.linalg.solve(in_pieces.covariance, off)
    assert 0.2 < square < 20.5  # chi-square with five degrees of freedom, one in a thousand on either side


def test_short_records_are_not_searched_so() -> None:
    record = driven(2_000, 5441141)
    assert not is_long(fitted(record).segments)


class Interrupting:
    """A progress that interrupts at the first report of an activity."""

    def __init__(self, activity: str) -> None:
        self.activity, self.done = activity, False

    def __call__(self, report: ProgressReport, /) -> None:
        if self.activity in report.activity and not self.done:
            self.done = True
            raise KeyboardInterrupt


@pytest.mark.parametrize("activity", ["q 1e-03", "states, piece 2", "q 3e-04"])
def test_an_interrupt_ends_it_with_the_best_so_far(record: lw.Record, activity: str) -> None:
    fit = fitted(record, LikelihoodOptions(progress=Interrupting(activity)))
    assert fit.status is AnnealingStatus.INTERRUPTED
    assert fit.chi_square < 1e6 and np.isfinite(fit.values).all() and fit.has_errors


def test_progress_rises_and_names_the_pieces(record: lw.Record) -> None:
    reports: list[ProgressReport] = []
    fitted(record, LikelihoodOptions(progress=reports.append))
    fractions = [report.fraction for report in reports]
    assert fractions == sorted(fractions) and fractions[-1] > 0.6
    assert sum("states, piece" in report.activity for report in reports) > 2


SAME = 1e-6  # of the roots of diagonal entries: sensitivities are in single precision, summed in other parts


@pytest.mark.parametrize("with_errors", [False, True])
def test_they_are_those_of_the_whole(with_errors: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    chain = lw.bnes_chain(2)
    asked = chain.unknown("all")
    record = chain_record(2, duration=2.0).with_noise(20.0, seed=5441130)
    start = np.array([chain.coefficient(p.name).value for p in asked.parameters])
    monkeypatch.setattr(search_module, "is_long", lambda segments: False)
    optimum = likelihood_fit([record], asked, start).optimum
    misfit = evaluate(optimum.segments, optimum.point, optimum.scales, optimum.loss)
    forces = [CandidateForce(0, -1, Law.parse("d**3")), CandidateForce(1, 0, Law.parse("v*abs(v)"))]
    candidates, _ = candidate_forces(optimum, misfit, forces)
    errors = SensorErrors.of(optimum.segments, misfit) if with_errors else None
    monkeypatch.setattr(score_test, "is_long", lambda segments: False)
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
