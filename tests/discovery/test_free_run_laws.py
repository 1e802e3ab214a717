"""Records behind anti-alias filters: what these make of the highest harmonics is no term of the laws."""

from __future__ import annotations

from functools import cache
from typing import NoReturn

import numpy as np
import pytest
import scipy.signal
from present import some
from structures import oscillator

import linkwise as lw
from linkwise.discovery import inexact

RATE, FINER, DURATION = 600.0, 8, 40.0
TERMS = "d, d**3, v, v*abs(v), v*d**2, v**3"
TRUE = {"d", "d**3", "v"}


@cache
def filtered_record(seed: int = 5_090_000) -> lw.Record:
    """A hardening oscillator at 65 Hz under a multisine up to 200 Hz, both channels behind a filter at 215 Hz."""
    rng = np.random.default_rng(seed)
    k, c = (2.0 * np.pi * 65.0) ** 2, 45.0
    truth = oscillator("k*d + c*v + k3*d**3", mass=1.0, name="m1-ground", k=k, c=c, k3=6.0 * k)
    rate = FINER * RATE
    samples = round(DURATION * rate)
    frequency = np.fft.rfftfreq(samples, 1.0 / rate)
    band = (frequency > 1.0) & (frequency < 200.0)
    spectrum = np.where(band, np.exp(2j * np.pi * rng.uniform(size=len(band))), 0.0)
    w = 2.0 * np.pi * frequency
    linear = np.fft.irfft(spectrum / (k - w**2 + 1j * w * c), samples)
    force = np.fft.irfft(spectrum, samples) * 0.06 / linear.std()
    run = lw.simulate(
        truth, forces={"m1": lw.model.Sampled(0.0, rate, force)}, duration=(samples - 1) / rate, rate=rate
    )
    behind = scipy.signal.ellip(7, 0.1, 70.0, 215.0, fs=rate, output="sos")
    u, x = (scipy.signal.sosfilt(behind, signal)[::FINER].copy() for signal in (force, run.channel("x:m1")))
    return lw.Record.from_arrays(np.arange(len(x)) / RATE, {"force:m1": u, "x:m1": x}).with_noise(
        65.0, seed=seed
    )


def discovered() -> lw.Discovery:
    record = filtered_record()
    return lw.discover(record[: 3 * len(record) // 4], {"m1": 1.0}, terms=TERMS)


def left_by_free_run(discovery: lw.Discovery) -> float:
    record = filtered_record()
    return float(lw.analysis.free_run(discovery.structure, record[3 * len(record) // 4 :]).rmse["x:m1"])


def refused(*_: object, **__: object) -> NoReturn:
    raise lw.IdentificationError("the motion runs to infinity")


@pytest.fixture(scope="module")
def held() -> lw.Discovery:
    """What is found with the laws that the free run asks for."""
    return discovered()


def test_what_filters_make_of_harmonics_is_no_damping(
    held: lw.Discovery, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert held.trusted and lw.Verdict.MODEL_ERROR_NEEDED in held.verdicts
    assert {term.term for term in held.kept} == TRUE
    [remark] = [text for text in held.remarks if "Held to the laws" in text]
    assert "v*d**2" in remark
    for coefficient, true in (("k", (2.0 * np.pi * 65.0) ** 2), ("c", 45.0)):
        low, high = held.estimate.coefficient(f"m1-ground.{coefficient}").interval or (np.nan, np.nan)
        assert low < true < high
    monkeypatch.setattr(inexact, "likelihood_fit", refused)
    loose = discovered()
    assert {term.term for term in loose.kept} > TRUE
    assert not [text for text in loose.remarks if "Held to the laws" in text]
    assert left_by_free_run(held) < 0.95 * left_by_free_run(loose)


def test_dropped_terms_are_printed_with_their_functions(held: lw.Discovery) -> None:
    steps = [line for line in str(held).splitlines() if " + m1-ground." in line]
    assert all("(v" in line for line in some(steps))
