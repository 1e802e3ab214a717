"""Which errors of sensors stay in the model, of those that are taken in one after another."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from structures import oscillator

import linkwise as lw
from linkwise.estimates.causes import Cause
from linkwise.likelihood.explained import _Model, _with_errors
from linkwise.likelihood.options import LikelihoodOptions

SPRING = oscillator("k*d + c*v", name="s", k=1000.0, c=1.0)
DELAY, HIGH_PASS = (
    Cause(kind, "a:m1", 1e-3, "", gain, 1e-4) for kind, gain in (("delay", 90.0), ("high pass", 60.0))
)


def answer(left: Sequence[Cause], chi_square: float = 1.0) -> Any:
    return SimpleNamespace(
        diagnosis=left,
        grade=lw.Grade.APPROXIMATE if left else lw.Grade.EXPLAINED,
        given_structure=SPRING,
        chi_square_per_sample=chi_square,
        samples=100,
    )


@pytest.mark.parametrize(
    ("alone", "kept"),
    [
        (answer([]), ["high pass"]),
        (answer([DELAY]), ["delay", "high pass"]),
        (answer([], 1.2), ["delay", "high pass"]),
    ],
)
def test_an_error_that_stood_for_the_one_behind_it_is_taken_out_again(alone: Any, kept: list[str]) -> None:
    """Where that alone leaves noise, and as little."""

    def answered(structure: lw.Structure, options: LikelihoodOptions, records: Sequence[lw.Record]) -> Any:
        kinds = {error.kind for error in options.errors}
        if kinds == {"high pass"}:
            return alone
        return answer([]) if len(kinds) == 2 else answer([HIGH_PASS])

    record = lw.Record(0.0, 100.0, ("a:m1",), np.random.default_rng(1).normal(size=(200, 1)))
    first = _Model(answered, SPRING, LikelihoodOptions(), [record], answer([DELAY]))
    assert [cause.kind for cause in _with_errors(first).added] == kept
