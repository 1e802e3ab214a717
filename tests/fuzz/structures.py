"""Structure files, sound and damaged, for every command that reads one."""

from __future__ import annotations

from functools import cache
from random import Random

import linkwise as lw
from fuzz.case import Case, Kind
from fuzz.damage import damaged_bytes, damaged_text
from fuzz.record_files import sound_record

_OTHERS = (
    '[[mass]]\nname = "m1"\nmass = "10 g"\n[[mass]]\nname = "m2"\nmass = { start = 0.01, lower = 0.001 }\n'
    '[[link]]\nname = "a"\nbetween = ["m1", "base"]\nlaw = "k*d + c*v"\ncoefficients = { k = "30 kN/m", c = "unknown" }\n'
    '[[link]]\nname = "b"\nbetween = ["m2", "m1"]\nlaw = "k*d + F*tanh(v/s)"\n'
    'coefficients = { k = "=a.k", F = { start = 1.0, lower = 0.0, upper = 5.0 }, s = 0.01 }\n',
    '[[mass]]\nname = "m1"\nmass = 1\n[[link]]\nname = "stop"\nbetween = ["m1", "ground"]\n'
    'law = "k*d + kc*max(abs(d) - g, 0)*sign(d) + c*v*abs(v)"\n'
    "coefficients = { k = 900.0, kc = 1e5, g = 0.01, c = 0.5 }\n",
)


@cache
def sound_structures() -> tuple[str, ...]:
    """Files that can be read."""
    chain = lw.bnes_chain(2)
    own = (chain, chain.unknown("nes"), chain.unknown("all", "mass:m2"), lw.bnes_chain(4))
    return (*map(lw.model.format_structure, own), *_OTHERS)


def structure_case(seed: int, rng: Random) -> Case:
    text = rng.choice(sound_structures())
    content = damaged_text(rng, text).encode("utf-8", "surrogatepass")
    if rng.random() < 0.15:
        content = damaged_bytes(rng, content)
    record = sound_record()
    arguments = rng.choice(
        (
            ("structure", "show", "s.toml"),
            ("structure", "show", "s.toml", "--json"),
            (
                "simulate",
                "s.toml",
                "--duration",
                "0.05",
                "--rate",
                "200",
                "--release",
                "v:m1=1",
                "-o",
                "o.csv",
            ),
            ("limit", "s.toml", "--duration", "0.1", "--rate", "500", "--release", "v:m1=1", "--noise", "30"),
            ("identify", "run.csv", "s.toml", "--method", "weak"),
            ("identify", "run.csv", "s.toml", "--method", "sindy"),
            ("discover", "run.csv", "--structure", "s.toml", "--terms", "v, d"),
        )
    )
    return Case(seed, "structure", Kind.COMMAND, arguments, {"s.toml": content, "run.csv": record})
