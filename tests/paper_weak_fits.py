"""Fits of the paper's chain by the weak form, and what they must show: the suite has some records, the benchmark all of them.

Every tolerance of a statistic is a stated number of its standard deviations for the records that there are.
"""

from collections.abc import Sequence

import numpy as np
import scipy
import within
from problems import chain_record, truth

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
    errors, z = [], []
    fits = [
        lw.identify(chain_record(n).with_noise(decibel, seed=seed), chain.unknown("all"), method="weak")
        for seed in range(FIRST, FIRST + seeds)
    ]
    for fit in trusted(fits):
        sinks = [link for link in fit.structure.links if link.name.startswith("nes")]
        errors.append(np.mean([lw.nmse(chain.link(sink.name), sink, fit.record) for sink in sinks]))
        z.append(within.errors(fit, chain))
    assert np.median(errors) <= LEVELS[decibel]
    # 2.8 deviations, were five coefficients independent in each record; 0.2 of twenty seeds
    assert abs(np.sqrt(np.mean(np.square(z))) - 1.0) <= 2.8 / np.sqrt(2.0 * 5 * len(z))


def check_short_records(duration: float, records: int) -> None:
    """A few dozen windows: z keeps its size, and the 95 % intervals still cover 90 % or more."""
    chain = lw.bnes_chain(2)
    true, record = truth(chain, chain.unknown("all")), chain_record(2, duration=duration)
    z = []
    for seed in range(records):
        fit = lw.identify(record.with_noise(30.0, seed=seed), chain.unknown("all"), method="weak")
        z.append((fit.values - true) / np.sqrt(fit.covariance.diagonal()))
    assert 0.8 <= np.sqrt(np.mean(np.square(z))) <= 1.25
    assert np.mean(np.abs(z) < 1.96) > 0.9
