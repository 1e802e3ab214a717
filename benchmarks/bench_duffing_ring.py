"""Discovery from few samples: the ring of five coupled Duffing oscillators of Hsu et al., arXiv 2511.18555.

LINKWISE_SEEDS says how many draws of the noise there are (default 100).
"""

from __future__ import annotations

import os
from dataclasses import replace
from time import perf_counter

import numpy as np
from duffing_ring import NOISE, SIZE, VALUES, motion, noisy, ring
from within import terms

import linkwise as lw

FIRST = 1000
SEEDS = int(os.environ.get("LINKWISE_SEEDS", "100"))
TRUTH = ring(*VALUES.reshape(3, SIZE))
KINDS = (("spring", "k"), ("spring", "k3"), ("ring", "k"))  # in the order of VALUES


def bound() -> np.ndarray:
    """(15,) Cramer-Rao bound of the coefficients, initial states unknown: the covariance at the motion without noise."""
    clean = motion(VALUES, np.ones(SIZE), np.zeros(SIZE))
    asked = ring(*VALUES.reshape(3, SIZE)).unknown("all")
    fit = lw.identify(
        replace(clean, noise=dict.fromkeys(clean.channels, NOISE)),
        asked,
        starts={p.name: float(TRUTH.coefficient(p.name).value or 0.0) for p in asked.parameters},
    )
    deviations = np.sqrt(fit.covariance.diagonal())
    order = {parameter.name: number for number, parameter in enumerate(asked.parameters)}
    names = [f"{link}{k + 1}.{name}" for link, name in KINDS for k in range(SIZE)]
    return np.array([deviations[order[name]] for name in names])


def coefficients(structure: lw.Structure) -> np.ndarray:
    """(15,) the coefficients of a structure with the right terms, in the order of `motion`."""
    links = {frozenset(link.between): link.values for link in structure.links}
    ground = [links[frozenset({f"m{k + 1}", "ground"})] for k in range(SIZE)]
    coupling = [links[frozenset({f"m{k + 1}", f"m{(k + 1) % SIZE + 1}"})]["k"] for k in range(SIZE)]
    return np.array([*(each["k"] for each in ground), *(each["k3"] for each in ground), *coupling])


def test_ring_of_duffing_oscillators() -> None:
    truth, least = TRUTH, bound()
    exact, trusted, wrong_and_trusted, chi_squares, errors, seconds = 0, 0, 0, [], [], []
    print()
    for seed in range(FIRST, FIRST + SEEDS):
        record = noisy(seed)
        started = perf_counter()
        found = lw.discover(record, dict.fromkeys(truth.mass_names, 1.0))
        seconds.append(perf_counter() - started)
        mine, true = terms(found.structure), terms(truth)
        exact, trusted = exact + (mine == true), trusted + found.trusted
        wrong_and_trusted += found.trusted and mine != true
        chi_squares.append(found.estimate.chi_square_per_sample)
        if mine == true:
            errors.append((coefficients(found.structure) - VALUES) / least)
        else:
            print(
                f"  seed {seed}: {len(true - mine)} terms missing, {len(mine - true)} extra, "
                f"chi-square {chi_squares[-1]:.3f}, {', '.join(verdict.name for verdict in found.verdicts)}",
                flush=True,
            )
    inside = float(np.mean((np.array(chi_squares) > 0.9) & (np.array(chi_squares) < 1.1)))
    over_bound = float(np.sqrt(np.mean(np.array(errors) ** 2)))
    print(
        f"Duffing ring: exact {exact} of {SEEDS}, trusted {trusted}, wrong and trusted {wrong_and_trusted}; chi-square from "
        f"{min(chi_squares):.3f} to {max(chi_squares):.3f}, {100.0 * inside:.0f} % between 0.9 and 1.1; errors "
        f"{over_bound:.2f} times the bound; median {np.median(seconds):.2f} s"
    )
    assert exact >= 0.95 * SEEDS
    assert inside >= 0.95
    assert over_bound <= 1.2
