"""Links alone on a rig, and what sensors on it record."""

from dataclasses import replace

import numpy as np
from structures import link, named, structure

import linkwise as lw

BOUC_WEN = {"k": 2000.0, "c": 50.0, "F": 100.0, "x0": 1e-3, "s": 0.7}
MOTION = "0.01*sin(5*t)*sin(0.7*t) + 0.003*sin(17*t)"


def rig(law: str, values: dict[str, float], states: dict[str, str] | None = None) -> lw.Structure:
    """A link of this law alone on a rig."""
    return structure({}, link("damper", "base-ground", law, states, **values), name="rig")


def hysteretic() -> lw.Structure:
    """A Bouc-Wen link alone on a rig, whose coefficients keep their bounds where they are made unknown."""
    return structure({}, named("damper", "base-ground", "bouc-wen", **BOUC_WEN), name="rig")


def run(structure: lw.Structure, duration: float = 10.0, rate: float = 200.0) -> lw.Record:
    """What a load cell shows of it without noise."""
    return lw.simulate(structure, duration=duration, rate=rate, base=MOTION)


def measured(
    record: lw.Record, seed: int, *, force: float = 1.0, displacement: float = 2e-5, step: float = 0.0
) -> lw.Record:
    """The record with noise of its force in N and displacement in m, which may be rounded to a `step` in m."""
    rng = np.random.default_rng(seed)
    values = record.values.copy()
    on_base = record.channels.index("x:base")
    values[:, 1 - on_base] += force * rng.standard_normal(len(record))
    values[:, on_base] += displacement * rng.standard_normal(len(record))
    if step:
        values[:, on_base] = step * np.round(values[:, on_base] / step)
    return replace(record, values=values, simulated=None)
