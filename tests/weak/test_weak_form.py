"""The weak form of a law: which kernel meets which function, and what noise does not do to it any more."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from linkwise.model.law import Law
from linkwise.weak.weak_form import PHI, PHI_1, WeakLaw, weak_law

S = 0.3


def chains(weak: WeakLaw, d: np.ndarray, variance: float, **values: float) -> list[list[np.ndarray]]:
    """h, h', h'', ... of every part at `d` (N,)."""
    given = {name: np.array([[values.get(name, np.nan)]]) for name in weak.law.coefficients}
    evaluated = weak.evaluate(d[None], 0.0, np.array([[variance]]), given)
    return [
        [
            factor * np.broadcast_to(array, (1, len(d)))[0]
            for factor, array in zip(factors, chain, strict=True)
        ]
        for factors, chain in zip(weak.factors, evaluated, strict=True)
    ]


def test_rates_are_integrated_by_parts_where_that_is_possible() -> None:
    """v g(d) meets phi' as -G(d); what is curved in v stays under phi."""
    law = Law.parse("k*d + c*v + c3*v*d**2 + q*v**2 + p*v*exp(-d**2)")
    parts = {part.coefficient: part for part in weak_law(law, frozenset()).parts}
    assert {name: part.kernel for name, part in parts.items()} == {
        "k": PHI,
        "c": PHI_1,
        "c3": PHI_1,
        "q": PHI,
        "p": PHI,
    }
    assert parts["c"].sign == parts["c3"].sign == -1.0
    assert [parts[name].needs_rate for name in ("k", "c", "c3", "q", "p")] == [
        False,
        False,
        False,
        True,
        True,
    ]


def test_a_term_with_both_splits() -> None:
    """(1 + v) d of one coefficient: d under phi and -d**2/2 under phi'."""
    parts = weak_law(Law.parse("k*(1 + v)*d"), frozenset()).parts
    assert sorted((part.kernel, part.sign) for part in parts) == [(PHI, 1.0), (PHI_1, -1.0)]


def test_what_is_left_without_coefficients_is_a_term_of_its_own() -> None:
    assert [part.coefficient for part in weak_law(Law.parse("d**3 + k*d"), frozenset()).parts] == ["k", None]


def test_a_free_nonlinear_coefficient_adds_its_slope() -> None:
    parts = weak_law(Law.parse("k*max(d - g, 0)"), frozenset({"g"})).parts
    assert [(part.coefficient, part.increment) for part in parts] == [("k", False), ("g", True)]
    assert len(weak_law(Law.parse("k*max(d - g, 0)"), frozenset()).parts) == 1


@pytest.mark.parametrize(
    ("power", "hermite"),
    [
        (1, lambda d: d),
        (2, lambda d: d**2 - S**2),
        (3, lambda d: d**3 - 3 * S**2 * d),
        (4, lambda d: d**4 - 6 * S**2 * d**2 + 3 * S**4),
        (5, lambda d: d**5 - 10 * S**2 * d**3 + 15 * S**4 * d),
    ],
)
def test_powers_without_bias_are_hermite_polynomials(
    power: int, hermite: Callable[[np.ndarray], np.ndarray]
) -> None:
    d = np.linspace(-2.0, 2.0, 9)
    [[unbiased, slope, *_]] = chains(weak_law(Law.parse(f"k*d**{power}"), frozenset()), d, S**2)
    assert unbiased == pytest.approx(hermite(d), abs=1e-12)
    step = 1e-5  # central difference of a polynomial with third derivatives up to 240: 4e-9, and some twenty times
    assert slope == pytest.approx((hermite(d + step) - hermite(d - step)) / (2 * step), abs=1e-7)


def test_other_functions_lose_their_bias_to_second_order() -> None:
    """E h(d + e) = g(d) to s^4: for cos both sides are known, exp(-s^2/2) (1 + s^2/2) cos d = (1 - s^4/8 + ...) cos d."""
    d = np.linspace(-1.0, 1.0, 5)
    for s in (0.2, 0.1):
        [[unbiased, *_]] = chains(weak_law(Law.parse("F*cos(d)"), frozenset()), d, s**2)
        expectation = np.exp(-(s**2) / 2) * unbiased
        assert expectation == pytest.approx(np.cos(d), rel=s**4 / 8 * 1.1)


def test_without_correction_the_cube_is_biased() -> None:
    """The check that the check above can fail: over noise the plain cube is off by 3 s^2 d, the corrected one is not."""
    noisy = 1.0 + S * np.random.default_rng(0).normal(size=400_000)
    [[unbiased, *_]] = chains(weak_law(Law.parse("k*d**3"), frozenset()), noisy, S**2)
    standard = np.std(unbiased) / np.sqrt(len(noisy))
    assert abs(unbiased.mean() - 1.0) < 4 * standard
    assert np.mean(noisy**3) - 1.0 > 50 * standard
