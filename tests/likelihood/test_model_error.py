"""The search for a model error: where it ends, and what it costs."""

from __future__ import annotations

import numpy as np
import pytest
from problems import chain_record, truth

import linkwise as lw
from linkwise.likelihood import model_error
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
