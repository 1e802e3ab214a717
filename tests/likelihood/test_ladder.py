"""Which errors of sensors stay in the model, of those that are taken in one after another."""

from collections.abc import Sequence
from dataclasses import replace
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


@pytest.mark.parametrize("kind", ["high pass", "delay", "clock", "hum"])
def test_an_error_that_noise_of_an_input_hides_is_taken_in_before_that(kind: str) -> None:
    """Beside the noise that its channel shows, the diagnosis names another cause."""

    def answered(structure: lw.Structure, options: LikelihoodOptions, records: Sequence[lw.Record]) -> Any:
        return answer([] if options.errors and not options.random else [HIGH_PASS])

    rng, time = np.random.default_rng(2), np.arange(400) / 200.0
    force = 50.0 * (abs(time - 0.5) < 0.05) + 0.1 * rng.normal(size=len(time))
    record = lw.Record.from_arrays(time, {"a:m1": rng.normal(size=len(time)), "force:m1": force})
    first = _Model(answered, SPRING, LikelihoodOptions(), [record], answer([replace(HIGH_PASS, kind=kind)]))
    found = _with_errors(first)
    assert found.is_explained and [cause.kind for cause in found.added] == [kind]
    noisy = _with_errors(replace(first, answer=answer([replace(HIGH_PASS, kind="offset")])))
    assert noisy.added[0].kind == "input noise"
