"""The figures that maximum likelihood must reach, on seeds that nothing was tuned on (1000 and up).

The table of all masses and twenty seeds is printed by benchmarks/bench_likelihood.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from present import present, some
from problems import chain_record

import linkwise as lw
from linkwise.identification.limit.limit import limit

FIRST = 1000  # seed
MANY = 250  # records of the statistics below
COVERED = (0.92, 0.98)  # share of 95 % intervals over them: two deviations of sqrt(0.05 0.95 / 250)
LARGEST_NMSE = {
    20.0: 8e-4,
    40.0: 1.5e-5,
}  # % of the median seed: the figures that the table of the benchmark must reach


@dataclass(frozen=True, eq=False)
class Runs:
    """Fits of several seeds: values and standard errors (R, p), the mean NMSE of the sinks in % (R,)."""

    names: tuple[str, ...]
    true: np.ndarray
    fits: tuple[lw.Estimate, ...]
    nmse: np.ndarray

    @property
    def z(self) -> np.ndarray:
        """(R, p) errors in standard errors."""
        values = np.stack([fit.values for fit in self.fits])
        scaled: np.ndarray = (values - self.true) / np.sqrt([np.diag(fit.covariance) for fit in self.fits])
        return scaled


def identified(n: int, decibel: float, seeds: int, sensors: str = "x") -> Runs:
    chain = lw.bnes_chain(n)
    clean, asked = chain_record(n, sensors=(sensors,)), chain.unknown("all")
    fits = []
    nmse = []
    for seed in range(FIRST, FIRST + seeds):
        record = clean.with_noise(decibel, seed=seed)
        fit = lw.identify(record, asked)
        assert fit.status == "converged", f"n = {n}, {decibel} dB, seed {seed}: {fit.message}"
        fits.append(fit)
        sinks = [f"nes{i}" for i in range(1, n // 2 + 1)]
        nmse.append(np.mean([lw.nmse(chain.link(s), fit.structure.link(s), clean) for s in sinks]))
    names = tuple(p.name for p in asked.parameters)
    true = np.array([chain.coefficient(name).value for name in names])
    return Runs(names, true, tuple(fits), np.array(nmse))


@pytest.mark.parametrize(("n", "seeds"), [(2, 20), (4, 12), (6, 8), (8, 4), (10, 16)])
def test_at_20_db_every_sink_is_found_to_a_few_millionths(n: int, seeds: int) -> None:
    runs = identified(n, 20.0, seeds)
    assert np.median(runs.nmse) <= LARGEST_NMSE[20.0]
    assert runs.nmse.max() <= 1e-2  # the benchmark's figure for the worst seed
    # chi-square of z over all coefficients: they are correlated within a record, so its scatter is taken from records
    assert 0.6 < np.sqrt(np.mean(runs.z**2)) < 1.4
    chi = [fit.chi_square_per_sample for fit in runs.fits]
    assert (
        np.abs(np.array(chi) - 1.0).max() < 5.0 * np.sqrt(2.0 / 12002) + 0.05
    )  # 5 % for the estimated noise


@pytest.mark.parametrize(("n", "seeds"), [(2, 10), (10, 4)])
def test_at_40_db_a_hundred_times_better(n: int, seeds: int) -> None:
    assert np.median(identified(n, 40.0, seeds).nmse) <= LARGEST_NMSE[40.0]


@pytest.mark.parametrize(("n", "seeds"), [(2, 20), (4, 10)])
def test_velocities_alone_are_enough(n: int, seeds: int) -> None:
    runs = identified(n, 30.0, seeds, "v")
    inside = np.mean(np.abs(runs.z) < 1.96)
    # 100 intervals each, of which half are taken as independent: three deviations of the share
    assert inside > 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / (0.5 * runs.z.size))
    # likewise: 1/sqrt(2 50), and two and a half deviations
    assert 0.75 < np.sqrt(np.mean(runs.z**2)) < 1.25


@pytest.fixture(scope="module")
def many() -> Runs:
    return identified(2, 20.0, MANY)


def test_standard_errors_are_what_the_errors_are(many: Runs) -> None:
    z = np.sqrt(np.mean(many.z**2, axis=0))
    assert 0.9 < np.sqrt(np.mean(many.z**2)) < 1.1  # 2.2 of 1/sqrt(2 250), were all coefficients one
    assert (z > 0.85).all() and (z < 1.15).all(), dict(
        zip(many.names, z, strict=True)
    )  # 3.3 of 1/sqrt(2 250)
    assert np.abs(many.z.mean(axis=0)).max() < 3.3 / np.sqrt(len(many.fits))  # no bias


def test_intervals_cover_as_often_as_they_say(many: Runs) -> None:
    for number, name in some(enumerate(many.names)):
        intervals = [present(fit.coefficient(name).interval) for fit in many.fits]
        inside = [low < many.true[number] < high for low, high in intervals]
        assert COVERED[0] <= np.mean(inside) <= COVERED[1], name


def test_the_force_band_covers_at_every_elongation(many: Runs) -> None:
    link, d = lw.bnes_chain(2).link("nes1"), np.linspace(-0.03, 0.03, 13)
    inside = []
    for fit in many.fits:
        _, lower, upper = fit.force_band("nes1", d)
        inside.append((lower <= link.force(d)) & (link.force(d) <= upper))
    moving = np.abs(d) > 0.0
    share = np.mean(inside, axis=0)[moving]
    assert (share >= COVERED[0]).all() and (share <= COVERED[1]).all()


def test_errors_are_as_small_as_information_allows(many: Runs) -> None:
    """Mean squared errors of alpha and beta against the bound of segments of 0.25 s with free states."""
    bound = limit(
        lw.bnes_chain(2), unknown=("all",), duration=6.0, rate=1000.0, noise=20.0, segment=0.25,
        release={"v:m1": 1.0},
    )  # fmt: skip
    for name in ("nes1.alpha", "nes1.beta"):
        number = many.names.index(name)
        error = np.mean([(fit.values[number] - many.true[number]) ** 2 for fit in many.fits])
        # a mean of 250 squares scatters by sqrt(2/250) = 0.09: nearly three deviations
        assert error < 1.25 * present(bound.coefficient(name).standard_error) ** 2


def test_a_wrong_noise_model_is_caught_each_time() -> None:
    asked = lw.bnes_chain(2).unknown("all")
    for seed in range(FIRST, FIRST + 5):
        record = chain_record(2).with_noise(20.0, seed=seed)
        half = {name: 0.5 * sigma for name, sigma in present(record.simulated).noise.items()}
        fit = lw.identify(lw.Record(0.0, 1000.0, record.channels, record.values, half), asked)
        assert fit.status == "chi-square off"
        assert all(each.interval is None for link in some(fit.links) for each in link.coefficients)
