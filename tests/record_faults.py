"""Records without a fault, and the faults that sensors and loggers give them."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from problems import chain_record
from structures import oscillator

import linkwise as lw
from linkwise.arrays import Floats

Fault = Callable[[np.ndarray, lw.Record, np.random.Generator], np.ndarray]


@cache
def forced(snr_db: float, seed: int = 1) -> lw.Record:
    """A Duffing oscillator under a sinusoidal force, seen in displacement, velocity and acceleration."""
    structure = oscillator("k*d + k3*d**3 + c*v", k=900.0, k3=2e6, c=1.5)
    forces, sensors = {"m1": "6*sin(38*t)"}, ("x", "v", "a")
    record = lw.simulate(
        structure, release={"x:m1": 0.01}, forces=forces, duration=12.0, rate=250.0, sensors=sensors
    )
    return record.with_noise(snr_db, seed=seed)


def chain(masses: int, snr_db: float, seed: int = 1, sensors: tuple[str, ...] = ("x",)) -> lw.Record:
    """The paper's chain."""
    return chain_record(masses, sensors=sensors).with_noise(snr_db, seed=seed)


RECORDS: dict[str, Callable[[], lw.Record]] = {
    **{
        f"chain of {masses}, {decibel:g} dB": partial(chain, masses, decibel)
        for masses in (2, 6)
        for decibel in (20.0, 40.0)
    },
    **{f"forced, {decibel:g} dB": partial(forced, decibel) for decibel in (20.0, 40.0)},
}
"""Records by name, each made when it is called."""


def changed(record: lw.Record, **samples: ArrayLike | Callable[[Floats], ArrayLike]) -> lw.Record:
    """The record with other samples of some channels, x_m1=... of x:m1, or with what a function makes of them."""
    values = record.values.copy()
    for name, given in samples.items():
        column = record.channels.index(name.replace("_", ":"))
        values[:, column] = given(record.values[:, column].copy()) if callable(given) else given
    return replace(record, values=values, simulated=None)


def without(record: lw.Record, **missing: Any) -> lw.Record:
    """The record without some samples of channels: x_m1=slice(5, 9), or what else selects them."""
    values = record.values.copy()
    for name, samples in missing.items():
        values[samples, record.channels.index(name.replace("_", ":"))] = np.nan
    return replace(record, values=values, simulated=None)


def faulty(record: lw.Record, channel: str, fault: Fault, seed: int = 7) -> lw.Record:
    """The record with a fault in one channel."""
    rng = np.random.default_rng(seed)
    return changed(record, **{channel: lambda samples: fault(samples, record, rng)})


def kinds(record: lw.Record, channel: str | None = None) -> set[str]:
    """The kinds of alerts of a record, or of one of its channels."""
    return {alert.kind for alert in lw.inspect(record).alerts if channel in (None, alert.channel)}
