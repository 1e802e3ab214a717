"""Pieces of a record that do not agree on a coefficient: a term is missing that acts otherwise where the motion is smaller."""

from __future__ import annotations

from dataclasses import replace

import pytest
from problems import chain_record

import linkwise as lw
from linkwise.weak import judgement

CHAIN = lw.bnes_chain(2)


def rough(term: str, size: float) -> lw.Structure:
    """The two-mass chain with a term more in the link to the ground."""
    spring, sink = CHAIN.links
    coefficients = {**spring.coefficients, "q": lw.Coefficient.number(size)}
    law = lw.Law.parse(f"k*d + c*v + q*{term}")
    return replace(CHAIN, links=(replace(spring, law=law, coefficients=coefficients), sink))


@pytest.mark.parametrize(("term", "size", "snr_db"), [("tanh(v/0.002)", 0.2, 30.0), ("v*abs(v)", 1.0, 40.0)])
def test_damping_that_the_law_lacks_takes_trust_from_the_weak_form(
    term: str, size: float, snr_db: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The damper was 10 and 40 standard errors off, and trusted: no score tells terms that are nonlinear in the rate.

    Under wide test functions that of another term may see them; the pieces do so alone.
    """
    clean = lw.simulate(rough(term, size), release={"v:m1": 1.0}, duration=4.0, rate=1000.0)
    noisy = clean.with_noise(snr_db, seed=2)
    fit = lw.identify(noisy, CHAIN.unknown("all"), method="weak")
    assert fit.verdicts == (lw.Verdict.SYSTEMATIC_MISFIT,)
    assert fit.coefficient("spring1.c").interval is None
    monkeypatch.setattr(judgement, "significant_score", lambda *arguments: None)
    by_pieces = lw.identify(noisy, CHAIN.unknown("all"), method="weak")
    assert by_pieces.verdicts == (lw.Verdict.SYSTEMATIC_MISFIT,)
    assert "pieces of it do not agree on spring1.c" in by_pieces.message


@pytest.mark.parametrize("seed", range(3))
def test_pieces_agree_where_the_laws_are_right(seed: int) -> None:
    fit = lw.identify(chain_record(2).with_noise(20.0, seed=seed), CHAIN.unknown("all"), method="weak")
    assert fit.trusted
