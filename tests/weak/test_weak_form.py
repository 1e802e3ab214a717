"""The weak form: sums by parts, bias, and the accuracy of its answers."""

from collections.abc import Callable

import numpy as np
import pytest
from paper_weak_fits import check_short_records, check_sinks, true_values
from present import some
from problems import chain_record

import linkwise as lw
from linkwise.weak.weak_form import WeakLaw, weak_law

S = 0.3


def chains(weak: WeakLaw, d: np.ndarray, variance: float, **values: float) -> list[list[np.ndarray]]:
    """h, h', h'', ... of every part at `d` (N,)."""
    given = {name: np.array([[values.get(name, np.nan)]]) for name in weak.law.coefficients}
    evaluated = weak.evaluate(d[None], 0.0, np.array([[variance]]), given)
    return [[np.broadcast_to(array, (1, len(d)))[0] for array in chain] for chain in evaluated]


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
def test_powers_are_hermite_polynomials(power: int, hermite: Callable[[np.ndarray], np.ndarray]) -> None:
    d = np.linspace(-2.0, 2.0, 9)
    [[unbiased, slope, *_]] = chains(weak_law(lw.Law.parse(f"k*d**{power}"), frozenset()), d, S**2)
    assert unbiased == pytest.approx(hermite(d), abs=1e-12)
    step = 1e-5  # central difference of a polynomial with third derivatives up to 240: 4e-9, and some twenty times
    assert slope == pytest.approx((hermite(d + step) - hermite(d - step)) / (2 * step), abs=1e-7)


def test_other_functions_lose_their_bias_to_second_order() -> None:
    """E h(d + e) = g(d) to s^4: for cos both sides are known, exp(-s^2/2) (1 + s^2/2) cos d = (1 - s^4/8 + ...) cos d."""
    d = np.linspace(-1.0, 1.0, 5)
    for s in (0.2, 0.1):
        [[unbiased, *_]] = chains(weak_law(lw.Law.parse("F*cos(d)"), frozenset()), d, s**2)
        expectation = np.exp(-(s**2) / 2) * unbiased
        assert expectation == pytest.approx(np.cos(d), rel=s**4 / 8 * 1.1)


def test_without_correction_the_cube_is_biased() -> None:
    """The check that the check above can fail: over noise the plain cube is off by 3 s^2 d, the corrected one is not."""
    noisy = 1.0 + S * np.random.default_rng(0).normal(size=400_000)
    [[unbiased, *_]] = chains(weak_law(lw.Law.parse("k*d**3"), frozenset()), noisy, S**2)
    standard = np.std(unbiased) / np.sqrt(len(noisy))
    assert abs(unbiased.mean() - 1.0) < 4 * standard
    assert np.mean(noisy**3) - 1.0 > 50 * standard


SEEDS = 4  # of twenty


@pytest.mark.slow
@pytest.mark.parametrize(("n", "decibel"), [(2, 10.0), (8, 20.0)])
def test_sinks_and_standard_errors(n: int, decibel: float) -> None:
    check_sinks(n, decibel, SEEDS)


@pytest.mark.slow
def test_short_records_say_how_little_they_tell() -> None:
    check_short_records(0.15, 30)


@pytest.mark.slow
def test_without_noise_the_answer_is_exact_and_trusted() -> None:
    """To the alias of the window, 1e-5 of a coefficient."""
    chain = lw.bnes_chain(4)
    fit = lw.identify(chain_record(4), chain.unknown("all"), method="weak")
    assert fit.trusted
    for name, value in some(true_values(chain).items()):
        assert fit.coefficient(name).value == pytest.approx(value, rel=1e-5)
