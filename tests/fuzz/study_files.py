"""Study files, sound and damaged. They are read and not run: what a study runs is what the other commands do."""

from __future__ import annotations

from random import Random

from fuzz.case import Case, Kind
from fuzz.damage import damaged_bytes, damaged_text
from fuzz.structures import sound_structures

_STUDY = """name = "small"
snr_db = [40, 20.5]
first_seed = 1000
cycles = 4
quick = 1

[[structure]]
bnes = 2
release = { "v:m1" = 1.0 }
duration = 0.5
rate = 1000.0
unknown = ["nes"]
judge = ["nes1"]

[[structure]]
name = "other"
file = "s.toml"
impulse = [{ mass = "m1", momentum = 0.3, time = 0.1 }]
forces = { m1 = "sin(30*t)" }
scatter = 1e-10
duration = 0.5
rate = 1000.0

[[method]]
kind = "weak"

[[method]]
kind = "monomial"
convention = "states"
order = 3

[[method]]
kind = "physics-informed"
regressor = "l1"
"""


def study_case(seed: int, rng: Random) -> Case:
    content = damaged_text(rng, _STUDY).encode("utf-8", "surrogatepass")
    if rng.random() < 0.1:
        content = damaged_bytes(rng, content)
    files = {"study.toml": content, "s.toml": sound_structures()[0].encode()}
    return Case(seed, "study", Kind.COMMAND, ("study", "study.toml", "--export", "-o", "out"), files)
