"""A linear chain of five masses, 120 s at 100 Hz, with a noisy load cell and in ambient vibration: coverage and false terms.

LINKWISE_SEEDS says how many records of each (default 3; 20 are asked).
"""

from __future__ import annotations

import os

import numpy as np
import pytest
import scipy

import linkwise as lw
from linkwise.arrays import Floats

SEEDS = int(os.environ.get("LINKWISE_SEEDS", "3"))
FIRST_SEED = 8_000_000  # of no test
MASSES, RATE, DURATION = 5, 100.0, 120.0
STIFFNESS, DAMPING = 1000.0, 1.0  # N/m, N s/m of every link; masses of 1 kg: modes from 1.4 to 9.7 Hz
SUBSTEPS = 8  # in a sample, over which the forces are constant
BAND = 0.3  # of the sampling rate, up to which the measured force reaches
STEADY = 60.0  # s of ambient vibration before a record, after which its start is forgotten


def _chain(law: str) -> lw.Structure:
    terms = lw.Law.parse(law)
    values = {"k": STIFFNESS, "c": DAMPING, "k3": 0.0}
    links = tuple(
        lw.Link(
            f"l{i}",
            (f"m{i}", f"m{i - 1}" if i > 1 else "ground"),
            terms,
            {name: lw.Coefficient.number(values[name]) for name in terms.coefficients},
        )
        for i in range(1, MASSES + 1)
    )
    masses = tuple(lw.Mass(f"m{i}", lw.Coefficient.number(1.0)) for i in range(1, MASSES + 1))
    return lw.Structure("chain", masses, links)


def _displacements(forces: Floats) -> Floats:
    """(N, n) at the samples, forces (N * SUBSTEPS, n) in N being constant in each substep."""
    incidence = np.eye(MASSES) - np.eye(MASSES, k=1)
    zero, one = np.zeros((MASSES, MASSES)), np.eye(MASSES)
    pairs = incidence @ incidence.T
    matrix = np.block([[zero, one, zero], [-STIFFNESS * pairs, -DAMPING * pairs, one], [zero, zero, zero]])
    step = scipy.linalg.expm(matrix / (RATE * SUBSTEPS))[: 2 * MASSES]
    onward, pushed = step[:, : 2 * MASSES], forces @ step[:, 2 * MASSES :].T
    state, out = np.zeros(2 * MASSES), np.empty((len(forces) // SUBSTEPS, MASSES))
    for number, push in enumerate(pushed):
        if number % SUBSTEPS == 0:
            out[number // SUBSTEPS] = state[:MASSES]
        state = onward @ state + push
    return out


def _noisy(values: Floats, decibels: float, rng: np.random.Generator) -> Floats:
    size = np.sqrt(np.mean(values**2, axis=0)) * 10.0 ** (-decibels / 20.0)
    return values + size * rng.standard_normal(values.shape)


def _record(channels: list[str], columns: Floats) -> lw.Record:
    return lw.Record(0.0, RATE, tuple(channels), columns)


def load_cell(seed: int) -> lw.Record:
    """A force on m1 by a load cell with noise at 40 dB, displacements at 40 dB."""
    rng, count = np.random.default_rng(seed), int(DURATION * RATE)
    spectrum = np.fft.rfft(rng.standard_normal(count))
    spectrum[np.fft.rfftfreq(count) > BAND] = 0.0
    fine = np.zeros(count * SUBSTEPS // 2 + 1, dtype=complex)
    fine[: len(spectrum)] = spectrum
    middles = np.exp(1j * np.pi * np.fft.rfftfreq(count * SUBSTEPS))
    forces = np.zeros((count * SUBSTEPS, MASSES))
    forces[:, 0] = SUBSTEPS * np.fft.irfft(fine * middles, count * SUBSTEPS)
    applied = np.fft.irfft(spectrum, count)
    columns = _noisy(np.column_stack([_displacements(forces), applied]), 40.0, rng)
    return _record([*(f"x:m{i}" for i in range(1, MASSES + 1)), "force:m1"], columns)


def ambient(seed: int) -> lw.Record:
    """White forces of 1 N a sample on every mass, which no channel shows, and displacements at 40 dB."""
    rng, count = np.random.default_rng(seed), int((STEADY + DURATION) * RATE)
    forces = np.sqrt(SUBSTEPS) * rng.standard_normal((count * SUBSTEPS, MASSES))
    displacements = _displacements(forces)[int(STEADY * RATE) :]
    return _record([f"x:m{i}" for i in range(1, MASSES + 1)], _noisy(displacements, 40.0, rng))


@pytest.mark.parametrize(
    ("make", "options"),
    [(load_cell, {}), (load_cell, {"input_noise": "all"}), (ambient, {}), (ambient, {"ambient": "all"})],
    ids=["load cell, not stated", "load cell", "ambient, not stated", "ambient"],
)
@pytest.mark.parametrize("law", ["k*d + c*v", "k*d + c*v + k3*d**3"])
def test_coverage(make, options, law: str) -> None:  # type: ignore[no-untyped-def]
    chain = _chain(law)
    true = np.array([float(chain.coefficient(p.name).value or 0.0) for p in chain.unknown("all").parameters])
    cubic = np.array([p.name.endswith("k3") for p in chain.unknown("all").parameters])
    errors, trusted, seconds, sizes = [], 0, [], []
    for seed in range(FIRST_SEED, FIRST_SEED + SEEDS):
        fit = lw.identify(make(seed), chain.unknown("all"), **options)
        seconds.append(fit.seconds)
        if fit.trusted:
            trusted += 1
            errors.append((fit.values - true) / np.sqrt(fit.covariance.diagonal()))
            sizes.append([force.deviation for force in fit.random_forces])
    print(f"\n{make.__name__}, {options or 'nothing stated'}, {law}: {trusted} of {SEEDS} trusted")
    print(f"  median {np.median(seconds):.0f} s")
    if not errors:
        return
    z = np.array(errors)
    inside = np.abs(z) < scipy.stats.norm.ppf(0.975)
    print(f"  coverage of 95 % intervals {100 * inside.mean():.1f} %, z rms {np.sqrt(np.mean(z**2)):.2f}")
    print(
        f"  largest error {np.abs(z).max():.2f} standard errors, of cubic terms {np.abs(z[:, cubic]).max(initial=0.0):.2f}"
    )
    print(
        f"  deviations found, N: {np.round(np.mean(sizes, axis=0), 4)}, scatter {np.round(np.std(sizes, axis=0), 4)}"
    )
    if options and SEEDS >= 20:
        assert trusted == SEEDS
        assert 0.9 <= inside.mean() <= 0.98
        assert np.abs(z[:, cubic]).max(initial=0.0) < 4.0
