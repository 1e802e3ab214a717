"""The paper's Table 2 by the convention that comes nearest to it: `make benchmark`."""

from __future__ import annotations

import numpy as np

import linkwise as lw
from linkwise.sindy.regression.gram import Gram

PAPER = {  # NMSE in %, at 40, 30 and 20 dB
    2: (0.0018, 0.0331, 2.1564),
    4: (0.0027, 0.1128, 5.8351),
    6: (0.0039, 0.4716, 9.0256),
    8: (0.0358, 2.3555, 30.3485),
    10: (0.6450, 9.7115, 63.0856),
}
SEEDS = {2: 30, 4: 30, 6: 20, 8: 12, 10: 8}  # from 1000 on; nothing was tuned on them


def test_least_squares_on_all_cubic_monomials_comes_within_three_of_the_paper_in_twelve_cells() -> None:
    """Median over seeds and sinks. Each seed follows an orbit of its own, whose start differs by 1e-10: which of the chaotic
    orbits it is changes the error of eight masses at 40 dB by a factor of a hundred.
    """
    print(
        "\nNMSE in % of all cubic monomials (noisy states, velocities differenced), and as a multiple of the paper's"
    )
    within = 0
    for masses, paper in PAPER.items():
        chain = lw.bnes_chain(masses)
        sinks = [f"m{2 * cell}" for cell in range(1, masses // 2 + 1)]
        errors = np.zeros((SEEDS[masses], 3, len(sinks)))
        for row in range(SEEDS[masses]):
            speed = (1.0 if masses == 2 else 3.0) * (1 + 1e-10 * row)
            record = lw.simulate(
                chain, release={"v:m1": speed}, duration=6.0, rate=1000.0, sensors=("x", "v", "a")
            )
            for level, decibel in enumerate((40.0, 30.0, 20.0)):
                states = lw.sindy.noisy_states(record, "differenced", decibel, seed=1000 + row)
                fit = lw.sindy.LeastSquares().fit(lw.sindy.monomial_equations(states, 3, equations_of=sinks))
                errors[row, level] = [
                    lw.sindy.monomial_nmse(fit, chain, f"nes{cell}", record)
                    for cell in range(1, len(sinks) + 1)
                ]
        median = np.median(errors, axis=(0, 2))
        ratio = median / np.array(paper)
        within += int(np.sum((ratio < 3) & (ratio > 1 / 3)))
        shown = "   ".join(f"{found:8.3g} ({times:5.2f})" for found, times in zip(median, ratio, strict=True))
        print(f"{masses:3d} masses, 40, 30, 20 dB: {shown}")
    print(f"{within} of 15 cells within a factor of 3")
    assert within >= 12


def test_thresholds_chosen_on_rows_held_out_find_the_force_that_all_terms_miss() -> None:
    """Six and ten masses at 20 dB, noise on the states: median and worst quarter over seeds and sinks."""
    print("\nNMSE in % at 20 dB, median and upper quartile")
    for masses, seeds in ((6, 10), (10, 4)):
        chain = lw.bnes_chain(masses)
        sinks = [f"m{2 * cell}" for cell in range(1, masses // 2 + 1)]
        found: dict[str, list[float]] = {"all terms": [], "STLSQ": [], "L1": []}
        for row in range(seeds):
            record = lw.simulate(
                chain,
                release={"v:m1": 3.0 * (1 + 1e-10 * row)},
                duration=6.0,
                rate=1000.0,
                sensors=("x", "v", "a"),
            )
            states = lw.sindy.noisy_states(record, "states", 20.0, seed=1000 + row)
            system = lw.sindy.monomial_equations(states, 3, equations_of=sinks)
            gram = Gram.of(system)
            for name, regressor in zip(
                found, (lw.sindy.LeastSquares(), lw.sindy.Stlsq(), lw.sindy.L1()), strict=True
            ):
                fit = regressor.fit_gram(gram, system.units, system.targets)
                found[name] += [
                    lw.sindy.monomial_nmse(fit, chain, f"nes{cell}", record)
                    for cell in range(1, len(sinks) + 1)
                ]
        for name, errors in found.items():
            print(f"{masses:3d} masses, {name:9s}: {np.median(errors):8.3g} {np.quantile(errors, 0.75):8.3g}")
        assert np.median(found["STLSQ"]) < np.median(found["all terms"]) / 10
        assert np.median(found["L1"]) < np.median(found["all terms"]) / 3
