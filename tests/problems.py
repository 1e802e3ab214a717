"""The problems that tests solve: structures with the records of their motion, and what is true of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache, cached_property

import numpy as np

import linkwise as lw
from linkwise.model.law import Law


@dataclass(frozen=True, eq=False)
class Problem:
    """A structure, how it is released, for how long and how often it is recorded, and the noise that is added in dB."""

    name: str
    structure: lw.Structure
    release: dict[str, float]
    snr_db: float
    duration: float = 6.0
    rate: float = 1000.0
    sensors: tuple[str, ...] = field(default=("x",))

    @cached_property
    def clean(self) -> lw.Record:
        """The motion without noise."""
        return lw.simulate(
            self.structure, release=self.release, duration=self.duration, rate=self.rate, sensors=self.sensors
        )

    def record(self, seed: int = 1) -> lw.Record:
        """The motion with noise."""
        return self.clean.with_noise(self.snr_db, seed=seed)

    def errors(self, fit: lw.Estimate) -> np.ndarray:
        """(p,) errors of the coefficients that `fit` found, in its standard errors."""
        deviations = np.sqrt(fit.covariance.diagonal())
        return np.asarray((fit.values - truth(self.structure, fit.given_structure)) / deviations)


def paper_speed(masses: int) -> float:
    """Velocity in m/s at which the paper releases the first mass of its chain."""
    return 1.0 if masses == 2 else 3.0


@cache
def chain_record(
    masses: int,
    *,
    duration: float = 6.0,
    rate: float = 1000.0,
    sensors: tuple[str, ...] = ("x",),
    speed: float | None = None,
) -> lw.Record:
    """The exact motion of the paper's chain, its first mass released at `speed` in m/s, as in the paper unless given."""
    release = {"v:m1": paper_speed(masses) if speed is None else speed}
    return lw.simulate(lw.bnes_chain(masses), release=release, duration=duration, rate=rate, sensors=sensors)


THREE = """
[[mass]]
name = "m1"
mass = 1.0
[[mass]]
name = "m2"
mass = 0.01
[[mass]]
name = "m3"
mass = 0.02
[[link]]
name = "spring"
between = ["m1", "base"]
law = "k*d + c*v"
coefficients = { k = 30000.0, c = 1.0 }
[[link]]
name = "nes1"
between = ["m2", "m1"]
law = "alpha*d + beta*d**3 + c*v"
coefficients = { alpha = -100.0, beta = 1e6, c = 0.02 }
[[link]]
name = "friction"
between = ["m3", "m1"]
law = "F*tanh(v/s)"
coefficients = { F = 1.0, s = 0.5 }
[[link]]
name = "nes2"
between = ["m3", "m2"]
law = "alpha*d + beta*d**3 + c*v"
coefficients = { alpha = "=nes1.alpha", beta = 8e5, c = 0.03 }
"""


def oscillator(law: str, *, mass: float = 1.0, to: str = "ground", **values: float) -> lw.Structure:
    """One mass on one link."""
    coefficients = {name: lw.Coefficient.number(value) for name, value in values.items()}
    link = lw.Link("link", ("m1", to), Law.parse(law), coefficients)
    return lw.Structure("oscillator", (lw.Mass("m1", lw.Coefficient.number(mass)),), (link,))


def truth(structure: lw.Structure, asked: lw.Structure) -> np.ndarray:
    """(p,) what the unknowns of `asked` are in `structure`."""
    masses = dict(zip(structure.mass_names, structure.mass_values, strict=True))
    return np.array(
        [
            masses[p.name.removesuffix(".mass")]
            if p.name.endswith(".mass")
            else structure.coefficient(p.name).value
            for p in asked.parameters
        ]
    )


def _trio() -> lw.Structure:
    """A mass on a linear spring, a hardening one between it and the second, friction between that and the third."""
    number = lw.Coefficient.number
    masses = tuple(lw.Mass(f"m{k}", number(kilograms)) for k, kilograms in ((1, 1.0), (2, 0.5), (3, 0.2)))
    links = (
        lw.Link("spring", ("m1", "ground"), Law.parse("k*d + c*v"), {"k": number(9e3), "c": number(1.5)}),
        lw.Link(
            "hardening",
            ("m2", "m1"),
            Law.parse("k*d + k3*d**3 + c*v"),
            {"k": number(2e3), "k3": number(4e7), "c": number(0.4)},
        ),
        lw.Link(
            "quadratic",
            ("m3", "m2"),
            Law.parse("k*d + c*v*abs(v)"),
            {"k": number(900.0), "c": number(2.0)},
        ),
    )
    return lw.Structure("trio", masses, links)


PROBLEMS = (
    Problem("two masses, 20 dB", lw.bnes_chain(2), {"v:m1": 1.0}, 20.0),
    Problem("four masses, 20 dB", lw.bnes_chain(4), {"v:m1": 3.0}, 20.0),
    Problem("two masses, 40 dB, sampled twice as often", lw.bnes_chain(2), {"v:m1": 1.0}, 40.0, 3.0, 2000.0),
    Problem("linear, hardening and quadratic links", _trio(), {"v:m1": 1.0, "v:m3": -2.0}, 30.0, 4.0),
)
