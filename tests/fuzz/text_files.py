"""Files that commands read beside records, sound and damaged: structures, mappings, studies, and folders of answers."""

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from types import MappingProxyType

import linkwise as lw
from fuzz.case import Case, Kind
from fuzz.damage import damaged_file
from fuzz.record_files import sound_record
from linkwise.report.estimate import write_numbers

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
    files = {"s.toml": damaged_file(rng, text, 0.15), "run.csv": sound_record()}
    arguments = rng.choice(
        (
            "structure show s.toml",
            "structure show s.toml --json",
            "simulate s.toml --duration 0.05 --rate 200 --release v:m1=1 -o o.csv",
            "limit s.toml --duration 0.1 --rate 500 --release v:m1=1 --noise 30",
            "identify run.csv s.toml --method weak",
            "identify run.csv s.toml --method sindy",
            "discover run.csv --structure s.toml --terms v,d",
        )
    )
    return Case(seed, "structure", Kind.COMMAND, tuple(arguments.split()), files)


SENSORS = """rate = "1 kHz"
decimate = 2
calibration = "1 %"
common_calibration = 0.01

[channel."x:m1"]
column = "x:m1"
unit = "mm"
gain = "1.02 +- 1 %"
offset = { start = "0.3 mm", sigma = 1e-4 }
noise = "5 um"

[channel."x:m2"]
column = 3
offset = "+- 0.1 mm"
delay = "2 ms +- 0.1 ms"

[mass]
m1 = "1 kg"
m2 = "unknown"
"""


def mapping_case(seed: int, rng: Random) -> Case:
    files = {"sensors.toml": damaged_file(rng, SENSORS, 0.1), "run.csv": sound_record()}
    return Case(seed, "mapping", Kind.COMMAND, ("inspect", "run.csv", "--mapping", "sensors.toml"), files)


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
    """It is read and not run: what a study runs is what the other commands do."""
    files = {"study.toml": damaged_file(rng, _STUDY, 0.1), "s.toml": sound_structures()[0].encode()}
    return Case(seed, "study", Kind.COMMAND, ("study", "study.toml", "--export", "-o", "out"), files)


_ON_ANSWERS = (
    ("export", "answer", "o.py", "o.m", "o.csv", "o.mat"),
    ("export", "answer", "o.xlsx"),
    ("validate", "answer", "run.csv"),
    ("validate", "answer", "run.csv", "--json"),
    ("absorb", "answer", "--duration", "0.1", "--release", "v:m1=1", "--draws", "2"),
    ("identify", "run.csv", "answer/structure.toml", "--method", "weak"),
)


@cache
def sound_answer() -> Mapping[str, bytes]:
    """The files with numbers in the folder of a trusted answer."""
    chain = lw.bnes_chain(2)
    record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    fit = lw.identify(record, chain.unknown("nes"), method="weak")
    with TemporaryDirectory() as folder:
        write_numbers(fit, Path(folder), fit)
        files = {path.name: path.read_bytes() for path in Path(folder).iterdir()}
    return MappingProxyType(files | {"result.json": json.dumps(lw.report.result_of(fit)).encode()})


def answer_case(seed: int, rng: Random) -> Case:
    files = {f"answer/{name}": content for name, content in sound_answer().items()}
    damaged = rng.choice(("structure.toml", "covariance.csv", "result.json"))
    if rng.random() < 0.1:
        del files[f"answer/{damaged}"]
    else:
        files[f"answer/{damaged}"] = damaged_file(rng, files[f"answer/{damaged}"].decode(), 0.15)
    return Case(seed, "answer", Kind.COMMAND, rng.choice(_ON_ANSWERS), {**files, "run.csv": sound_record()})
