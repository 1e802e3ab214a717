"""Inputs as they are: a base known by its acceleration or velocity alone or with noise, and held forces.

LINKWISE_SEEDS says how many records of each kind (default 20). Bases and forces are random, of other seeds than those of the
tests, and all records come from simulations in absolute coordinates.
"""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest

import linkwise as lw

SEEDS = int(os.environ.get("LINKWISE_SEEDS", "20"))
FIRST = 5000  # of the seeds
RATE, DURATION, SNR = 200.0, 10.0, 40.0
SENSORS = {
    "rel:x, a:base": ("rel:x", "a:base"),
    "rel:x, v:base": ("rel:x", "v:base"),
    "a, a:base": ("a", "a:base"),
}

NOISY = {
    "rel:x, a:base": ("rel:x", "a:base"),
    "a, a:base": ("a", "a:base"),
    "x, x:base": ("x", "x:base"),
}


def random_signal(rng: np.random.Generator, band: tuple[float, float]) -> np.ndarray:
    """Normal, of root mean square 1, flat from the lower to the upper frequency in Hz."""
    samples = round(DURATION * RATE) + 1
    frequency = np.fft.rfftfreq(samples, 1.0 / RATE)
    inside = (frequency > band[0]) & (frequency < band[1])
    spectrum = (rng.normal(size=len(inside)) + 1j * rng.normal(size=len(inside))) * inside
    signal = np.fft.irfft(spectrum, samples)
    return np.asarray(signal / signal.std())


def link(name: str, between: tuple[str, str], law: str, **values: float) -> lw.Link:
    given = {key: lw.Coefficient.number(value) for key, value in values.items()}
    return lw.Link(name, between, lw.Law.parse(law), given)


STOREYS = lw.Structure(
    "two storeys",
    (lw.Mass("m1", lw.Coefficient.number(1.0)), lw.Mass("m2", lw.Coefficient.number(0.5))),
    (
        link("lower", ("m1", "base"), "k*d + c*v", k=2000.0, c=1.0),
        link("upper", ("m2", "m1"), "k*d + k3*d**3 + c*v", k=1500.0, k3=4e6, c=0.5),
    ),
)
DUFFING = lw.Structure(
    "oscillator",
    (lw.Mass("m1", lw.Coefficient.number(1.0)),),
    (link("spring", ("m1", "ground"), "k*d + k3*d**3 + c*v", k=900.0, k3=2e5, c=2.0),),
)


def report(name: str, structure: lw.Structure, fits: list[lw.Estimate]) -> np.ndarray:
    """Errors in standard errors (fits, coefficients), with how many fits are trusted and what their intervals cover."""
    asked = fits[0].given_structure
    true = np.array([structure.coefficient(parameter.name).value for parameter in asked.parameters])
    trusted = [fit for fit in fits if fit.trusted]
    z = np.array([(fit.values - true) / np.sqrt(fit.covariance.diagonal()) for fit in trusted])
    covered = 100.0 * float(np.mean(np.abs(z) < 1.96)) if len(z) else 0.0
    worst = float(np.max(np.abs(z))) if len(z) else 0.0
    print(
        f"\n{name}: {len(trusted)} of {len(fits)} trusted, coverage {covered:.1f} %, largest error {worst:.1f}"
    )
    return z


@pytest.mark.parametrize("case", SENSORS)
def test_coverage_on_a_moving_base(case: str) -> None:
    fits = []
    for seed in range(FIRST, FIRST + SEEDS):
        base = lw.model.Sampled(0.0, RATE, 3e-3 * random_signal(np.random.default_rng(seed), (1.0, 14.0)))
        clean = lw.simulate(STOREYS, duration=DURATION, rate=RATE, base=base, sensors=SENSORS[case])
        fits.append(lw.identify(clean.with_noise(SNR, seed=seed), STOREYS.unknown("all")))
    z = report(case, STOREYS, fits)
    assert len(z) >= 0.9 * len(fits)


@pytest.mark.parametrize("decibels", [20.0, 40.0])
@pytest.mark.parametrize("case", [*NOISY, "not stated"])
def test_coverage_with_noise_of_the_base(case: str, decibels: float) -> None:
    """Stated as there, intervals hold the noise; not stated, what is trusted must not be far off."""
    sensors, fits = NOISY.get(case, ("rel:x", "a:base")), []
    for seed in range(FIRST, FIRST + SEEDS):
        rng = np.random.default_rng(seed)
        base = lw.model.Sampled(0.0, RATE, 3e-3 * random_signal(rng, (1.0, 14.0)))
        clean = lw.simulate(STOREYS, duration=DURATION, rate=RATE, base=base, sensors=sensors)
        record = clean.with_noise(SNR, seed=seed)
        values = record.values.copy()
        column = values[:, record.channels.index(sensors[-1])]
        column += 10.0 ** (-decibels / 20.0) * column.std() * rng.standard_normal(len(values))
        stated = "all" if case in NOISY else ()
        fits.append(lw.identify(replace(record, values=values), STOREYS.unknown("all"), input_noise=stated))
    z = report(f"{case}, noise of the base at {decibels:g} dB", STOREYS, fits)
    if case in NOISY:
        assert len(z) >= 0.9 * len(fits)
        assert SEEDS < 20 or 0.9 <= np.mean(np.abs(z) < 1.96) <= 0.98
    else:
        assert len(z) == 0 or np.max(np.abs(z)) < 5.0


@pytest.mark.parametrize("stated", [True, False], ids=["stated", "not stated"])
def test_coverage_under_a_held_force(stated: bool) -> None:
    """Taken for band-limited, a held force must not give trusted values that are off."""
    fits = []
    for seed in range(FIRST, FIRST + SEEDS):
        force = 5.0 * random_signal(np.random.default_rng(seed), (1.0, 12.0))[::2]
        signal = lw.model.Sampled(0.0, RATE / 2, force, order=0)
        clean = lw.simulate(DUFFING, duration=DURATION, rate=RATE / 2, forces={"m1": signal})
        record = clean.with_noise(SNR, seed=seed)
        record = replace(record, interpolation={"force:m1": "held"} if stated else {})
        fits.append(lw.identify(record, DUFFING.unknown("all")))
    z = report(f"held force, {'stated' if stated else 'not stated'}", DUFFING, fits)
    if stated:
        assert len(z) >= 0.9 * len(fits)
    else:
        assert len(z) == 0 or np.max(np.abs(z)) < 5.0
