"""Weak least squares: standard errors against many records, bounds, sharing, and what cannot be told."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from problems import chain_record
from structures import oscillator

import linkwise as lw
from linkwise.weak import fit as weakfit
from linkwise.weak.displacements import read_displacements
from linkwise.weak.equations import weak_equations
from linkwise.weak.fit import WeakFit, weak_fit

UNKNOWN = lw.Coefficient.unknown


def fit(record: lw.Record, structure: lw.Structure) -> WeakFit:
    return weak_fit(weak_equations(record, structure, read_displacements(record, structure)), structure)


@pytest.fixture(scope="module")
def chain() -> lw.Structure:
    return lw.bnes_chain(4)


@pytest.fixture(scope="module")
def clean() -> lw.Record:
    return chain_record(4, duration=3.0)


@pytest.mark.parametrize("decibel", [20.0, 40.0])
def test_standard_errors_of_a_linear_oscillator(decibel: float) -> None:
    """z over 60 records: rms 1 within 0.25, mean 0 within 4/sqrt(60): under three and four of their standard errors.

    Its windows cancel the motion's own frequency, so what is known of the damper comes from the ends of the record.
    """
    true = oscillator("k*d + c*v", k=1000.0, c=2.0)
    record = lw.simulate(true, release={"v:m1": 1.0}, duration=4.0, rate=1000.0)
    z = []
    for seed in range(60):
        estimate = fit(record.with_noise(decibel, seed=seed), true.unknown("all"))
        z.append((estimate.values - [1000.0, 2.0]) / np.sqrt(np.diag(estimate.covariance)))
    assert np.sqrt(np.mean(np.square(z), axis=0)) == pytest.approx([1.0, 1.0], abs=0.25)
    assert np.abs(np.mean(z, axis=0)).max() < 4 / np.sqrt(60)


def test_excess_is_one_for_a_law_that_fits(chain: lw.Structure, clean: lw.Record) -> None:
    """Over 12 records within 2 %: it is a mean over 4000 windows."""
    excesses = [fit(clean.with_noise(25.0, seed=seed), chain.unknown("all")).excess for seed in range(12)]
    assert np.mean(excesses) == pytest.approx(1.0, abs=0.02)


def test_large_and_small_structures_are_solved_alike(
    chain: lw.Structure, clean: lw.Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sparse way gives the dense way's values, and its covariances within each link."""
    record = clean.with_noise(20.0, seed=3)
    dense = fit(record, chain.unknown("all"))
    monkeypatch.setattr(weakfit, "_DENSE", 5)
    sparse = fit(record, chain.unknown("all"))
    assert sparse.values == pytest.approx(dense.values, rel=1e-8)
    links = [parameter.name.partition(".")[0] for parameter in chain.unknown("all").parameters]
    same_link = np.equal.outer(links, links)
    covariance: Any = sparse.covariance  # a sparse matrix here, an array above
    # same numerics: an inverse loses more digits than a solution
    assert covariance.toarray()[same_link] == pytest.approx(dense.covariance[same_link], rel=1e-6)
    assert not covariance.toarray()[~same_link].any()


def test_a_parameter_at_its_bound_leaves_the_others_free(clean: lw.Record, chain: lw.Structure) -> None:
    """With nes1.c held at 0.05 by its bound, the others are what they are when it is given as 0.05."""
    record = clean.with_noise(20.0, seed=1)
    free = chain.unknown("nes1")
    sink = free.link("nes1")

    def with_damper(c: lw.Coefficient) -> lw.Structure:
        return replace(
            free,
            links=tuple(
                replace(sink, coefficients={**sink.coefficients, "c": c}) if link.name == "nes1" else link
                for link in free.links
            ),
        )

    bounded = fit(record, with_damper(UNKNOWN(lower=0.05)))
    given = fit(record, with_damper(lw.Coefficient.number(0.05)))
    assert bounded.values == pytest.approx([*given.values, 0.05], rel=1e-9)  # same numerics
    assert bounded.free.tolist() == [True, True, False]
    assert not bounded.covariance[2].any() and (np.diag(bounded.covariance)[:2] > 0.0).all()


def test_a_shared_coefficient_is_told_by_both_links(clean: lw.Record, chain: lw.Structure) -> None:
    record = clean.with_noise(20.0, seed=1)
    alone = chain.unknown("nes")
    second = alone.link("nes2")
    followed = {name: lw.Coefficient.shared(f"nes1.{name}") for name in second.coefficients}
    shared = replace(
        alone,
        links=tuple(
            replace(link, coefficients=followed) if link.name == "nes2" else link for link in alone.links
        ),
    )
    single, both = fit(record, alone), fit(record, shared)
    assert len(both.values) == 3
    errors = np.sqrt(np.diag(single.covariance))
    pooled = 1.0 / np.sqrt(1.0 / errors[:3] ** 2 + 1.0 / errors[3:] ** 2)
    assert np.sqrt(np.diag(both.covariance)) == pytest.approx(
        pooled, rel=0.06
    )  # 1.2 to 2.6 % on seeds 2000 to 2005
    # three coefficients within 3.5 standard errors: wrong once in 700
    assert np.abs((both.values - [-100.0, 1e6, 0.02]) / np.sqrt(np.diag(both.covariance))).max() < 3.5


def test_terms_that_move_together_are_named() -> None:
    record = lw.simulate(oscillator("k*d", k=900.0), release={"v:m1": 1.0}, duration=1.0, rate=1000.0)
    noisy = record.with_noise(30.0, seed=1)
    with pytest.raises(
        lw.IdentificationError, match=r"cannot distinguish link\.k1, link\.k2: their terms are collinear"
    ):
        fit(noisy, oscillator("k1*d + k2*d + c*v", k1=UNKNOWN(), k2=UNKNOWN(), c=UNKNOWN()))


def test_a_term_that_was_never_reached_is_named() -> None:
    record = lw.simulate(oscillator("k*d", k=900.0), release={"v:m1": 1.0}, duration=1.0, rate=1000.0)
    law = "k*d + s*max(d - 1, 0)"
    with pytest.raises(
        lw.IdentificationError, match=r"does not determine link\.s: its term is not above the noise"
    ):
        fit(record, oscillator(law, k=UNKNOWN(), s=UNKNOWN()))


def test_without_a_scale_it_says_what_would_set_one() -> None:
    record = lw.simulate(oscillator("k*d", k=900.0), release={"v:m1": 1.0}, duration=1.0, rate=1000.0)
    with pytest.raises(
        lw.IdentificationError, match=r"nothing sets the scale of the forces.*or a channel force:MASS"
    ):
        fit(record, oscillator("k*d", mass=UNKNOWN(), k=UNKNOWN()))


def test_a_parameter_in_no_equation_names_the_missing_channel(clean: lw.Record, chain: lw.Structure) -> None:
    record = clean.select(["x:m1", "x:m2", "x:m3"])
    with pytest.raises(
        lw.IdentificationError,
        match=r"has no information on nes2\.alpha, nes2\.beta, nes2\.c: .* missing x:m4",
    ):
        fit(record, chain.unknown("nes"))
