"""Stated values that are a little wrong, for which terms that are not there stand in."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest
from present import some
from structures import row_of_masses

import linkwise as lw
from linkwise.discovery.rivals import RivalError

FRAME = row_of_masses(
    [1.0, 0.5, 0.3],
    **{
        "m1-ground": ("k*d + k3*d**3 + c*v", {"k": 2e4, "k3": 1e7, "c": 1.0}),
        "m2-m1": ("k*d + c*v", {"k": 1.2e4, "c": 0.8}),
        "m3-m2": ("k*d + c*v", {"k": 9e3, "c": 0.5}),
    },
)
MASSES = dict(zip(FRAME.mass_names, FRAME.mass_values, strict=True))


@cache
def record() -> lw.Record:
    return lw.simulate(FRAME, release={"v:m1": 1.0}, duration=2.0, rate=1000.0)


@pytest.mark.parametrize("seed", [11, 12])
def test_right_values_have_no_rival(seed: int) -> None:
    discovery = lw.discover(record().with_noise(30.0, seed=seed), MASSES)
    assert discovery.trusted
    assert lw.discovery.term_score(discovery.structure, FRAME).exact
    assert all(term.certain for term in some(discovery.kept))
    assert not [remark for remark in discovery.remarks if "than stated" in remark]


@pytest.mark.parametrize(("mass", "factor", "message"), [("m2", 0.99, "more"), ("m3", 1.01, "less")])
def test_a_mass_that_is_stated_a_percent_wrong_is_named(mass: str, factor: float, message: str) -> None:
    """Springs that are not there were called certain, beside coefficients many standard errors off."""
    discovery = lw.discover(record().with_noise(30.0, seed=11), {**MASSES, mass: factor * MASSES[mass]})
    false = lw.discovery.term_score(discovery.structure, FRAME).extra
    assert false
    assert not [term.name for term in discovery.terms if term.certain and term.name in false]
    assert not discovery.trusted
    assert lw.Verdict.MEASUREMENT_ERROR in discovery.verdicts
    assert all(
        coefficient.standard_error is None for coefficient in some(discovery.estimate.links[0].coefficients)
    )
    named = [
        remark
        for remark in discovery.remarks
        if f"If the mass of {mass} were 1 % {message} than stated" in remark
    ]
    assert len(named) == 1
    assert all(name in named[0] for name in false)


def test_a_stiffness_that_is_stated_wrong_is_named() -> None:
    stated = FRAME.link("m2-m1")
    wrong = replace(stated, coefficients={**stated.coefficients, "k": lw.Coefficient.number(1.02 * 1.2e4)})
    noisy = record().with_noise(18.0, seed=11)  # with less noise the diagnosis of the fit tells it
    discovery = lw.discover(noisy, lw.model.PartialStructure(FRAME.masses, (wrong,)))
    assert not discovery.trusted
    assert any("If m2-m1.k were 1.9 % less than stated" in remark for remark in discovery.remarks)


@pytest.mark.parametrize(
    ("rival", "said"),
    [
        (
            RivalError("mass", "m2", 0.012, (0, 1), -25.0),
            "If the mass of m2 were 1.2 % more than stated, a.k and b.c would not be needed and the criterion would be 25 "
            "lower: check the value, or let it be unknown.",
        ),
        (
            RivalError("force gain", "force:m1", -0.03, (1,), -25.0),
            "If force:m1 were 3 % less than recorded, b.c would not be needed and the criterion would be 25 lower: check its "
            "calibration.",
        ),
        (
            RivalError("coefficient", "l.k", 0.02, (0,), 4.0),
            "This record hardly distinguishes a.k from an error of what is stated: if l.k were 2 % more than stated, the "
            "criterion would be only 4.0 higher without it.",
        ),
        (
            RivalError("mass", "m2", -0.01, (0, 1), -2.5),
            "This record hardly distinguishes a.k and b.c from an error of what is stated: if the mass of m2 were 1 % less "
            "than stated, the criterion would be 2.5 lower without them.",
        ),
    ],
)
def test_a_rival_is_told_with_what_to_do(rival: RivalError, said: str) -> None:
    assert rival.remark(("a.k", "b.c")) == said
