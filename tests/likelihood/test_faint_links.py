"""Coefficients of a link whose elongation hardly stands above the noise: no interval where the likelihood has other peaks."""

from __future__ import annotations

import numpy as np
import pytest
from problems import truth
from structures import row_of_masses

import linkwise as lw
from linkwise.likelihood.faint_links import elongation_energy
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.starts.values import starting_values

STIFFNESS, DURATION, RATE = 1e4, 4.0, 500.0


def pair(inner: float) -> lw.Structure:
    """A mass on a spring, and a lighter one on it by a stiffer link, of `inner` N/m."""
    law = "k*d + c*v"
    return row_of_masses(
        [1.0, 0.3], outer=(law, {"k": STIFFNESS, "c": 1.0}), inner=(law, {"k": inner, "c": 1.0})
    )


def noisy(structure: lw.Structure, snr_db: float, seed: int) -> lw.Record:
    clean = lw.simulate(structure, release={"v:m1": 1.0}, duration=DURATION, rate=RATE)
    return clean.with_noise(snr_db, seed=seed)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_peak_among_others_is_not_trusted(seed: int) -> None:
    """At 5 dB the elongation of the inner link has some 50 times the energy of the noise: its stiffness came out 200 standard
    errors off, at chi-square 1."""
    structure = pair(3.0 * STIFFNESS)
    unknown = structure.unknown("all")
    fit = lw.identify(noisy(structure, 5.0, seed), unknown)
    z = np.abs(fit.values - truth(structure, unknown)) / np.sqrt(fit.covariance.diagonal())
    assert np.max(z) > 100.0 and fit.chi_square_per_sample == pytest.approx(1.0, abs=0.1)
    assert fit.verdicts[0] is lw.Verdict.SEVERAL_OPTIMA and not fit.trusted
    assert "values of inner.k, inner.c far from the estimates explain it as well" in fit.message


@pytest.mark.parametrize(("snr_db", "seed"), [(16.0, 0), (19.0, 3), (28.0, 1)])
def test_motion_that_neighbours_force_upon_a_link_does_not_tell_its_frequency(
    snr_db: float, seed: int
) -> None:
    """Both masses start alike, so that the inner link stretches as the outer one accelerates the inner mass: by 300 to 4000
    times the energy of the noise, and by 7 to 55 times in its own vibration. At 28 dB that is enough."""
    structure = pair(3.0 * STIFFNESS)
    unknown = structure.unknown("all")
    clean = lw.simulate(structure, release={"v:m1": 1.0, "v:m2": 1.0}, duration=DURATION, rate=RATE)
    fit = lw.identify(clean.with_noise(snr_db, seed=seed), unknown)
    z = np.max(np.abs(fit.values - truth(structure, unknown)) / np.sqrt(fit.covariance.diagonal()))
    is_determined = snr_db > 20.0
    assert fit.trusted == is_determined and (
        z < 4.0 if is_determined else z > 30.0
    )  # of four by chance once in 4000
    assert is_determined or (fit.verdicts[0] is lw.Verdict.SEVERAL_OPTIMA and "inner.k" in fit.message)


@pytest.mark.parametrize("seed", range(3))
def test_a_link_that_stands_above_the_noise_is_trusted(seed: int) -> None:
    structure = pair(3.0 * STIFFNESS)
    unknown = structure.unknown("all")
    fit = lw.identify(noisy(structure, 10.0, seed), unknown)
    z = np.abs(fit.values - truth(structure, unknown)) / np.sqrt(fit.covariance.diagonal())
    assert fit.trusted and np.max(z) < 4.0  # standard errors: of 12 by chance once in 1300


def test_a_link_as_good_as_rigid_is_not_trusted() -> None:
    """Its elongation is not above the noise: from 909 +- 567 N s/m of damping no interval tells that it is stiff."""
    structure = pair(10.0 * STIFFNESS)
    fit = lw.identify(noisy(structure, 5.0, 2), structure.unknown("all"))
    assert fit.verdicts[0] is lw.Verdict.SEVERAL_OPTIMA
    assert "inner.k, inner.c" in fit.message


def test_energy_is_that_of_the_elongation_over_the_noise_of_both_ends() -> None:
    structure = pair(3.0 * STIFFNESS)
    clean = lw.simulate(structure, release={"v:m1": 1.0}, duration=DURATION, rate=RATE)
    record, unknown = clean.with_noise(20.0, seed=1), structure.unknown("all")
    theta, spread = starting_values([record], unknown)
    fit = likelihood_fit([record], unknown, theta, spread=spread)
    x = np.stack([clean.channel("x:m1"), clean.channel("x:m2")])
    sigma = np.sqrt(np.mean(x**2, axis=1) * 10.0 ** (-20.0 / 10.0))
    d = x[1] - x[0]
    outer, inner = np.var(x[0]) / sigma[0] ** 2, np.var(d) / np.sum(sigma**2)
    # of fitted motion and noise: 3 % of the noise, and the elongation to sqrt(2 / energy)
    assert elongation_energy(fit) == pytest.approx(len(clean) * np.array([outer, inner]), rel=0.1)
