"""Fits of many records of the paper's chain, and what they must show: the suite has some records, the benchmark all of them.

Every tolerance of a statistic is a stated number of its standard deviations for the records that there are.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from present import present, some
from problems import chain_fit, chain_record

import linkwise as lw

FIRST = 1000  # seed
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
        """(R, p) errors in standard errors of the laws as stated, which terms that chance hints at widen in a few fits."""
        values = np.stack([fit.values for fit in self.fits])
        added = [0.0 if fit.for_dropped_terms is None else fit.for_dropped_terms for fit in self.fits]
        variances = [np.diag(fit.covariance - more) for fit, more in zip(self.fits, added, strict=True)]
        scaled: np.ndarray = (values - self.true) / np.sqrt(variances)
        return scaled


def identified(n: int, decibel: float, seeds: int, sensors: str = "x", *, duration: float = 6.0) -> Runs:
    """The chain of n masses, identified from `seeds` records of a duration in s."""
    chain = lw.bnes_chain(n)
    clean, unknown = chain_record(n, sensors=(sensors,), duration=duration), chain.unknown("all")
    fits, nmse = [], []
    for seed in range(FIRST, FIRST + seeds):
        fit = chain_fit(n, decibel, seed, (sensors,), duration=duration)
        assert fit.status == "converged", f"n = {n}, {decibel} dB, seed {seed}: {fit.message}"
        fits.append(fit)
        sinks = [f"nes{i}" for i in range(1, n // 2 + 1)]
        nmse.append(np.mean([lw.nmse(chain.link(s), fit.structure.link(s), clean) for s in sinks]))
    names = tuple(p.name for p in unknown.parameters)
    true = np.array([chain.coefficient(name).value for name in names])
    return Runs(names, true, tuple(fits), np.array(nmse))


def check_sinks_at_20_db(runs: Runs) -> None:
    """Every sink is found to a few millionths, with the errors and the chi-square that are stated."""
    assert np.median(runs.nmse) <= LARGEST_NMSE[20.0]
    assert runs.nmse.max() <= 1e-2  # the table's figure for the worst seed
    # chi-square of z over all coefficients: they are correlated within a record, so its scatter is taken from records
    assert 0.6 < np.sqrt(np.mean(runs.z**2)) < 1.4
    chi = [fit.chi_square_per_sample for fit in runs.fits]
    # 5 % for the estimated noise
    assert np.abs(np.array(chi) - 1.0).max() < 5.0 * np.sqrt(2.0 / 12002) + 0.05


def check_velocities(runs: Runs) -> None:
    """Intervals from velocities alone cover; half of them are taken as independent."""
    half = 0.5 * runs.z.size
    inside = np.mean(np.abs(runs.z) < 1.96)
    assert inside > 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / half)  # three deviations of the share
    assert abs(np.sqrt(np.mean(runs.z**2)) - 1.0) < 2.5 / np.sqrt(2.0 * half)  # two and a half


def check_standard_errors(runs: Runs) -> None:
    """They are what the errors are, and there is no bias."""
    z, count = np.sqrt(np.mean(runs.z**2, axis=0)), len(runs.fits)
    scatter = 1.0 / np.sqrt(2.0 * count)
    assert abs(np.sqrt(np.mean(runs.z**2)) - 1.0) < 2.2 * scatter  # were all coefficients one
    assert (np.abs(z - 1.0) < 3.3 * scatter).all(), dict(zip(runs.names, z, strict=True))
    assert np.abs(runs.z.mean(axis=0)).max() < 3.3 / np.sqrt(count)


def check_share(inside: np.ndarray, chance: float) -> None:
    """(R, ...) whether an interval covers: as often as 95 % says, between binomial quantiles of `chance` on each side."""
    fewest, most = scipy.stats.binom.ppf([chance, 1.0 - chance], len(inside), 0.95)
    assert most < len(inside), "so few records cannot show intervals that are too wide"
    count = np.sum(inside, axis=0)
    assert ((fewest <= count) & (count <= most)).all(), count


def check_intervals(runs: Runs, chance: float) -> None:
    """Intervals of coefficients cover as often as they say."""
    for number, _ in some(enumerate(runs.names)):
        intervals = [present(fit.coefficient(runs.names[number]).interval) for fit in runs.fits]
        check_share(np.array([low < runs.true[number] < high for low, high in intervals]), chance)


def check_force_band(runs: Runs, chance: float) -> None:
    """The band of the first sink's force covers at every elongation."""
    link, d = lw.bnes_chain(2).link("nes1"), np.linspace(-0.03, 0.03, 13)
    inside = []
    for fit in runs.fits:
        _, lower, upper = fit.force_band("nes1", d)
        inside.append((lower <= link.force(d)) & (link.force(d) <= upper))
    check_share(np.array(inside)[:, np.abs(d) > 0.0], chance)


def check_bound(runs: Runs, duration: float = 6.0) -> None:
    """Mean squared errors of alpha and beta against the bound of segments of 0.25 s with free states, for that `duration`."""
    bound = lw.limit(
        lw.bnes_chain(2), unknown=("all",), duration=duration, rate=1000.0, noise=20.0, segment=0.25,
        release={"v:m1": 1.0},
    )  # fmt: skip
    for name in ("nes1.alpha", "nes1.beta"):
        number = runs.names.index(name)
        error = np.mean([(fit.values[number] - runs.true[number]) ** 2 for fit in runs.fits])
        # a mean of R squares scatters by sqrt(2/R): 2.8 deviations
        most = 1.0 + 2.8 * np.sqrt(2.0 / len(runs.fits))
        assert error < most * present(bound.coefficient(name).standard_error) ** 2
