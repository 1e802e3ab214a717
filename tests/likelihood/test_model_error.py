"""The search for a model error: where it ends, and what it costs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy
from present import present
from problems import chain_record, truth
from random_force import random_force
from structures import oscillator

import linkwise as lw
from linkwise.likelihood import explained_fit, model_error
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.anneal import AnnealingStatus
from linkwise.progress import ProgressReport


def refitted(reports: list[ProgressReport]) -> tuple[LikelihoodFit, LikelihoodFit]:
    """A fit of the right laws, and one that is led astray at first: wrong states and values, and one step to mend them."""
    chain = lw.bnes_chain(2)
    unknown = chain.unknown("all")
    record = chain_record(2, duration=1.0).with_noise(30.0, seed=4400)
    theta = truth(chain, unknown)
    exact = likelihood_fit([record], unknown, theta)
    options = LikelihoodOptions(steps=1, nodes=0.5 * exact.optimum.point.nodes, progress=reports.append)
    return exact, likelihood_fit([record], unknown, 1.3 * theta, options=options)


def test_a_search_for_a_model_error_ends_where_the_laws_are_exact() -> None:
    reports: list[ProgressReport] = []
    exact, fit = refitted(reports)
    assert fit.status is AnnealingStatus.CONVERGED and not fit.chi_square_off
    assert fit.model_error == 0.0
    errors = np.sqrt(exact.covariance.diagonal())
    # both searches end where 0.02 of -2 log likelihood is left, a distance of 0.14 standard errors
    assert np.max(np.abs(fit.values - exact.values) / errors) < 0.3
    assert np.sqrt(fit.covariance.diagonal()) == pytest.approx(errors, rel=0.01)
    assert len(reports) < 28  # steps; 30 where it goes on to errors that nothing shows


def test_a_search_for_a_model_error_that_creeps_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_error, "_MOST_STEPS", 10)
    reports: list[ProgressReport] = []
    _, fit = refitted(reports)
    assert fit.status is AnnealingStatus.EXHAUSTED  # told as not converged
    assert len(reports) < 15


@pytest.fixture(scope="module")
def dragged() -> tuple[lw.Record, lw.Structure]:
    """An oscillator with drag under a random force, 70 dB, and laws without the drag."""
    rate, duration = 100.0, 100.0
    force = random_force(np.random.default_rng(11), duration, rate, rms=4.0)
    with_drag = oscillator("k*d + c*v + k3*d**3 + q*v*abs(v)", k=400.0, c=1.0, k3=1e5, q=0.05)
    record = lw.simulate(with_drag, forces={"m1": force}, duration=duration, rate=rate)
    without = oscillator("k*d + c*v + k3*d**3", k=400.0, c=1.0, k3=1e5)
    return record.with_noise(70.0, seed=11), without.unknown("all")


def filtered(record: lw.Record) -> lw.Record:
    """All channels through the same low-pass filter at 0.6 of the Nyquist frequency."""
    filter_ = scipy.signal.butter(2, 0.6, output="sos")
    return replace(record, values=scipy.signal.sosfilt(filter_, record.values, axis=0))


def test_small_coloured_residuals_of_inexact_laws_are_judged_by_blocks(
    dragged: tuple[lw.Record, lw.Structure],
) -> None:
    """Filters leave residuals above the noise of their stop band; at 0.5 % of the motion they decide nothing by themselves."""
    record, structure = dragged
    whole, seen = lw.identify(record, structure), lw.identify(filtered(record), structure)
    assert whole.trusted and seen.trusted and present(seen.chi_square_per_sample) > 2.0
    z = (seen.values - whole.values) / np.sqrt(seen.covariance.diagonal())
    assert np.max(np.abs(z)) < 3.0


def test_large_coloured_residuals_of_inexact_laws_take_trust(
    dragged: tuple[lw.Record, lw.Structure], monkeypatch: pytest.MonkeyPatch
) -> None:
    record, structure = dragged
    monkeypatch.setattr(explained_fit, "_SMALL", 1e-4)
    fit = lw.identify(filtered(record), structure)
    assert fit.verdicts == (lw.Verdict.NOISE_MISMATCH,)
