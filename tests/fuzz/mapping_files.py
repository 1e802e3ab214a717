"""Mapping files, sound and damaged, by which a sound record is read."""

from __future__ import annotations

from random import Random

from fuzz.case import Case, Kind
from fuzz.damage import damaged_bytes, damaged_text
from fuzz.record_files import sound_record

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
    content = damaged_text(rng, SENSORS).encode("utf-8", "surrogatepass")
    if rng.random() < 0.1:
        content = damaged_bytes(rng, content)
    files = {"sensors.toml": content, "run.csv": sound_record()}
    return Case(seed, "mapping", Kind.COMMAND, ("inspect", "run.csv", "--mapping", "sensors.toml"), files)
