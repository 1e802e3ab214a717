"""Rigs under a hammer, a shaker or a moving base whose channels of inputs have noise, by seed: what laboratories record.

One to four masses in a chain from the ground, cubic springs and bistable sinks, displacements or accelerations with noise of
20 to 40 dB, and noise of the input of 0.01 to 1 % of its peak.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

import linkwise as lw

FINE = 8  # samples of the true input in one of the record


@dataclass(frozen=True, eq=False)
class Rig:
    """A rig with its record: the `truth`, what is `asked` of it, and the `share` of the input's peak that its noise has.

    `clean` gives the record without noise at so many times its rate.
    """

    truth: lw.Structure
    asked: lw.Structure
    record: lw.Record
    share: float
    decibels: float
    clean: Callable[[int], lw.Record]


def _link(name: str, between: tuple[str, str], law: str, **values: float) -> lw.Link:
    given = {key: lw.Coefficient.number(value) for key, value in values.items()}
    return lw.Link(name, between, lw.Law.parse(law), given)


def _chain(rng: np.random.Generator, size: int, ground: str) -> lw.Structure:
    masses = [float(rng.uniform(1.0, 3.0))] + [float(rng.uniform(0.1, 0.8)) for _ in range(size - 1)]
    links, below = [], ground
    for number, mass in enumerate(masses, start=1):
        name, frequency = f"m{number}", float(rng.uniform(4.0, 12.0))
        k = mass * (2.0 * np.pi * frequency) ** 2
        c = 2.0 * float(rng.uniform(0.005, 0.03)) * np.sqrt(k * mass)
        if number > 1 and rng.random() < 0.5:
            well = float(rng.uniform(2e-3, 8e-3))
            links.append(
                _link(
                    f"s{number}",
                    (name, below),
                    "alpha*d + beta*d**3 + c*v",
                    alpha=-k / 2,
                    beta=k / 2 / well**2,
                    c=c,
                )
            )
        else:
            k3 = float(rng.uniform(0.05, 0.5)) * k / 5e-3**2
            links.append(_link(f"s{number}", (name, below), "k*d + k3*d**3 + c*v", k=k, k3=k3, c=c))
        below = name
    named = tuple(lw.Mass(f"m{i}", lw.Coefficient.number(m)) for i, m in enumerate(masses, start=1))
    return lw.Structure("rig", named, tuple(links))


def _resting(structure: lw.Structure) -> dict[str, float]:
    """Displacements of the masses where every bistable sink rests in a well."""
    place, places = 0.0, {}
    for mass, link in zip(structure.masses, structure.links, strict=True):
        if "alpha" in link.values:
            place += float(np.sqrt(-link.values["alpha"] / link.values["beta"]))
        places[f"x:{mass.name}"] = place
    return {name: value for name, value in places.items() if value}


def _hammer(rng: np.random.Generator, duration: float, rate: float, mass: float) -> np.ndarray:
    time = np.arange(round(duration * rate * FINE) + 1) / (rate * FINE)
    width, start = float(rng.uniform(4e-3, 1e-2)), float(rng.uniform(0.05, 0.15))
    peak = float(rng.uniform(0.3, 1.2)) * mass * 2.0 / width
    phase = (time - start) / width
    return np.where((phase > 0.0) & (phase < 1.0), peak * np.sin(np.pi * phase) ** 2, 0.0)


def _random(rng: np.random.Generator, duration: float, rate: float, band: tuple[float, float]) -> np.ndarray:
    count = round((duration + 1.0) * rate * FINE)
    frequency = np.fft.rfftfreq(count, 1.0 / (rate * FINE))
    inside = (frequency > band[0]) & (frequency < band[1])
    spectrum = (rng.normal(size=len(inside)) + 1j * rng.normal(size=len(inside))) * inside
    signal = np.fft.irfft(spectrum, count)
    return np.asarray(signal / signal.std())


def rig(seed: int, kind: str = "hammer", *, unknown_mass: bool = False, share: float | None = None) -> Rig:
    """The rig of a seed: `kind` is hammer, shaker or base; `share` of the peak replaces a random one."""
    rng = np.random.default_rng([seed, 49])
    size, rate = int(rng.integers(1, 5)), float(rng.choice([500.0, 1000.0, 2000.0]))
    truth = _chain(rng, size, "base" if kind == "base" else "ground")
    duration = (
        float(np.exp(rng.uniform(np.log(0.6), np.log(5.0))))
        if kind == "hammer"
        else float(rng.uniform(2.0, 8.0))
    )
    rate = rate if kind == "hammer" else 250.0
    sensors = (["x", "a"][int(rng.integers(2))],)
    drive: dict[str, object] = {}
    if kind == "hammer":
        values = _hammer(rng, duration, rate, truth.mass_values[0])
        drive["forces"] = {"m1": lw.model.Sampled(0.0, rate * FINE, values, order=3)}
    else:
        signal = _random(rng, duration, rate, (1.0, 20.0))
        if kind == "shaker":
            level = 3e-3 * truth.links[0].values["k"] * float(rng.uniform(0.3, 1.0))
            drive["forces"] = {"m1": lw.model.Sampled(0.0, rate * FINE, level * signal)}
        else:
            drive["base"] = lw.model.Sampled(0.0, rate * FINE, 2e-3 * signal)
            sensors = [("rel:x", "a:base"), ("a", "a:base"), ("x", "x:base")][int(rng.integers(3))]

    def run(times: int) -> lw.Record:
        at = _resting(truth)
        return lw.simulate(truth, duration=duration, rate=times * rate, release=at, sensors=sensors, **drive)

    clean = run(1)
    decibels = float(rng.uniform(20.0, 40.0))
    share = float(np.exp(rng.uniform(np.log(1e-4), np.log(1e-2)))) if share is None else share
    record = clean.with_noise(decibels, seed=seed)
    columns = record.values.copy()
    for column, name in enumerate(record.channels):
        if name.is_input:
            exact = clean.values[:, column]
            columns[:, column] = exact + share * np.abs(exact).max() * rng.standard_normal(len(exact))
    asked = truth.unknown("all")
    if unknown_mass:
        free = replace(truth.masses[0], mass=lw.Coefficient.unknown())
        asked = replace(asked, masses=(free, *truth.masses[1:]))
    return Rig(truth, asked, replace(record, values=columns, simulated=None), share, decibels, run)
