"""A slender cantilever by three modes, and what accelerometers show of a hammer on it."""

from functools import cache

import numpy as np
from structures import CANTILEVER, CANTILEVER_SHAPES, host, link, structure

import linkwise as lw

SHAPES = {point: CANTILEVER_SHAPES[point] for point in ("tip", "mid")}
DAMPING = 0.01
TAP = "8*exp(-((t - 0.05)/0.004)**2)"  # N, of a hammer


def beam() -> lw.Host:
    return host("beam", CANTILEVER, DAMPING, SHAPES)


@cache
def tapped(point: str = "tip", *, release: float = 0.0, cubic: float = 0.0, level: float = 1.0) -> lw.Record:
    """A tap at a point, and two accelerometers; `release` in sqrt(kg) m/s of the first mode, a spring in N/m^3 at the tip."""
    links = [link("stop", "beam.tip-ground", "k3*d**3", k3=cubic)] if cubic else []
    return lw.simulate(
        structure({}, *links, hosts=[beam()]),
        forces={f"beam.{point}": f"{level}*{TAP}"},
        release={"v:beam.mode1": release} if release else {},
        duration=1.5,
        rate=400.0,
        sensors=["a:beam.tip", "a:beam.mid"],
    )


@cache
def shaken(seed: int, *, cubic: float = 0.0, samples: int = 3200, highest: float = 80.0) -> lw.Record:
    """A random force at the tip up to a `highest` frequency in Hz, and two accelerometers; `cubic` is a spring in N/m^3."""
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(samples))
    spectrum[round(samples * highest / 400.0) :] = 0.0
    links = [link("stop", "beam.tip-ground", "k3*d**3", k3=cubic)] if cubic else []
    return lw.simulate(
        structure({}, *links, hosts=[beam()]),
        forces={"beam.tip": lw.model.Sampled(0.0, 400.0, np.fft.irfft(spectrum), band_limited=True)},
        duration=(samples - 1) / 400.0,
        rate=400.0,
        sensors=["a:beam.tip", "a:beam.mid"],
    )
