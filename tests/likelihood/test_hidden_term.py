"""What a judgement says of a term that the model error hides."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import pytest

import linkwise as lw
from linkwise.estimates.causes import Cause
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.held_closer import HiddenTerm
from linkwise.likelihood.judgement import _with_hidden_term

CAUSE = Cause("term", "spring", 0.2, "N", 40.0, 0.01, term="d**3", shift=3.0, shifted="spring.k")


@pytest.mark.parametrize(
    ("shifted", "change", "said"),
    [
        ("spring.k", 0.1, "by 40, and change spring.k by 10 %. "),
        ("", 0.0, "by 40. "),
        ("spring.k", 0.0, "by 40. "),
    ],
)
def test_a_hidden_term_names_the_coefficient_that_it_changes_and_none_else(
    shifted: str, change: float, said: str
) -> None:
    fit = cast(LikelihoodFit, SimpleNamespace(model_error=0.0, random_forces=()))
    hidden = HiddenTerm(replace(CAUSE, shifted=shifted), change, 3.0, fit)
    verdict, message = _with_hidden_term(fit, lw.Verdict.CONVERGED, "", hidden)
    assert verdict is lw.Verdict.SYSTEMATIC_MISFIT
    assert f"would lower -2 log likelihood {said}Intervals would" in message
