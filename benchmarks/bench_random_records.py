"""Random clean records: every command must survive them, and what is trusted must be right as often as chance allows.

Structures of 2 to 6 masses, 10 to 40 dB, 5 to 100 samples a period. LINKWISE_RECORDS says how many (default 1000), and
LINKWISE_FIRST the seed of the first (default 0), so that several processes can share them.
"""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass

import numpy as np
from random_structures import draw_structure

import linkwise as lw
from linkwise.errors import LinkwiseError

COUNT = int(os.environ.get("LINKWISE_RECORDS", "1000"))
FIRST = int(os.environ.get("LINKWISE_FIRST", "0"))
DISCOVERED = 5  # one record in so many is discovered too
FAR = 5.0  # standard errors: by chance 6e-7 of coefficients
SAMPLES, PER_PERIOD, SNR = (1500, 6000), (5.0, 100.0), (10.0, 40.0)
METHODS = ("ml", "weak")


@dataclass(frozen=True)
class RandomRecord:
    """A structure of 2 to 6 masses and a noisy record of its displacements."""

    structure: lw.Structure
    record: lw.Record
    snr_db: float
    samples_per_period: float


def random_record(seed: int) -> RandomRecord:
    """The same seed gives the same record; a draw that runs away is drawn again."""
    rng = np.random.default_rng([seed, 20261122])
    while True:
        structure, release = draw_structure(rng, masses=(2, 6))
        per_period = float(np.exp(rng.uniform(*np.log(PER_PERIOD))))
        rate = float(np.round(per_period * np.nanmax(lw.analysis.modes(structure).frequencies), 1))
        snr_db, samples = float(rng.uniform(*SNR)), int(rng.integers(*SAMPLES))
        try:
            record = lw.simulate(structure, release=release, duration=samples / rate, rate=rate)
        except LinkwiseError:
            continue
        if np.isfinite(record.values).all() and np.abs(record.values).max() < 1.0:
            return RandomRecord(structure, record.with_noise(snr_db, seed=seed), snr_db, per_period)


def farthest(fit: lw.Estimate, truth: lw.Structure) -> float:
    """The largest error of a coefficient in standard errors, of those that have one."""
    found = [fit.coefficient(parameter.name) for parameter in fit.parameters]
    return max(
        (
            abs(each.value - truth.coefficient(each.name).value) / each.standard_error
            for each in found
            if each.standard_error is not None
        ),
        default=0.0,
    )


def test_random_records() -> None:
    counts: dict[str, Counter[str]] = {name: Counter() for name in (*METHODS, "discover")}
    wrong: list[str] = []
    false: list[str] = []
    coefficients = 0
    for seed in range(FIRST, FIRST + COUNT):
        case = random_record(seed)
        described = f"{case.snr_db:.0f} dB, {case.samples_per_period:.0f} samples a period, {case.structure.size} masses"
        for method in (*METHODS, "discover")[: 2 if seed % DISCOVERED else 3]:
            try:
                if method == "discover":
                    masses = dict(zip(case.structure.mass_names, case.structure.mass_values, strict=True))
                    found = lw.discover(case.record, masses)
                    fit, trusted, status = found.estimate, found.trusted, "not trusted"
                    truth = lw.discovery.align_truth(found.structure, case.structure)
                    extra = lw.discovery.term_score(found.structure, case.structure).extra
                    false += [
                        f"seed {seed}: {term.name} ({described})"
                        for term in found.kept
                        if term.certain and term.name in extra
                    ]
                else:
                    fit = lw.identify(case.record, case.structure.unknown("all"), method=method)
                    trusted, status, truth = fit.trusted, fit.status, case.structure
            except LinkwiseError:
                counts[method]["refused with a reason"] += 1
                continue
            counts[method]["trusted" if trusted else status] += 1
            if trusted:
                coefficients += len(fit.values)
                off = farthest(fit, truth)
                if off > FAR:
                    wrong.append(f"seed {seed}, {method}: {off:.1f} standard errors ({described})")
    print(f"\n{COUNT} random clean records from seed {FIRST}, {coefficients} coefficients of trusted answers")
    for name, counter in counts.items():
        print(f"  {name:<9}", ", ".join(f"{count} {what}" for what, count in counter.most_common()))
    print(f"  trusted beyond {FAR:g} standard errors: {len(wrong)}", *wrong, sep="\n    ")
    print(f"  false terms called certain: {len(false)}", *false, sep="\n    ")
    assert len(wrong) <= 1
    assert not false
