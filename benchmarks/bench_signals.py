"""Laws that name recorded signals: a damper with a valve, a loudspeaker, a ball in a magnetic field; nothing is stated.

LINKWISE_SEEDS says how many records of each (default 20), or which of them, as 20:40, to run it in parts. Records of the
valve are simulated, those of the loudspeaker too, with its voltage as the only input; the ball hangs below a magnet in a
closed loop that SciPy integrates. Every seed has another excitation, noise and starts of the search. The seeds are others
than those of the tests.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from time import process_time

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import butter, sosfiltfilt

import linkwise as lw

FIRST = 49000  # of the seeds
_start, _, _stop = os.environ.get("LINKWISE_SEEDS", "20").rpartition(":")
SEEDS = range(FIRST + int(_start or "0"), FIRST + int(_stop))


def noise_in_band(
    rng: np.random.Generator, low: float, high: float, rate: float, count: int
) -> lw.model.Sampled:
    """A random signal of size one between two frequencies in Hz."""
    sections = butter(4, [low, high], "band", fs=rate, output="sos")
    values = sosfiltfilt(sections, rng.standard_normal(count + 400))[200:-200]
    return lw.model.Sampled(0.0, rate, values / values.std())


def scaled(drive: lw.model.Sampled, size: float, mean: float = 0.0) -> lw.model.Sampled:
    """The same signal of another size and mean."""
    return replace(drive, values=mean + size * drive.values)


def valve(rng: np.random.Generator) -> tuple[lw.Structure, lw.Record]:
    """A mass on a spring and a damper whose valve is moved while a force shakes it; its acceleration is not recorded."""
    structure = lw.rig(
        {"body": 12.0},
        {"strut": "body - ground: k*d + k3*d**3 + (c0 + cu*u + cuu*u**2)*v"},
        {"strut.k": 9000.0, "strut.k3": 3e6, "strut.c0": 25.0, "strut.cu": 18.0, "strut.cuu": 4.0},
        signals={"u": "V"},
    )
    count, rate = 3001, 300.0
    force = scaled(noise_in_band(rng, 0.5, 9.0, rate, count), 90.0)
    stem = scaled(noise_in_band(rng, 0.2, 2.0, rate, count), 0.8, mean=1.5)
    run = lw.simulate(
        structure, duration=10.0, rate=rate, forces={"body": force}, signals={"u": stem}, sensors=["x"]
    )
    return structure, run.with_noise(rng.uniform(25.0, 45.0), seed=int(rng.integers(2**31)))


def loudspeaker(rng: np.random.Generator) -> tuple[lw.Structure, lw.Record]:
    """A voice coil whose voltage is the input, with displacement and current recorded."""
    law = lw.Law.parse("k*d + k3*d**3 + c*v - Bl*i", {"i": "(u - R*i - Bl*v)/L"}, signals={"u": "V"})
    true = {"k": 2300.0, "k3": 2e7, "c": 1.2, "Bl": 5.3, "R": 6.4, "L": 4e-4}
    motor = lw.Link("motor", ("cone", "ground"), law, true)
    structure = lw.Structure("loudspeaker", (lw.Mass("cone", "12 g"),), (motor,))
    count, rate = 4001, 4000.0
    voltage = scaled(noise_in_band(rng, 10.0, 300.0, rate, count), 8.0)
    run = lw.simulate(
        structure, duration=1.0, rate=rate, signals={"u": voltage}, sensors=["x", "state:motor.i"]
    )
    return structure, run.with_noise(rng.uniform(30.0, 45.0), seed=int(rng.integers(2**31)))


def levitation(rng: np.random.Generator) -> tuple[lw.Structure, lw.Record]:
    """A ball below a magnet whose current a controller sets; x goes down, away from the magnet."""
    weight = 0.08 * 9.81
    structure = lw.rig(
        {"ball": 0.08},
        {"magnet": "ball - ground: K*(i/(gap + d))**2 - W"},
        {"magnet.K": 7e-5, "magnet.gap": 0.012, "magnet.W": weight},
        signals={"i": "A"},
    )
    K, gap = 7e-5, 0.012
    wanted = noise_in_band(rng, 0.3, 4.0, 1000.0, 3001)

    def current(time: float, x: float, v: float) -> float:
        held = np.sqrt(weight / K) * gap
        return float(held + 400.0 * (x - 7e-4 * wanted.value(time)) + 10.0 * v)

    def rates(time: float, state: np.ndarray) -> list[float]:
        x, v = state
        return [v, (weight - K * (current(time, x, v) / (gap + x)) ** 2) / 0.08]

    time = np.arange(3001) / 1000.0
    x, v = solve_ivp(rates, (0.0, 3.0), [0.0, 0.0], "DOP853", time, rtol=1e-11, atol=1e-13, max_step=1e-3).y
    channels = {"x:ball": x, "signal:i": np.array([current(*now) for now in zip(time, x, v, strict=True)])}
    record = lw.Record.from_arrays(time, channels)
    return structure, record.with_noise(rng.uniform(30.0, 50.0), seed=int(rng.integers(2**31)))


UNKNOWN = {"valve": ("all",), "loudspeaker": ("all",), "levitation": ("magnet.K", "magnet.gap")}


@pytest.mark.parametrize("rig", [valve, loudspeaker, levitation])
def test_coverage_with_signals(
    rig: Callable[[np.random.Generator], tuple[lw.Structure, lw.Record]],
) -> None:
    trusted, errors, seconds = 0, [], []
    for seed in SEEDS:
        structure, record = rig(np.random.default_rng(seed))
        began = process_time()
        fit = lw.identify(replace(record, simulated=None), structure.unknown(*UNKNOWN[rig.__name__]))
        seconds.append(process_time() - began)
        trusted += fit.trusted
        if fit.grade is lw.Grade.REFUSED:
            print(f"\n  seed {seed}: {fit.message[:110]}", end="")
            continue
        true = np.array([structure.coefficient(p.name).value for p in fit.parameters], dtype=float)
        errors.append((fit.values - true) / np.sqrt(fit.covariance.diagonal()))
    z = np.array(errors)
    covered = 100.0 * float(np.mean(np.abs(z) < 1.96))
    print(
        f"\n{rig.__name__}: {trusted} of {len(SEEDS)} trusted, coverage {covered:.1f} %, mean square of z "
        f"{np.mean(z**2):.2f}, worst {np.abs(z).max():.1f}; CPU-s median "
        f"{np.median(seconds):.1f}, worst {max(seconds):.1f}"
    )
    assert trusted >= 0.9 * len(SEEDS)
    assert np.abs(z).max() < 4.5
    assert np.mean(z**2) <= 1.0 + 3.0 * np.sqrt(2.0 / len(z))  # of coefficients that move together
