"""Every problem by every method that gives intervals."""

import numpy as np
import pytest
from problems import PROBLEMS, Problem
from structures import link, with_links

import linkwise as lw

FARTHEST = 4.5  # standard errors: the largest of 30 normal errors is beyond once in 5000 seeds


@pytest.mark.slow
@pytest.mark.parametrize("problem", PROBLEMS.values(), ids=PROBLEMS)
def test_both_methods_find_the_coefficients_and_likelihood_is_the_sharper(problem: Problem) -> None:
    """Their difference scatters by less than the error of the weak form, since the likelihood uses all that it uses."""
    record, unknown = problem.record(seed=13), problem.unknown_structure
    likelihood, weak = lw.identify(record, unknown), lw.identify(record, unknown, method="weak")
    for fit in (likelihood, weak):
        assert fit.trusted, fit.explanation
        assert len(fit.values) >= 3 and np.max(np.abs(problem.errors(fit))) < FARTHEST
    deviation = np.sqrt(weak.covariance.diagonal())
    assert np.all(np.abs(likelihood.values - weak.values) < FARTHEST * deviation)
    # 10 %: errors of their estimate
    assert np.all(np.sqrt(likelihood.covariance.diagonal()) < 1.1 * deviation)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two masses, 20 dB", "base moved", "masses unknown, a force applied"])
def test_a_linear_law_in_place_of_the_last_one_is_not_trusted(name: str) -> None:
    """Beside what must be accepted, one that must not."""
    problem = PROBLEMS[name]
    unknown_structure = problem.unknown_structure
    last = unknown_structure.links[-1]
    unknown = lw.Coefficient.unknown(start=1.0)
    linear = link(last.name, "-".join(last.between), "k*d + c*v", k=unknown, c=unknown)
    fit = lw.identify(problem.record(seed=13), with_links(unknown_structure, linear))
    assert not fit.trusted and fit.verdicts[0].forbids
