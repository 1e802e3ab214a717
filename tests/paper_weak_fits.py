"""Fits of the paper's chain by the weak form, and what they must show: the suite has some records, the benchmark all of them.

Every tolerance of a statistic is a stated number of its standard deviations for the records that there are.
"""

from collections.abc import Sequence

import numpy as np
import scipy
from present import present
from problems import chain_record

import linkwise as lw

FIRST = 1000  # seed
LEVELS = {10.0: 1.0, 20.0: 0.03, 40.0: 2e-4}  # dB: largest median NMSE of the sink forces in %
FALSE_ALARM = 0.01  # of the tests of an answer to a clean record: scores of two kinds give one in 300 each, and pieces fewer


def true_values(chain: lw.Structure) -> dict[str, float]:
    """What every coefficient is."""
    return {f"{link.name}.{name}": value for link in chain.links for name, value in link.values.items()}


def trusted(fits: Sequence[lw.Estimate]) -> list[lw.Estimate]:
    """The trusted ones of fits to clean records, of which tests refuse a few by chance, as any that can detect a fault.

    No more than the 99.9 % quantile of what `FALSE_ALARM` gives, and these because something follows the motion.
    """
    refused = [fit for fit in fits if not fit.trusted]
    allowed = scipy.stats.binom.ppf(0.999, len(fits), FALSE_ALARM)
    assert len(refused) <= allowed, [fit.message for fit in refused]
    for fit in refused:
        assert fit.verdicts == (lw.Verdict.SYSTEMATIC_MISFIT,), fit.message
    return [fit for fit in fits if fit.trusted]


def check_sinks(n: int, decibel: float, seeds: int) -> None:
    """Median NMSE of trusted answers, and z = (value - truth)/standard error of rms 1 over these and coefficients."""
    chain = lw.bnes_chain(n)
    truth = true_values(chain)
    errors, z = [], []
    fits = [
        lw.identify(chain_record(n).with_noise(decibel, seed=seed), chain.unknown("all"), method="weak")
        for seed in range(FIRST, FIRST + seeds)
    ]
    for fit in trusted(fits):
        sinks = [link for link in fit.structure.links if link.name.startswith("nes")]
        errors.append(np.mean([lw.nmse(chain.link(sink.name), sink, fit.record) for sink in sinks]))
        estimates = [fit.coefficient(name) for name in truth]
        z.append(
            [
                (estimate.value - truth[estimate.name]) / present(estimate.standard_error)
                for estimate in estimates
            ]
        )
    assert np.median(errors) <= LEVELS[decibel]
    # 2.8 deviations, were five coefficients independent in each record; 0.2 of twenty seeds
    assert abs(np.sqrt(np.mean(np.square(z))) - 1.0) <= 2.8 / np.sqrt(2.0 * 5 * len(z))


def check_cover(records: int) -> None:
    """The 95 % intervals hold the truth as often as they say (METHODS section 7): of every coefficient, of the force at five
    elongations, of a well, the barrier and the frequency; of trusted answers, since others have none.
    """
    chain = lw.bnes_chain(2)
    record = chain_record(2, duration=3.0)
    truth, d = true_values(chain), np.array([-0.03, -0.01, 0.004, 0.012, 0.028])
    force = chain.link("nes1").force(d)
    # slope -2 alpha in the well, reduced mass
    frequency = np.sqrt(200.0 / (1.0 / (1.0 / 0.01 + 1.0))) / (2.0 * np.pi)
    is_inside = []
    fits = [
        lw.identify(record.with_noise(25.0, seed=seed), chain.unknown("all"), method="weak")
        for seed in range(records)
    ]
    for fit in trusted(fits):
        sink = fit.link("nes1")
        _, lower, upper = fit.force_band("nes1", d)
        derived = [(sink.wells[1], 0.01), (present(sink.barrier), 0.0025), (sink.frequencies[0], frequency)]
        intervals = [(present(fit.coefficient(name).interval), value) for name, value in truth.items()]
        intervals += [(present(quantity.interval), value) for quantity, value in derived]
        is_inside.append(
            [low <= value <= high for (low, high), value in intervals]
            + list((lower <= force) & (force <= upper))
        )
    covered, deviation = np.mean(is_inside, axis=0), np.sqrt(0.95 * 0.05 / len(is_inside))
    assert abs(covered.mean() - 0.95) <= 2.0 * deviation < 0.07  # 92 to 98 % of 200 records
    assert covered.min() >= 0.95 - 4.0 * deviation  # of 13 quantities


def check_short_records(duration: float, records: int) -> None:
    """A few dozen windows: z keeps its size, and the 95 % intervals still cover 90 % or more."""
    chain = lw.bnes_chain(2)
    truth = true_values(chain)
    record = chain_record(2, duration=duration)
    z = []
    for seed in range(records):
        fit = lw.identify(record.with_noise(30.0, seed=seed), chain.unknown("all"), method="weak")
        z.append(
            [
                (fit.values[i] - truth[p.name]) / np.sqrt(fit.covariance[i, i])
                for i, p in enumerate(fit.parameters)
            ]
        )
    assert 0.8 <= np.sqrt(np.mean(np.square(z))) <= 1.25
    assert np.mean(np.abs(z) < 1.96) > 0.9
