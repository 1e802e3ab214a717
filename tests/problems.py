"""The problems that tests solve: structures with the records of their motion, and what is true of them."""

from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from structures import HARDENING, NES, link, oscillator, structure, with_links

import linkwise as lw


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


def parsed(*names: str) -> tuple[lw.records.Channel, ...]:
    """The channels of these names."""
    return tuple(map(lw.records.Channel.parse, names))


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
    """The paper's chain, discovered between its masses from three seconds of its record with noise in dB."""
    chain = lw.bnes_chain(masses)
    kilograms = dict(zip(chain.mass_names, chain.mass_values.tolist(), strict=True))
    return lw.discover(chain_record(masses, duration=3.0).with_noise(snr_db, seed=seed), kilograms)


def rubbing_trio() -> lw.Structure:
    """A mass that carries a bistable sink and a slider, which a second sink with the alpha of the first joins."""
    return structure(
        {"m1": 1.0, "m2": 0.01, "m3": 0.02},
        link("spring", "m1-base", "k*d + c*v", k=30000.0, c=1.0),
        link("nes1", "m2-m1", NES, alpha=-100.0, beta=1e6, c=0.02),
        link("friction", "m3-m1", "F*tanh(v/s)", F=1.0, s=0.5),
        link("nes2", "m3-m2", NES, alpha=lw.Coefficient.shared("nes1.alpha"), beta=8e5, c=0.03),
    )


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
    """A mass on a linear spring, a hardening one between it and the second, quadratic damping between that and the third."""
    return structure(
        {"m1": 1.0, "m2": 0.5, "m3": 0.2},
        link("spring", "m1-ground", "k*d + c*v", k=9e3, c=1.5),
        link("hardening", "m2-m1", HARDENING, k=2e3, k3=4e7, c=0.4),
        link("quadratic", "m3-m2", "k*d + c*v*abs(v)", k=900.0, c=2.0),
        name="trio",
    )


def _pair(*more: lw.Link, end: str = "ground") -> lw.Structure:
    """A mass on a spring, a smaller one on a hardening spring; what else there is stands between these two links."""
    spring = link("spring", f"m1-{end}", "k*d + c*v", k=3e3, c=4.0)
    hard = link("hard", "m2-m1", HARDENING, k=200.0, k3=1e6, c=0.3)
    return structure({"m1": 1.0, "m2": 0.1}, spring, *more, hard, name="pair")


def _gap() -> lw.Structure:
    """A mass on a spring with a stop behind a clearance."""
    spring = link("spring", "m1-ground", "k*d + c*v", k=1e3, c=1.0)
    return structure(
        {"m1": 1.0}, spring, link("stop", "m1-ground", "k*max(d - g, 0)", k=2e4, g=0.005), name="gap"
    )


@cache
def linear_chain(masses: int) -> Problem:
    """The paper's chain with linear springs in place of its sinks."""
    chain = lw.bnes_chain(masses)
    springs = [
        link(sink.name, "-".join(sink.between), "k*d + c*v", k=400.0, c=0.02)
        for sink in chain.links
        if sink.name.startswith("nes")
    ]
    return Problem(f"linear chain of {masses}", with_links(chain, *springs), _HIT, 20.0)


@cache
def bent_chain(k2: float) -> Problem:
    """The paper's chain of two masses, whose sink bends a little to one side, `k2` in N/m^2."""
    text = lw.model.format_structure(lw.bnes_chain(2))
    bent = text.replace("alpha*d +", "alpha*d + k2*d**2 +").replace("{ alpha", f"{{ k2 = {k2}, alpha")
    return Problem(f"chain with k2 of {k2}", lw.parse_structure(bent), _HIT, 30.0, duration=2.0)


_HIT: dict[str, Any] = {"release": {"v:m1": 1.0}}
_LOAD = link("load", "m1-ground", "f0", f0=-3.0)

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
