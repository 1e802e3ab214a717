"""What no command does: one paragraph that quotes what was typed, an exit code, and nothing written."""

from pathlib import Path

import click
import numpy as np
import pytest
from commands import refusal, said
from problems import chain_record

import linkwise as lw
from linkwise.cli import linkwise
from linkwise.cli.options import FLAGS, with_flags

GRID = "--duration 1 --rate 500"
TRIAL = f"{GRID} --release v:m1=1.0"
BY_NAME = "--mass m1=1 --mass m2=0.01"
MODAL = "structure host modes.csv"
RANGE = "--from 21 --to 23 --starts 0"
ROD = "structure host rod.npz --point mid=15"

REFUSED = {
    "": [("guess", "No such command 'guess'. Try: linkwise --help"), ("--frobnicate", "No such option")],
    "structure": [
        ("bnes", "Missing option '--dof'. Try: linkwise structure bnes --help"),
        ("bnes --dof 2 --unknown k", "'k' is not one of 'nes', 'all'"),
        (f"bnes --dof 1{'0' * 400}", "masses must be at most 100000"),
        ("show nowhere.toml", "nowhere.toml"),
        ("show chain.toml --shapes chain", "has no host, whose shapes could be drawn"),
        ("laws bouc", "unknown law 'bouc'"),
    ],
    "structure host": [
        ("rod.npz --point mid15", "--point 'mid15' is not NAME=VALUE, as in --point tip=79"),
        ("rod.npz --point mid=fifteen", 'the point "mid" is fifteen, but the matrices have rows 1 to 30'),
        ("run.csv --modes 2 --unit tip=rad", "--unit is for modes or matrices"),
    ],
    MODAL: [
        ("--point mid=15", "A file of modes has its own points"),
        ("--keep 1", "--keep is for matrices"),
        ("--shape-sigma 2", "--shape-sigma takes a percentage with its sign, such as 2%, got '2'"),
        ("--modes some", "a number of modes, or auto"),
        ("--modes 2 --point tip=3", "--point is for modes or matrices"),
        ("--from 2", "--from is for records of a test: give --modes"),
        ("--modes 2 --sensor a:wing.tip:gain", "--sensor a:wing.tip:gain: identify by maximum likelihood finds this gain"),
        ("-o run.csv", "run.csv"),  # a file of another kind
    ],
    ROD: [
        ("--unit mid=deg", 'the point "mid" is displaced in "rad" or "m", got \'deg\''),
        ("--unit top=rad", 'unknown point "top"'),
        ("--unit mid", "is not NAME=VALUE, as in --unit tip_r=rad"),
    ],
    f"simulate chain.toml {GRID} -o made.csv": [
        ("--release v:m1", "--release 'v:m1' is not NAME=VALUE, as in --release v:m1=1.0."),
        ("--release v:m1=1 --release v:m1=2", "--release is given twice for 'v:m1': 1 and 2."),
        ("--release v:m9=1", "m9"),
        ("--force m1=sinus(t)", "sinus"),
        ("--force m1=missing.csv:F", "linkwise: missing.csv: there is no such file"),
        ("--force m1=run.csv", "linkwise: run.csv: has no channel force:m1, but x:m1, x:m2; name the column of it"),
        ("--base run.csv", "linkwise: run.csv: has no channel x:base, but x:m1, x:m2; name the column of it"),
        ("--rate 0", "0.0 is not in the range x>0"),
        ("--release v:m1=1 --sensors x:m1,x:m1", "x:m1 is listed twice"),
        ("--noise -1e308", "decibel must be within 1000 of zero"),
        ("--force 'm1=\0'", "Unexpected character"),
        (f"--force m1={'x' * 300}:f", "File name too long"),
        (f"--force m1={':' * 300}", "linkwise: "),
    ],
    f"simulate unknown.toml {TRIAL} -o made.csv": [("", "unknown")],
    f"limit chain.toml {TRIAL}": [
        ("", "either --noise DB or --noise CHANNEL=SIGMA"),
        ("--noise 20 --noise x:m1=1e-4", "--noise '20' is not NAME=VALUE"),
        ("--noise x:m1=loud", "--noise x:m1: 'loud' cannot be read as a quantity: expected a number in m"),
        ("--noise 20 --unknown nes9", '"nes9" is not a link'),
        ("--noise 20 --sensors x:m9", "unknown mass 'm9'"),
        ("--noise 20 --sensors v,v", "sensor v is listed twice"),
        ("--noise 20 --duration nan", "duration"),
    ],
    "inspect": [("", "Missing argument"), ("text.csv", "text.csv")],
    "identify": [
        ("text.csv unknown.toml", "line 3"),
        ("unit.csv unknown.toml", "x:m1"),
        ("left.csv unknown.toml", "On the command line: --channel NAME=COLUMN, --mapping FILE (linkwise start asks"),
    ],
    "identify run.csv unknown.toml": [
        ("--channel x:m1=Laser", "Laser"),
        ("--method magic", "'magic' is not one of"),
        ("--from 9", "9"),
        ("--from nan", "nan"),
        ("--from inf", "no sample between inf and"),
        ("--resample 1e9", "resampl"),
        ("--resample inf", "rate"),
        ("--rate 1e999", "rate"),
        ("--with run.csv", "records 1 and 2 (run.csv) hold the same samples"),
        ("--method weak --with run.csv", "--with is for --method ml, not for weak."),
        ("--method sindy --profile", "--profile is for --method ml, not for sindy."),
        ("--derivative spline", "--derivative is for --method sindy, not for ml."),
        ("--let gain --method weak", "--let is for --method ml"),
        ("--delay x:m2 --method weak", "--sensor x:m2:delay: identify by maximum likelihood finds"),
        ("second.csv", "argument (second.csv). State each further record with --with."),
        ("--sensor x:m1:noise", "--sensor 'x:m1:noise' is not CHANNEL:ERROR[=SIZE],..., as in x:m1:offset=+-0.1mm,gain=1%"),
        ("--sensor x:m7:noise=1e-4", "x:m7"),
        ("--sensor x:m1:noise=nan", "x:m1"),
        ("--sensor x:m1:noise=1e99 --method weak", "x:m1: its noise is stated as 1e+99 m"),
        ("--sensor x:m2:noise=10", "which hold that noise"),
        ("--sensor x:m1:ofset", 'did you mean "offset"?'),
        ("--sensor offset=1mm", "errors that are offset, gain, delay, noise, drift, hum, corner, noise and hum with a size"),
        ("--sensor x:m1:gain=102%", "--sensor x:m1:gain=102%: '102%' cannot be read; write '1.02' for a known gain"),
        ("--sensor x:m1:offset=plenty", "--sensor x:m1:offset=plenty: 'plenty' cannot be read as a quantity"),
        ("--sensor x:m9:offset", "channel x:m9: is not in the record, and something is stated of it"),
        ("--sensor x:m1:gain --sensor x:m1:offset,gain=2", "--sensor x:m1:gain: the gain of x:m1 is given twice."),
        ("--delay 'x:m2=2 kg'", "--sensor x:m2:delay=2 kg: '2 kg' is in kg"),
        ("--sensor x:m2:offset --method weak", "--sensor x:m2:offset: identify by maximum likelihood finds"),
        ("--calibration x:m1=often", "--calibration takes a percentage"),
        ("--calibration all=1", "such as x:m1=1%, got '1': is it 1% or 100%?"),
        ("--calibration x:m1", "--calibration"),
        ("--calibration x:m1=-1%", "up to 0.5, got -0.01. On the command line: --calibration CHANNEL=PERCENT%."),
        ("--sensor x:m7:drift", "no drift of x:m7 can be estimated"),
        ("--sensor x:m1:drift=1us", "would follow the motion. On the command line: --sensor CHANNEL:drift"),
        ("--ambient m1=loud", "--ambient takes a number in N/sqrt(Hz), as in m1=0.5, got 'loud'"),
        ("--ambient m1 --ambient m1=0.5", "--ambient is given twice for 'm1'"),
        ("--input-noise 'force:m1=3 kg'", "--input-noise force:m1=3 kg: '3 kg'"),
    ],
    "validate": [
        ("none.csv chain.toml", "none.csv: there is no such file"),
        ("run.csv .", "there is no structure.toml in this folder"),
        ("run.csv chain.toml --burn 0.999", "On the command line: --burn S."),
        ("run.csv chain.toml --sensor x:m2:offset", "leave it out, or state a size that is known, as in --sensor"),
        ("run.csv chain.toml --sensor x:m2:gain", "--sensor x:m2:gain: identify by"),
        ("run.csv chain.toml --sensor x:m2:hum=50", "--sensor x:m2:hum=50: identify by maximum likelihood finds this hum"),
    ],
    "discover run.csv": [
        ("", 'Give every mass by name, as in --mass m1=1.0 --mass "m2=10 g"'),
        ("--mass m1=1", "the structure has no mass 'm2'; did you mean m1? it has m1. Add --mass m2=... for it"),
        ("--mass m1=1 --mass m2=ten", "--mass m2: 'ten' cannot be read as a quantity: expected a number in kg"),
        ("--mass m1=1 --mass 'm2=10 nm'", "--mass m2: '10 nm' is in nm: expected a number in kg"),
        ("--structure twice.toml", 'mass "m1": the name is used 2 times; names must be unique'),
        ("--structure free.toml", 'mass "m1": the mass is unknown, and neither an applied force nor another mass sets'),
        ("--structure one.toml", "it has m1. Add --mass m2=... for it"),
        ("--structure none.toml", "none.toml: the key `mass` is missing"),
    ],
    f"discover run.csv {BY_NAME}": [
        ("--mass m1=2", "--mass is given twice for 'm1': 1 and 2"),
        ("--structure chain.toml", "The file of --structure states the masses"),
        ("--terms magic", "the term 'magic' contains the name 'magic'"),
        ("--terms 'd**'", "Something is missing after '**'."),
        ("--test m1-m7", '"m1-m7" is not a link that is looked for'),
        ("--with nowhere.csv", "nowhere.csv: there is no such file"),
        ("second.csv", "argument (second.csv). State each further record with --with."),
        ("--truth nowhere.toml", "nowhere.toml: there is no such file"),
        ("--truth other.toml", 'other.toml: unknown mass "m2"'),
        ("--truth unknown.toml", "unknown.toml: nes1.alpha is unknown, and the truth"),
        ("--channel x:m1[N]=x:m1", "x:m1"),
        ("--calibration force:m1=1%", "no calibration of force:m1 can be stated"),
        ("--sensor x:m1:drift=1us", "would follow the motion. On the command line: --sensor CHANNEL:drift"),
        ("--corner x:m7", "no high pass of x:m7 can be estimated"),
        ("--let slope", 'unknown error of a sensor "slope"'),
    ],
    f"absorb chain.toml {GRID}": [
        ("", "nothing sets the structure in motion; give a release, an impulse"),
        ("--release v:m2=1", "--without removed|locked"),
    ],
    f"absorb chain.toml {TRIAL}": [
        ("--sink nes2", 'unknown link "nes2"; did you mean "nes1"?'),
        ("--harvester nes1", "--harvester 'nes1' is not NAME=VALUE, as in --harvester nes1=0.01"),
        ("--settle 1", "settle is a part of the peak and must be between 0 and 1, got 1.0"),
        ("--without frozen", "'frozen' is not one of 'removed', 'locked'"),
        ("--sweep nes1.alpha=-200:-20", "'-200:-20' is not FROM:TO:COUNT or FROM:TO:COUNT:log, as in nes1.alpha=-200"),
        ("--sweep nes1.alpha=-200:-20:2.5", "'2.5' is not a whole number from 2 to 100000"),
        ("--sweep nes1.alpha=-200:20:5:log", "steps of equal ratio; both ends must have the same sign and not be zero"),
        ("--sweep nes1.alpha=-200:20:5 --sweep nes1.alpha=1:2:3", "--sweep is given twice for 'nes1.alpha'"),
    ],
    f"absorb one_well.toml {TRIAL}": [("", "has more than one stable well, so there is no sink to be found; name the")],
    f"respond chain.toml {RANGE}": [
        ("", "On the command line: --force MASS=N or --base x|v|a=SIZE."),
        ("--force m1=0", "must be positive, got 0.0. On the command line: --levels"),
        ("--base a=1", 'no link has "base" as an end'),
        ("--force m1=1 --show a:m1", "On the command line: --show CHANNEL"),
    ],
    "backbone chain.toml": [
        ("--mode 3", "there is no vibration in mode 3"),
        ("--mode 1 --to-amplitude x:m1=nan", "got nan. On the command line: --to-amplitude"),
        ("--mode 1 --to-amplitude x:m9=1", "unknown mass 'm9' in the end of a backbone"),
    ],
    "basins": [
        ("chain.toml --plane x:m2=1", "is not FROM:TO"),
        ("chain.toml --plane x:m2=nan:1,v:m2=-1:1", "got nan to 1. On the command line: --plane"),
        ("chain.toml --plane a:m2=0:1,v:m2=-1:1", "a:m2 cannot be a state of the plane"),
        (". --plane x:m2=0:1,v:m2=-1:1", "there is no structure.toml in this folder"),
    ],
    "study": [
        ("papr -o x", 'papr: there is no such study; did you mean "paper"?'),
        ("paper", "Missing option '-o' / '--output'"),
        ("paper -o x --workers 0", "0 is not in the range x>=1"),
        ("paper -o x --workers 2 --scheduler tcp://a:1", "--scheduler on a cluster; give only one"),
        ("paper -o x --shard 4/3", "a shard is the i-th of n parts, as in 3/16, got '4/3'"),
        ("paper -o x --export", "the folder does not hold a study"),
    ],
}  # fmt: skip
FAILED = {
    f"limit chain.toml {TRIAL}": [
        ("--noise 20 --segment 4 --duration 4 --rate 200", "On the command line: --segment S."),
        ("--noise 20 --duration 0.001 --rate 1000", "too short"),
        ("--noise 20 --segment 1e-9", "too short"),
        ("--noise 1e308", "must be within 1000 dB of zero"),
    ],
    f"absorb torn.toml {TRIAL} --sink nes1": [("", "the motion diverges")],
    f"absorb chain.toml {TRIAL} --sink nes1": [
        ("--sweep nes1.beta=-2e6:-1e6:2", "none of the 2 runs came to its end: the motion diverges"),
    ],
    f"discover run.csv {BY_NAME}": [
        ("--mass m3=1", "no channel measures the motion of m3"),
        ("--mass m3=1", ". On the command line: --channel NAME=COLUMN.\n"),
        ("--to 0.035 --terms 'quintic, friction(1), quadratic-damping, gap(0.1)'",
         "the record is too short: 72 samples over 2 masses for 27 candidates"),
    ],
    f"discover noise.csv {BY_NAME}": [("", "no motion above the noise in any channel, so no structure can be found")],
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Structures, records, modes and matrices, and files that cannot be read."""
    folder = tmp_path_factory.mktemp("refused")
    chain = lw.bnes_chain(2)
    for name, structure in (
        ("chain", chain),
        ("unknown", chain.unknown("nes")),
        ("one_well", lw.bnes_chain(2, alpha=100.0)),
        ("torn", lw.bnes_chain(2, beta=-1e6)),
    ):
        lw.write_structure(structure, folder / f"{name}.toml")
    (folder / "other.toml").write_text(lw.model.format_structure(chain).replace('"m2"', '"sink"'))
    for name, masses in (
        ("twice", "m1=1 m1=1 m2=0.01"),
        ("free", 'm1="unknown" m2="unknown"'),
        ("one", "m1=1"),
        ("none", ""),
    ):
        entries = [entry.split("=") for entry in masses.split()]
        text = "".join(f'[[mass]]\nname = "{mass}"\nmass = {value}\n' for mass, value in entries)
        (folder / f"{name}.toml").write_text(text)
    lw.write_record(chain_record(2, duration=1.0).with_noise(30.0, seed=1), folder / "run.csv")
    rows = "\n".join(f"{k / 1000},{k % 7},{k % 5}" for k in range(100))
    (folder / "text.csv").write_text(f"time,x:m1,x:m2\n{rows}\n".replace("0.001,1,1", "0.001,one,1"))
    (folder / "unit.csv").write_text(f"time,x:m1[N],x:m2\n{rows}\n")
    (folder / "left.csv").write_text("left\n" + "0.0\n" * 40)
    noise = np.random.default_rng(1014).normal(0.0, 1e-4, (2001, 2))
    lw.write_record(lw.Record(0.0, 1000.0, ("x:m1", "x:m2"), noise), folder / "noise.csv")
    (folder / "modes.csv").write_text("frequency[Hz],damping,tip,joint\n5.2,0.01,1.0,0.62\n21,0.01,-1,0.3\n")
    stiffness = 1e4 * (2.0 * np.eye(30) - np.eye(30, k=1) - np.eye(30, k=-1))
    np.savez(folder / "rod.npz", M=0.1 * np.eye(30), K=stiffness)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "code", "message"),
    [
        (f"{command} {options}", code, message)
        for code, table in ((2, REFUSED), (1, FAILED))
        for command, cases in table.items()
        for options, message in cases
    ],
)
def test_a_line_is_refused_with_its_reason(
    line: str, code: int, message: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    before = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    said = refusal(line, code)
    assert message in said and "internal error" not in said
    assert {path.name: path.stat().st_mtime_ns for path in folder.iterdir()} == before


@pytest.mark.parametrize(
    "command",
    [
        "inspect run.csv",
        "identify run.csv unknown.toml",
        f"discover run.csv {BY_NAME}",
        f"absorb chain.toml {TRIAL}",
    ],
)
def test_a_folder_of_something_else_is_refused_before_the_work(
    command: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    (tmp_path / "thesis.tex").write_text("years of work")
    monkeypatch.setattr(lw, command.split()[0], lambda *_, **__: pytest.fail("the work was begun"))
    assert "is not a result of linkwise" in refusal(f"{command} -o {tmp_path}")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize("place", ["", "file/chain.toml"])
def test_a_place_that_cannot_be_written_is_named(place: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert str(tmp_path) in refusal(f"structure bnes --dof 2 -o {tmp_path / place}")


def test_flags_of_the_arguments_are_appended() -> None:
    error = lw.RecordError("uneven time", "run.csv", arguments=("resample", "rate"))
    assert with_flags(error) == "run.csv: uneven time. On the command line: --resample HZ, --rate HZ."
    assert with_flags(lw.RecordError("dead.", "run.csv")) == "run.csv: dead."
    question = lw.RecordError("is another line the header?", "a.csv", arguments=("header",))
    assert with_flags(question) == f"{question} On the command line: --header LINE."
    options = {
        name
        for command in linkwise.commands.values()
        for parameter in command.params
        for name in (parameter.opts if isinstance(parameter, click.Option) else [])
    }
    assert FLAGS and {flag.split()[0] for flag in FLAGS.values()} <= options


def test_debug_shows_the_traceback() -> None:
    err = said("structure bnes --dof 3 --debug", 2).err
    assert "Traceback" in err and "linkwise: the number of masses must be even" in err


def test_a_fault_of_linkwise_and_an_interrupt_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lw, "bnes_chain", lambda n: 1 / 0)
    assert "internal error of linkwise: ZeroDivisionError" in refusal("structure bnes --dof 2", 1)

    def interrupted(n: int) -> lw.Structure:
        raise KeyboardInterrupt

    monkeypatch.setattr(lw, "bnes_chain", interrupted)
    assert said("structure bnes --dof 2", 130).err.strip().startswith("linkwise: interrupted")
