"""Identification by the weak form: exact motions, standard errors against many records, and what cannot be told."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from problems import chain_record
from record_faults import without
from structures import oscillator, with_links
from within import assert_within

import linkwise as lw

UNKNOWN = lw.Coefficient.unknown
RATE, SAMPLES = 1000.0, 1200
TIME = np.arange(SAMPLES) / RATE
#: A motion of two tones with its first two derivatives.
X = 0.01 * np.sin(40 * TIME) + 0.006 * np.cos(77 * TIME)
V = 0.4 * np.cos(40 * TIME) - 0.462 * np.sin(77 * TIME)
A = -16 * np.sin(40 * TIME) - 35.574 * np.cos(77 * TIME)


def identify(record: lw.Record, structure: lw.Structure) -> lw.Estimate:
    return lw.identify(record, structure, method="weak")


@pytest.fixture(scope="module")
def chain() -> lw.Structure:
    return lw.bnes_chain(4)


@pytest.fixture(scope="module")
def clean() -> lw.Record:
    return chain_record(4, duration=3.0)


@pytest.mark.parametrize(
    ("law", "values", "exact"),
    [
        ("k*d + c*v", {"k": 900.0, "c": 3.0}, 1e-6),
        ("k*d + k2*d**2 + k3*d**3 + c3*v*d**2 + f0", {"k": 900.0, "k2": 4e3, "k3": 2e6, "c3": 5e3, "f0": -0.7}, 1e-4),
        ("k*sin(d/0.02)", {"k": 9.0}, 1e-6),
        ("k*d + c*v*abs(v)", {"k": 900.0, "c": 2.0}, 1e-3),
        ("F*tanh(v/0.3)", {"F": 2.0}, 1e-3),
    ],
)  # fmt: skip
def test_the_force_that_makes_a_motion_gives_the_law(law: str, values: dict[str, Any], exact: float) -> None:
    """m x'' + f(x, x') = w is an identity, to the alias of the test functions, where v is integrated by parts.

    Where it is not, to the smoothing of v. With a force that is 1 % wrong the law is.
    """
    true = oscillator(law, mass=2.0, **values)
    force = 2.0 * A + true.links[0].force(X, V)
    record = lw.Record(0.0, RATE, ("x:m1", "force:m1"), np.stack([X, force], axis=1))
    fit = identify(record, true.unknown("link"))
    expected = [values[parameter.name.removeprefix("link.")] for parameter in fit.parameters]
    assert fit.values == pytest.approx(expected, rel=exact)
    wrong = identify(replace(record, values=record.values * [1.0, 1.01]), true.unknown("link"))
    assert np.abs(wrong.values / expected - 1.0).max() > 5e-3


def test_the_motion_of_the_base_counts() -> None:
    """x = u + d with d known: m x'' + k d = 0 asks for the u'' that gives it."""
    base = X + 2.0 * A / 800.0
    record = lw.Record(0.0, RATE, ("x:m1", "x:base"), np.stack([X, base], axis=1))
    fit = identify(record, oscillator("k*d", mass=2.0, to="base"))
    assert fit.coefficient("link.k").value == pytest.approx(800.0, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["tanh(v/0.02)", "v*abs(v)"])
def test_damping_by_the_rate_is_unbiased_where_the_motion_decays_into_noise(law: str) -> None:
    """z over 12 records: mean 0 within 4/sqrt(12), and none trusted that is 4.5 standard errors off.

    The damper and the friction were 2.7 standard errors off in the root mean square, all to the same side.
    """
    true = oscillator(f"k*d + c*v + F*{law}", k=1000.0, c=1.0, F=0.5)
    record = lw.simulate(true, release={"v:m1": 1.5}, duration=6.0, rate=1000.0)
    z = []
    for seed in range(12):
        fit = identify(record.with_noise(20.0, seed=seed), true.unknown("all"))
        assert fit.trusted, fit.message
        z.append((fit.values - [1000.0, 1.0, 0.5]) / np.sqrt(fit.covariance.diagonal()))
    assert np.abs(np.mean(z, axis=0)).max() < 4 / np.sqrt(12)
    assert np.abs(z).max() < 4.5


def test_maximum_likelihood_agrees() -> None:
    """Of a nonlinear oscillator, to three standard errors of the weak form, which sees less of the record."""
    truth = oscillator("k*d + c*v + k3*d**3", k=900.0, c=1.5, k3=2e6)
    exact = lw.simulate(truth, duration=6.0, rate=1000.0, forces={"m1": "1*sin(33*t)"})
    record, asked = exact.with_noise(30.0, seed=61), truth.unknown("all")
    weak, likeliest = identify(record, asked), lw.identify(record, asked)
    assert weak.trusted and likeliest.trusted
    assert np.abs((weak.values - likeliest.values) / np.sqrt(weak.covariance.diagonal())).max() < 3.0


@pytest.mark.slow
def test_windows_that_miss_a_sample_are_left_out(chain: lw.Structure, clean: lw.Record) -> None:
    """Whether samples are missing in a row or singly everywhere, with no stretch of 256 samples whole."""
    record = clean.with_noise(30.0, seed=1)
    whole = identify(record, chain.unknown("all"))
    for missing in (slice(1000, 1100), slice(100, None, 150)):
        fit = identify(without(record, x_m2=missing), chain.unknown("all"))
        assert_within(fit, chain)
        apart = np.abs(fit.values - whole.values) / np.sqrt(fit.covariance.diagonal())
        assert 0.0 < apart.max() < 3.0


@pytest.mark.slow
def test_a_parameter_at_its_bound_leaves_the_others_free(clean: lw.Record, chain: lw.Structure) -> None:
    """With nes1.c held at 0.05 by its bound, the others are what they are when it is given as 0.05."""
    record = clean.with_noise(20.0, seed=1)
    free = chain.unknown("nes1")
    sink = free.link("nes1")

    def with_damper(c: lw.Coefficient) -> lw.Structure:
        return with_links(free, replace(sink, coefficients={**sink.coefficients, "c": c}))

    bounded = identify(record, with_damper(UNKNOWN(lower=0.05)))
    given = identify(record, with_damper(lw.Coefficient.number(0.05)))
    assert bounded.values == pytest.approx([*given.values, 0.05], rel=1e-9)  # same numerics
    assert bounded.coefficient("nes1.c").standard_error is None


@pytest.mark.parametrize(
    ("law", "mass", "message"),
    [
        ("k1*d + k2*d + c*v", 1.0, r"cannot distinguish link\.k1, link\.k2: their terms are collinear"),
        ("k*d + s*max(d - 1, 0)", 1.0, r"does not determine link\.s: its term is not above the noise"),
        ("k*d", UNKNOWN(), r"nothing sets the scale of the forces.*or a channel force:MASS"),
    ],
)
def test_what_the_record_does_not_tell_is_named(law: str, mass: Any, message: str) -> None:
    record = lw.simulate(oscillator("k*d", k=900.0), release={"v:m1": 1.0}, duration=1.0, rate=1000.0)
    with pytest.raises(lw.IdentificationError, match=message):
        identify(record.with_noise(30.0, seed=1), oscillator(law, mass=mass))


@pytest.mark.parametrize(
    ("record", "message"),
    [
        (chain_record(2, duration=0.033), r"too short: its 34 samples give \d windows of \d+ samples, and 8"),
        (without(chain_record(2, duration=1.0), x_m1=slice(None, None, 10)), "no mass has 8 complete windows"),
        (without(chain_record(2, duration=1.0), x_m1=slice(None), x_m2=slice(None)), "too many samples are missing|no sample"),
        (
            chain_record(2, duration=1.0, sensors=("a",)),
            r"neighbours, and the record has a:m1, a:m2: give x:m1, x:m2, or map",
        ),
        (
            chain_record(2, duration=1.0).select(["x:m1"]),
            r"has no information on nes1\.alpha, nes1\.beta, nes1\.c: .* missing x:m2",
        ),
    ],
    ids=["short", "broken", "empty", "no displacements", "no sensor"],
)  # fmt: skip
def test_records_that_give_no_equations_are_refused(record: lw.Record, message: str) -> None:
    with pytest.raises(lw.LinkwiseError, match=message):
        identify(record, lw.bnes_chain(2).unknown("nes"))
