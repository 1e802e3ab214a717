"""The Bouc-Wen benchmark (Noel, Schoukens 2016): its coefficients from no starts, and predictions of records never shown.

The record to identify from is not part of linkwise; the benchmarks are skipped where the folder ../shared/data is not beside
the checkout. The authors' test records are not there: a multisine and a sweep as they describe them are integrated as they
did, by Newmark's average acceleration at 15 kHz, which has to give the mean of the periods in the training record again.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from time import process_time

import h5py
import numpy as np
import pytest

import linkwise as lw

FILE = Path(__file__).resolve().parents[2] / "shared" / "data" / "bouc_wen_train.h5"
RATE, FINER, PERIOD = 750.0, 20, 8192
TRUE = {
    "m1.mass": 2.0,
    "joint.c": 10.0,
    "joint.k": 5e4,
    "joint.kh": 5e4,
    "joint.beta": 800.0,
    "joint.gamma": -1100.0,
}
MOST = 6e-7  # m; the best published model leaves 1.9e-5
SEED = 71


@cache
def shown() -> tuple[np.ndarray, np.ndarray]:
    """Force and noisy displacement of the five periods, or a skip."""
    if not FILE.exists():
        pytest.skip(f"no {FILE.name} beside the checkout")
    with h5py.File(FILE) as file:
        force, displacement = (np.ravel(file[f"multisine/{name}"][:]) for name in ("u", "y"))
    return force, displacement


@cache
def identified() -> tuple[lw.Estimate, float]:
    """The named law and the mass from all periods, and CPU-s."""
    record = lw.Record(0.0, RATE, ("x:m1", "force:m1"), np.column_stack(shown()[::-1]))
    joint = lw.model.named_law("bouc-wen-classical").link("joint", ("m1", "ground"))
    began = process_time()
    fit = lw.identify(record, lw.Structure("", (lw.Mass("m1", lw.Coefficient.unknown()),), (joint,)))
    return fit, process_time() - began


def by_newmark(force: np.ndarray) -> np.ndarray:
    """Displacements at the times of `force` at 15 kHz, from rest; the hysteretic force by trapezoids."""
    m, c, k, kh, beta, gamma = TRUE.values()
    h = 1.0 / (FINER * RATE)

    def rate(v: float, z: float) -> float:
        return kh * v - beta * abs(v) * z - gamma * v * abs(z)

    x = v = z = a = 0.0
    moved = np.zeros(len(force))
    for step, applied in enumerate(force[1:].tolist(), start=1):
        now, new, changed = rate(v, z), a, z
        for _ in range(6):  # of fixed-point iteration, each of which gains four digits
            velocity = v + 0.5 * h * (a + new)
            displacement = x + h * v + 0.25 * h * h * (a + new)
            changed = z + 0.5 * h * (now + rate(velocity, changed))
            last, new = new, (applied - c * velocity - k * displacement - changed) / m
            if abs(new - last) < 1e-12 * (1.0 + abs(new)):
                break
        v, x, z, a = v + 0.5 * h * (a + new), x + h * v + 0.25 * h * h * (a + new), changed, new
        moved[step] = x
    return moved


def periodic(period: np.ndarray, periods: int) -> np.ndarray:
    """A band-limited periodic force at 15 kHz."""
    return np.tile(np.fft.irfft(np.fft.rfft(period), FINER * len(period)) * FINER, periods)


def multisine() -> tuple[np.ndarray, np.ndarray]:
    """Two periods of another 50 N from 5 to 150 Hz, at 15 kHz, and whether a sample at 750 Hz is in the steady second one."""
    frequency = np.arange(PERIOD // 2 + 1) * RATE / PERIOD
    phases = 2.0 * np.pi * np.random.default_rng(SEED).random(len(frequency))
    period = np.fft.irfft(np.where((frequency >= 5.0) & (frequency <= 150.0), np.exp(1j * phases), 0.0))
    period *= 50.0 / np.sqrt(np.mean(period**2))
    return periodic(period, 2), np.arange(2 * PERIOD) >= PERIOD


def sweep() -> tuple[np.ndarray, np.ndarray]:
    """40 N from 20 to 50 Hz at 10 Hz a minute, at 15 kHz, of which every sample at 750 Hz counts."""
    time = np.arange(round(180.0 * FINER * RATE)) / (FINER * RATE)
    return 40.0 * np.sin(2.0 * np.pi * (20.0 + 5.0 / 60.0 * time) * time), np.ones(round(180.0 * RATE), bool)


def test_coefficients() -> None:
    """From no starts, the mass too, on all five periods: processor time, and what intervals hold.

    The authors' integrator makes the mass seem larger by 7e-4 at 150 Hz, where their multisine ends.
    """
    fit, seconds = identified()
    print(f"\nBouc-Wen, {seconds:.1f} CPU-s: {fit.message}")
    for name, true in TRUE.items():
        low, high = fit.coefficient(name).interval or (np.nan, np.nan)
        print(f"  {name} {fit.coefficient(name).value:.6g}, 95 % {low:.6g} to {high:.6g}, true {true:g}")
        assert low < (1.0 + 7e-4) * true if name == "m1.mass" else low < true < high
    assert fit.trusted and seconds < 60.0


def test_integrator_is_that_of_the_benchmark() -> None:
    """What it leaves of the mean of five periods is their noise."""
    force, displacement = shown()
    periods = displacement.reshape(-1, PERIOD)[1:]  # the first swings in
    steady = by_newmark(periodic(force[:PERIOD], 3))[2 * FINER * PERIOD :: FINER]
    left = float(np.sqrt(np.mean((periods.mean(axis=0) - steady) ** 2)))
    noise = float(np.sqrt(np.mean(periods.var(axis=0, ddof=1)) / len(periods)))
    print(f"\n  {left:.3g} m are left of the mean of {len(periods)} periods, whose noise is {noise:.3g} m")
    assert left < 1.03 * noise  # 4 standard errors of a mean square of 8192 samples


@pytest.mark.parametrize("signal", [multisine, sweep])
def test_prediction_of_what_was_never_shown(
    signal: Callable[[], tuple[np.ndarray, np.ndarray]],
) -> None:
    """From the samples of the force at 750 Hz alone, by the identified structure and by the true values."""
    force, counts = signal()
    moved, sampled = by_newmark(force)[::FINER], force[::FINER]
    fit, _ = identified()
    rmse = {}
    for label, structure in (("identified", fit.structure), ("true", fit.structure.with_values(TRUE))):
        predicted = lw.simulate(
            structure,
            duration=(len(sampled) - 1) / RATE,
            rate=RATE,
            forces={"m1": lw.model.Sampled(0.0, RATE, sampled, band_limited=True)},
        )
        left = (predicted.channel("x:m1") - moved)[counts]
        rmse[label] = float(np.sqrt(np.mean(left**2)))
    size = float(np.sqrt(np.mean(moved[counts] ** 2)))
    print(
        f"\n  {signal.__name__} of {size:.3g} m: RMSE {rmse['identified']:.3g} m, by the true values {rmse['true']:.3g} m"
    )
    assert rmse["identified"] < MOST
