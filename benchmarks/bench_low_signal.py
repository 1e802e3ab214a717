"""Intervals where noise nearly hides the motion: the paper's chains of two masses at 5 dB and of four at 10 dB.

LINKWISE_SEEDS says how many records of each (default 100).
"""

from __future__ import annotations

import os
from collections import Counter
from time import perf_counter

import numpy as np
import pytest

import linkwise as lw

FIRST = 1000  # seeds from here on were never tuned on, but for the first 20 of each
SEEDS = int(os.environ.get("LINKWISE_SEEDS", "100"))
LEAST, MOST = 0.90, 0.98  # of intervals of 95 %
LARGEST_MEAN_SQUARE = 1.2  # of errors in standard errors
FAR = 5.0  # standard errors


@pytest.mark.parametrize(("n", "decibel"), [(2, 5.0), (4, 10.0)])
def test_intervals_at_a_low_signal(n: int, decibel: float) -> None:
    chain = lw.bnes_chain(n)
    asked = chain.unknown("all")
    true = np.array([chain.coefficient(p.name).value for p in asked.parameters], dtype=float)
    clean = lw.simulate(chain, release={"v:m1": 1.0 if n == 2 else 3.0}, duration=6.0, rate=1000.0)
    verdicts: Counter[str] = Counter()
    z, seconds = [], []
    for seed in range(FIRST, FIRST + SEEDS):
        started = perf_counter()
        fit = lw.identify(clean.with_noise(decibel, seed=seed), asked)
        seconds.append(perf_counter() - started)
        verdicts[fit.verdicts[0].name] += 1
        if fit.trusted:
            z.append((fit.values - true) / np.sqrt(fit.covariance.diagonal()))
    off = np.abs(np.array(z))
    covered, mean_square = float(np.mean(off < 1.96)), float(np.mean(off**2))
    print(
        f"\nn = {n}, {decibel:g} dB: {len(z)} of {SEEDS} trusted, covered {100.0 * covered:.1f} %, mean square "
        f"{mean_square:.2f}, worst {off.max():.1f} standard errors; median {np.median(seconds):.1f} s; {dict(verdicts)}"
    )
    assert len(z) >= 0.8 * SEEDS
    assert LEAST <= covered <= MOST
    assert mean_square <= LARGEST_MEAN_SQUARE
    assert off.max() < FAR
