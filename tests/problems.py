"""Structures that several tests identify, simulate or drive."""

from __future__ import annotations

import numpy as np

import linkwise as lw
from linkwise.model.law import Law

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
