"""Noise that is stated too small is named as the cause; laws that lack something are not taken for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from structures import link, structure

import linkwise as lw
from linkwise.likelihood.understated_noise import beyond_statement
from linkwise.verdict import Verdict


def record_with_stated(factors: dict[str, float], chain: lw.Structure) -> lw.Record:
    """At 20 dB, with noise stated as that times these factors."""
    clean = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0)
    record = clean.with_noise(20.0, seed=5_001_301)
    true = {name: float(np.std(record.channel(name) - clean.channel(name))) for name in factors}
    noise = {name: factor * true[name] for name, factor in factors.items()}
    return replace(record, noise=noise, simulated=None)


@pytest.mark.parametrize(
    ("stated", "calibration", "verdict"),
    [
        ({"x:m1": 0.1, "x:m2": 1.0}, {}, Verdict.NOISE_MISMATCH),
        ({"x:m1": 0.1, "x:m2": 0.1}, {"all": 0.01}, Verdict.NOT_CONVERGED),
    ],
    ids=["one channel", "both, beside priors"],
)
def test_noise_stated_too_small_is_the_cause(
    stated: dict[str, float], calibration: dict[str, float], verdict: Verdict
) -> None:
    """With how far it is exceeded, by which channels, and what it is; also where the search does not converge with it."""
    chain = lw.bnes_chain(2)
    record = record_with_stated(stated, chain)
    fit = lw.identify(record, chain.unknown("nes"), method=lw.MaximumLikelihood(calibration=calibration))
    assert not fit.trusted
    assert fit.fit_verdicts == (verdict,)
    assert "it is stated too small" in fit.message and "leave it out" in fit.message
    for name, factor in stated.items():
        assert (f"times in {name}, " in fit.message) == (factor < 1.0)
    assert "10 times in x:m1" in fit.message or "9.9 times in x:m1" in fit.message


def test_laws_that_lack_a_term_are_not_taken_for_noise() -> None:
    """The same statement, without the cubic term of the sink."""
    chain = lw.bnes_chain(2)
    record = record_with_stated({"x:m1": 0.1, "x:m2": 0.1}, chain)
    linear = structure({"m1": 1.0, "m2": 0.01}, chain.links[0], link("nes1", "m2-m1", "k*d + c*v"))
    fit = lw.identify(record, linear)
    assert not fit.trusted and "stated too small" not in fit.message


def test_noise_stated_as_next_to_nothing_is_told_by_the_scatter_of_samples() -> None:
    """Nothing converges with it, and what is left is no noise: the samples themselves tell, before any law."""
    chain = lw.bnes_chain(2)
    record = record_with_stated({"x:m1": 1e-4, "x:m2": 1.0}, chain)
    fit = lw.identify(record, chain.unknown("all"))
    assert fit.fit_verdicts == (Verdict.NOT_CONVERGED,)
    assert "neighbouring samples scatter by far more" in fit.message
    assert "times in x:m1" in fit.message and "times in x:m2" not in fit.message


def test_a_force_that_scatters_and_noise_of_nothing_are_no_statement_too_small() -> None:
    """A shaker's random force changes from sample to sample by its own size."""
    rng = np.random.default_rng(5_001_302)
    channels = {"x:m1": np.sin(np.arange(2000) / 50.0), "force:m1": rng.normal(size=2000)}
    record = lw.Record.from_arrays(np.arange(2000) / 1000.0, channels)
    noise = {"force:m1": 1e-4, "x:m1": 0.0}
    assert not beyond_statement([replace(record, noise=noise)])
    shaken = replace(record, values=record.values + 0.01 * rng.normal(size=(2000, 1)), noise={"x:m1": 1e-6})
    assert "times in x:m1" in beyond_statement([shaken])
