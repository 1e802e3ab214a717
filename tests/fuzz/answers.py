"""Folders of answers, sound and damaged, for every command that reads one."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from types import MappingProxyType

import linkwise as lw
from fuzz.case import Case, Kind
from fuzz.damage import damaged_bytes, damaged_text
from fuzz.record_files import sound_record
from linkwise.report.estimate import write_numbers

_COMMANDS = (
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
        write_numbers(fit, Path(folder), fit.verdicts)
        files = {path.name: path.read_bytes() for path in Path(folder).iterdir()}
    return MappingProxyType(files | {"result.json": json.dumps(lw.report.result_of(fit)).encode()})


def answer_case(seed: int, rng: Random) -> Case:
    files = {f"answer/{name}": content for name, content in sound_answer().items()}
    damaged = rng.choice(("structure.toml", "covariance.csv", "result.json"))
    if rng.random() < 0.1:
        del files[f"answer/{damaged}"]
    else:
        content = damaged_text(rng, files[f"answer/{damaged}"].decode()).encode("utf-8", "surrogatepass")
        files[f"answer/{damaged}"] = damaged_bytes(rng, content) if rng.random() < 0.15 else content
    return Case(seed, "answer", Kind.COMMAND, rng.choice(_COMMANDS), {**files, "run.csv": sound_record()})
