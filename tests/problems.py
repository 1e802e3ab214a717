"""The problems that tests solve: structures with the records of their motion, and what is true of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

import linkwise as lw
from linkwise.model.law import Law


@dataclass(frozen=True, eq=False)
class Problem:
    """A structure, what moves it, for how long and how often it is recorded, the noise that is added in dB, what is asked.

    `drive` are keywords of `simulate`: `release`, `forces` or `base`. Of the structure, `unknown` is unknown; `starts` are
    those of coefficients that enter their law nonlinearly.
    """

    name: str
    structure: lw.Structure
    drive: dict[str, Any]
    snr_db: float
    duration: float = 6.0
    rate: float = 1000.0
    unknown: tuple[str, ...] = ("all",)
    starts: dict[str, float] = field(default_factory=dict)

    @cached_property
    def clean(self) -> lw.Record:
        """The motion without noise."""
        return lw.simulate(self.structure, duration=self.duration, rate=self.rate, **self.drive)

    @cached_property
    def unknown_structure(self) -> lw.Structure:
        """The structure with its unknowns."""
        freed = self.structure.unknown(*self.unknown)
        for parameter, start in self.starts.items():
            owner, _, name = parameter.rpartition(".")
            changed = {name: lw.Coefficient.unknown(start)}
            links = [
                replace(link, coefficients={**link.coefficients, **changed}) if link.name == owner else link
                for link in freed.links
            ]
            freed = replace(freed, links=tuple(links))
        return freed

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
    hit: str = "m1",
) -> lw.Record:
    """The exact motion of the paper's chain, the mass `hit` released at `speed` in m/s, as in the paper unless given."""
    release = {f"v:{hit}": paper_speed(masses) if speed is None else speed}
    return lw.simulate(lw.bnes_chain(masses), release=release, duration=duration, rate=rate, sensors=sensors)


@cache
def chain_fit(
    masses: int, snr_db: float, seed: int, sensors: tuple[str, ...] = ("x",), *, duration: float = 6.0
) -> lw.Estimate:
    """All coefficients of the paper's chain, identified from its record with noise in dB."""
    record = chain_record(masses, sensors=sensors, duration=duration).with_noise(snr_db, seed=seed)
    return lw.identify(record, lw.bnes_chain(masses).unknown("all"))


@cache
def chain_discovery(masses: int, snr_db: float, seed: int) -> lw.Discovery:
    """The paper's chain, discovered between its masses from its record of six seconds with noise in dB."""
    chain = lw.bnes_chain(masses)
    kilograms = dict(zip(chain.mass_names, chain.mass_values.tolist(), strict=True))
    return lw.discover(chain_record(masses).with_noise(snr_db, seed=seed), kilograms)


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


def oscillator(
    law: str,
    *,
    mass: float | lw.Coefficient = 1.0,
    to: str = "ground",
    name: str = "link",
    **values: float | lw.Coefficient,
) -> lw.Structure:
    """One mass on one link, to the ground unless `to` the base."""
    link = lw.Link(
        name, ("m1", to), Law.parse(law), {key: _coefficient(value) for key, value in values.items()}
    )
    return lw.Structure("oscillator", (lw.Mass("m1", _coefficient(mass)),), (link,))


def asked_oscillator(law: str, mass: float | None = None, *, name: str = "spring") -> lw.Structure:
    """One mass on one link, of which all is unknown but, where it is given, the mass."""
    unknown = lw.Coefficient.unknown()
    coefficients: dict[str, Any] = dict.fromkeys(Law.parse(law).coefficients, unknown)
    return oscillator(law, mass=unknown if mass is None else mass, name=name, **coefficients)


def row_of_masses(
    masses: Sequence[float], **links: tuple[str, Mapping[str, float | lw.Coefficient]]
) -> lw.Structure:
    """Masses m1, m2, ... each on a link, by its law and coefficients, to the one before, and the first to the ground."""
    names = [f"m{k}" for k in range(1, len(masses) + 1)]
    joined = tuple(
        lw.Link(name, ends, Law.parse(law), {key: _coefficient(value) for key, value in values.items()})
        for ends, (name, (law, values)) in zip(
            zip(names, ["ground", *names[:-1]], strict=True), links.items(), strict=True
        )
    )
    bodies = tuple(lw.Mass(name, _coefficient(mass)) for name, mass in zip(names, masses, strict=True))
    return lw.Structure("row", bodies, joined)


def _coefficient(value: float | lw.Coefficient) -> lw.Coefficient:
    return value if isinstance(value, lw.Coefficient) else lw.Coefficient.number(value)


def truth(structure: lw.Structure, unknown: lw.Structure) -> np.ndarray:
    """(p,) what the unknowns of `unknown` are in `structure`."""
    masses = dict(zip(structure.mass_names, structure.mass_values, strict=True))
    return np.array(
        [
            masses[p.name.removesuffix(".mass")]
            if p.name.endswith(".mass")
            else structure.coefficient(p.name).value
            for p in unknown.parameters
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


def _pair(*more: lw.Link, end: str = "ground") -> lw.Structure:
    """A mass on a spring, a smaller one on a hardening spring; what else there is stands between these two links."""
    number = lw.Coefficient.number
    spring = lw.Link("spring", ("m1", end), Law.parse("k*d + c*v"), {"k": number(3e3), "c": number(4.0)})
    hard = lw.Link(
        "hard",
        ("m2", "m1"),
        Law.parse("k*d + k3*d**3 + c*v"),
        {"k": number(200.0), "k3": number(1e6), "c": number(0.3)},
    )
    masses = (lw.Mass("m1", number(1.0)), lw.Mass("m2", number(0.1)))
    return lw.Structure("pair", masses, (spring, *more, hard))


def _gap() -> lw.Structure:
    """A mass on a spring with a stop behind a clearance."""
    number = lw.Coefficient.number
    spring = lw.Link("spring", ("m1", "ground"), Law.parse("k*d + c*v"), {"k": number(1e3), "c": number(1.0)})
    stop = lw.Link(
        "stop", ("m1", "ground"), Law.parse("k*max(d - g, 0)"), {"k": number(2e4), "g": number(0.005)}
    )
    return lw.Structure("gap", (lw.Mass("m1", number(1.0)),), (spring, stop))


@cache
def linear_chain(masses: int) -> Problem:
    """The paper's chain with linear springs in place of its sinks."""
    chain = lw.bnes_chain(masses)
    law, number = Law.parse("k*d + c*v"), lw.Coefficient.number
    links = [
        replace(link, law=law, coefficients={"k": number(400.0), "c": number(0.02)})
        if link.name.startswith("nes")
        else link
        for link in chain.links
    ]
    return Problem(f"linear chain of {masses}", replace(chain, links=tuple(links)), _HIT, 20.0)


@cache
def bent_chain(k2: float) -> Problem:
    """The paper's chain of two masses, whose sink bends a little to one side, `k2` in N/m^2."""
    text = lw.format_structure(lw.bnes_chain(2))
    bent = text.replace("alpha*d +", "alpha*d + k2*d**2 +").replace("{ alpha", f"{{ k2 = {k2}, alpha")
    return Problem(f"chain with k2 of {k2}", lw.parse_structure(bent), _HIT, 30.0, duration=2.0)


_HIT: dict[str, Any] = {"release": {"v:m1": 1.0}}
_LOAD = lw.Link("load", ("m1", "ground"), Law.parse("f0"), {"f0": lw.Coefficient.number(-3.0)})

PROBLEMS = {
    problem.name: problem
    for problem in (
        Problem("two masses, 20 dB", lw.bnes_chain(2), _HIT, 20.0, 4.0),
        Problem("four masses, 20 dB", lw.bnes_chain(4), {"release": {"v:m1": 3.0}}, 20.0, 4.0),
        Problem("two masses, 40 dB, sampled twice as often", lw.bnes_chain(2), _HIT, 40.0, 3.0, 2000.0),
        Problem(
            "linear, hardening and quadratic links",
            _trio(),
            {"release": {"v:m1": 1.0, "v:m3": -2.0}},
            30.0,
            4.0,
        ),
        Problem(
            "masses unknown, a force applied",
            _pair(),
            {"forces": {"m1": "30*sin(50*t) + 40*sin(31*t + 1) + 30*sin(97*t)"}},
            45.0,
            4.0,
            unknown=("all", "mass:m1", "mass:m2"),
        ),
        Problem("base moved", _pair(end="base"), {"base": "0.01*sin(50*t) + 0.004*sin(31*t + 1)"}, 35.0, 4.0),
        Problem("constant force", _pair(_LOAD), _HIT, 40.0, 4.0),
        Problem("clearance", _gap(), _HIT, 40.0, 4.0, starts={"stop.g": 0.0025}),
        Problem(
            "friction curved in v",
            oscillator("k*d + F*tanh(v/s)", k=1e3, F=2.0, s=0.2),
            _HIT,
            50.0,
            4.0,
            starts={"link.s": 0.1},
        ),
    )
}
