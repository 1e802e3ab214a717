"""Terms that a link lacks are seen by its load cell, too: the score test finds what a fit with the term finds."""

from __future__ import annotations

import numpy as np
import pytest
from present import present
from random_force import random_force
from structures import oscillator

import linkwise as lw

RATE, DURATION = 200.0, 10.0
CUBIC = oscillator("k*d + c*v + k3*d**3", k=987.0, c=6.0, k3=4e4)
LINEAR = oscillator("k*d + c*v", k=987.0, c=6.0).unknown("all")


@pytest.fixture(scope="module")
def clean() -> lw.Record:
    forces = {"m1": random_force(np.random.default_rng(3), DURATION, RATE)}
    return lw.simulate(CUBIC, forces=forces, duration=DURATION, rate=RATE, sensors=["x", "f"])


def noisy(clean: lw.Record, displacement: float, load: float) -> lw.Record:
    """The record with noise of these standard deviations in m and N."""
    rng = np.random.default_rng(4)
    deviations = {"x:m1": displacement, "f:link": load, "force:m1": 0.0}
    channels = {
        name: clean.channel(name) + sigma * rng.standard_normal(len(clean))
        for name, sigma in deviations.items()
    }
    return lw.Record.from_arrays(clean.time, channels)


@pytest.mark.parametrize(("displacement", "load"), [(3e-4, 0.05), (1e-3, 0.02)])
def test_a_missing_term_is_found_in_the_load_cell_as_large_as_a_fit_finds_it(
    clean: lw.Record, displacement: float, load: float
) -> None:
    """It was tested in the motion alone, and d**5 named in its place with up to half more than its force."""
    record = noisy(clean, displacement, load)
    lacking, fitted = lw.identify(record, LINEAR), lw.identify(record, CUBIC.unknown("all"))
    cause = lacking.diagnosis[0]
    assert (cause.kind, cause.where, cause.term) == ("term", "link", "d**3")
    k3, unit = fitted.coefficient("link.k3"), np.sqrt(np.mean(clean.channel("x:m1") ** 6))
    # the first order, in the motion that the wrong law follows: a term of 2 % of the force changes that by as much
    assert cause.size == pytest.approx(k3.value * unit, rel=0.03)
    assert cause.standard_error > present(k3.standard_error) * unit  # with the model error of the wrong law


def test_a_law_that_lacks_nothing_has_no_cause_in_its_load_cell(clean: lw.Record) -> None:
    fit = lw.identify(noisy(clean, 3e-4, 0.05), CUBIC.unknown("all"))
    assert fit.verdicts == (lw.Verdict.CONVERGED,) and fit.diagnosis == ()
