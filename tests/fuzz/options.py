"""Options of every command, with values that nobody means among those that are meant."""

from random import Random

from fuzz.case import Case, Kind
from fuzz.damage import hostile
from fuzz.record_files import sound_record
from fuzz.text_files import SENSORS, sound_structures

_DRIVE = ("--release", "--impulse", "--force", "--base", "--sensors", "--noise", "--rate", "--duration")
_RECORD = (
    "--channel", "--rate", "--resample", "--from", "--to", "--mapping", "--header", "--decimate", "--period",
    "--then", "--sensor", "--delay", "--interpolation", "--by-time", "--mark-missing",
)  # fmt: skip
_SENSORS = ("--calibration", "--let")
_FLAGS = ("--json", "--quick", "--by-time", "--profile")
_COMMANDS: dict[tuple[str, ...], tuple[str, ...]] = {
    ("identify", "run.csv", "unknown.toml", "--method", "weak"): (
        *_RECORD, "--with", "--truth", "-o", "--json", "--derivative",
    ),
    ("identify", "run.csv", "unknown.toml"): (
        *_RECORD, *_SENSORS, "--robust", "--with", "--truth", "--profile", "--ambient", "--input-noise",
    ),
    ("identify", "run.csv", "unknown.toml", "--by-time", "--channel", "x:m2=part.csv:x:m2"): (*_RECORD, "--json"),
    ("inspect", "run.csv", "--then", "part.csv"): (*_RECORD, "-o", "--json"),
    ("validate", "chain.toml", "run.csv"): (*_RECORD, "--burn", "--json", "-o"),
    ("inspect", "run.csv"): (*_RECORD, "--write-mapping", "-o", "--json"),
    ("export", "chain.toml"): ("o.py", "o.m", "end.m", "o.csv", "o.xlsx", "o.mat"),
    ("discover", "run.csv", "--mass", "m1=1", "--mass", "m2=0.01", "--terms", "v, d"): (
        *_RECORD, *_SENSORS, "--mass", "--terms", "--structure", "--with", "--truth", "--json",
    ),
    ("simulate", "chain.toml", "--duration", "0.05", "--rate", "200", "--release", "v:m1=1", "-o", "o.csv"): (
        *_DRIVE, "--seed", "-o", "--json",
    ),
    ("limit", "chain.toml", "--duration", "0.1", "--rate", "500", "--release", "v:m1=1", "--noise", "30"): (
        *_DRIVE, "--noise", "--unknown", "--segment", "--json",
    ),
    ("absorb", "chain.toml", "--duration", "0.2", "--release", "v:m1=1"): (
        "--release", "--force", "--duration", "--sink", "--harvester", "--without", "--settle", "--sweep", "--json",
    ),
    ("structure", "bnes", "--dof", "2"): ("--dof", "--unknown", "-o", "--json"),
    ("study", "paper", "--export", "-o", "out"): ("--workers", "--scheduler", "-o", "--quick", "--json"),
}  # fmt: skip
_MEANT = (
    "x:m1=1e-4", "v:m1=1.0", "m1=0.3@0.1", "m1=sin(30*t)", "0.1", "100", "1", "2", "nes", "nes1", "x,v", "a:m2", "x:m2", "all",
    "run.csv", "chain.toml", "unknown.toml", "out", "o.h5", "v, d, d**3", "m2=10 g", "nes1.alpha=-200:-20:3", "locked",
    "huber", "sensors.toml", "part.csv", "x:m2=part.csv:x:m2", "x:m1[mm]=2", "all=1%", "common=0.5%", "clipped", "offset",
    "x:m1:offset=+-0.1mm,noise=1e-4", "x:m2=2ms+-1ms", "x:m1:gain=1.02+-1%", "x:m2:drift,hum=50Hz,corner",
)  # fmt: skip


def option_case(seed: int, rng: Random) -> Case:
    command = rng.choice(tuple(_COMMANDS))
    arguments = list(command)
    for _ in range(rng.choice((1, 1, 2, 3))):
        option = rng.choice(_COMMANDS[command])
        arguments.append(option)
        if option.startswith("-") and option not in _FLAGS:
            arguments.append(_value(rng).replace("\0", ""))  # which no system passes on
    chain, unknown = (text.encode() for text in sound_structures()[:2])
    files = {
        "run.csv": sound_record(),
        "part.csv": sound_record(),
        "chain.toml": chain,
        "unknown.toml": unknown,
        "sensors.toml": SENSORS.encode(),
    }
    return Case(seed, "option", Kind.COMMAND, tuple(arguments), files)


def _value(rng: Random) -> str:
    match rng.randrange(4):
        case 0:
            return rng.choice(_MEANT)
        case 1:
            return hostile(rng)
        case 2:
            return (
                f"{rng.choice(('m1', 'x:m1', 'v:m2', 'nes1', 'force:m1', 'm3', 'nes1.alpha'))}={hostile(rng)}"
            )
        case _:
            return f"{hostile(rng)}={rng.choice(('1', hostile(rng)))}"
