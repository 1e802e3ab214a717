"""Cases of the corpus by what the structure is: laws of all kinds, memory, hosts, rigs, rotations, and measured records."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from bench_hosts import POINTS, cantilever_matrices
from bench_inexact_laws import LAW, MISSING, VALUES, chain, record_of, with_missing
from problems import rubbing_trio
from rigs import BOUC_WEN, hysteretic, measured, rig, run
from structures import (
    CANTILEVER,
    CANTILEVER_SHAPES,
    CANTILEVER_SINK,
    HARDENING,
    NES,
    asked_oscillator,
    host,
    link,
    named,
    oscillator,
    row_of_masses,
    structure,
    torsion_chain,
)
from tapped_beam import beam, shaken, tapped

import linkwise as lw

Ask = Callable[[int], Any]  # the answer to the record of a seed
Table = Iterator[tuple[str, Ask]]

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


class Skipped(Exception):
    """A measured record is not there."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A structure, what moves it, how it is recorded, and what is asked of it with which options."""

    structure: lw.Structure
    drive: Mapping[str, Any]
    duration: float = 3.0
    rate: float = 500.0
    snr_db: float = 30.0
    sensors: Sequence[str] = ("x",)
    shown: Sequence[str] = ()
    unknown: Sequence[str] = ("all",)
    asked: lw.Structure | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    def record(self, seed: int) -> lw.Record:
        clean = lw.simulate(
            self.structure, duration=self.duration, rate=self.rate, sensors=self.sensors, **self.drive
        )
        return clean.select(list(self.shown or clean.channels)).with_noise(self.snr_db, seed=seed)

    def identify(self, seed: int, *, method: Any = "ml") -> lw.Estimate:
        asked = self.structure.unknown(*self.unknown) if self.asked is None else self.asked
        return lw.identify(self.record(seed), asked, method=method, **self.options)


def multisine(amplitude: float, fastest: float, draw: int = 5) -> str:
    """A force in N of twelve sines up to `fastest` rad/s."""
    rng = np.random.default_rng(draw)
    parts = zip(rng.uniform(0.3, 1.0, 12), rng.uniform(0.06, 1.0, 12), rng.uniform(0.0, 6.0, 12), strict=True)
    return "+".join(f"{amplitude * a:.4f}*sin({fastest * w:.4f}*t + {p:.4f})" for a, w, p in parts)


LAWS: dict[str, tuple[str, dict[str, float]]] = {
    "linear": ("k*d + c*v", {"k": 900.0, "c": 2.0}),
    "hardening": (HARDENING, {"k": 900.0, "k3": 2e6, "c": 2.0}),
    "softening": (HARDENING, {"k": 900.0, "k3": -8e4, "c": 2.0}),
    "bistable": (NES, {"alpha": -200.0, "beta": 3e6, "c": 2.0}),
    "quintic": ("k*d + k5*d**5 + c*v", {"k": 900.0, "k5": 5e9, "c": 2.0}),
    "asymmetric": ("k*d + k2*d**2 + k3*d**3 + c*v", {"k": 900.0, "k2": 1e4, "k3": 2e6, "c": 2.0}),
    "preload": ("k*d + k3*d**3 + c*v + p", {"k": 900.0, "k3": 2e6, "c": 2.0, "p": 3.0}),
    "quadratic-damping": ("k*d + c*v + c2*v*abs(v)", {"k": 900.0, "c": 1.0, "c2": 6.0}),
    "cubic-damping": ("k*d + c*v + c3*v**3", {"k": 900.0, "c": 1.0, "c3": 15.0}),
    "damping-by-amplitude": ("k*d + c*v + cd*v*d**2", {"k": 900.0, "c": 1.0, "cd": 2e4}),
    "smooth-friction": ("k*d + c*v + F*tanh(v/vf)", {"k": 900.0, "c": 1.0, "F": 2.0, "vf": 0.05}),
    "clearance": ("k*d + c*v + ks*(max(d - g, 0) + min(d + g, 0))", {"k": 900.0, "c": 2.0, "ks": 3e3, "g": 0.008}),
    "one-sided": ("k*d + c*v + ks*max(d - g, 0)", {"k": 900.0, "c": 2.0, "ks": 3e3, "g": 0.005}),
    "saturating": ("k*d + c*v + S*tanh(d/ds)", {"k": 500.0, "c": 2.0, "S": 5.0, "ds": 0.01}),
    "sine": ("k*d + c*v + B*sin(d/p)", {"k": 900.0, "c": 2.0, "B": 4.0, "p": 0.004}),
}  # fmt: skip
INSIDE = {
    "vf": 0.06,
    "g": 0.004,
    "ds": 0.008,
    "p": 0.0045,
}  # starts of coefficients that enter their law nonlinearly


def _starts(values: Mapping[str, float]) -> dict[str, float]:
    return {f"link.{name}": start for name, start in INSIDE.items() if name in values}


def laws() -> Table:
    """An oscillator under a multisine, by a law of each family."""
    drive = {"forces": {"m1": multisine(4.0, 60.0)}}
    for name, (law, values) in LAWS.items():
        starts = {"starts": _starts(values)} if _starts(values) else {}
        subject = Subject(oscillator(law, **values), drive, rate=400.0, snr_db=40.0, options=starts)
        yield f"law/{name}/ml", subject.identify
        if name in ("linear", "hardening", "asymmetric", "quadratic-damping", "bistable"):
            yield f"law/{name}/weak", partial(subject.identify, method="weak")
    steep, values = LAWS["smooth-friction"]
    asked = oscillator("k*d + c*v + F*sign(v)", k=900.0, c=1.0, F=2.0, name="link").unknown("all")
    dry = Subject(oscillator(steep, **{**values, "vf": 0.002}), drive, rate=400.0, snr_db=40.0, asked=asked)
    yield "law/dry-friction/ml", dry.identify
    yield "law/dry-friction/weak", partial(dry.identify, method="weak")
    law, values = LAWS["hardening"]
    power = oscillator("k*d + c*v + kn*sign(d)*abs(d)**n", k=900.0, c=2.0, kn=2e6, n=3.0).unknown("all")
    cube = Subject(oscillator(law, **values), drive, rate=400.0, snr_db=40.0, asked=power)
    yield "law/exponent/ml", replace(cube, options={"starts": {"link.n": 2.5}}).identify
    for name in ("hardening", "bistable", "clearance"):
        law, values = LAWS[name]
        starts = {"starts": _starts(values)} if _starts(values) else {}
        for sensors in ("v", "a"):
            true = oscillator(law, **values)
            subject = Subject(true, drive, rate=400.0, snr_db=40.0, sensors=(sensors,), options=starts)
            yield f"law/{name}/{sensors}/ml", subject.identify
    for name in ("hardening", "quadratic-damping"):
        law, values = LAWS[name]
        subject = Subject(oscillator(law, **values), drive, rate=400.0, unknown=("all", "mass:m1"))
        yield f"law/{name}/mass-unknown/ml", subject.identify
        yield f"law/{name}/mass-unknown/weak", partial(subject.identify, method="weak")


def inexact() -> Table:
    """Laws that lack a term of 1 or 5 % of the force, or hysteresis."""

    def ask(kind: str, share: float, duration: float, seed: int, method: Any = "ml") -> lw.Estimate:
        record = record_of(with_missing(kind, share), duration, seed)
        return lw.identify(record, chain(LAW, **VALUES).unknown("all"), method=method)

    for kind in (*sorted(MISSING), "hysteresis"):
        for share in (0.01, 0.05):
            yield f"inexact/{kind}/{100 * share:g}%/10s/ml", partial(ask, kind, share, 10.0)
    for kind in ("quintic", "stribeck"):
        yield f"inexact/{kind}/5%/30s/ml", partial(ask, kind, 0.05, 30.0)
        yield f"inexact/{kind}/5%/10s/weak", partial(ask, kind, 0.05, 10.0, method="weak")


MEMORY: dict[str, dict[str, float]] = {
    "bouc-wen": {"k": 400.0, "c": 1.5, "F": 12.0, "x0": 0.02, "s": 0.7},
    "bouc-wen-classical": {"k": 400.0, "c": 1.5, "kh": 500.0, "beta": 30.0, "gamma": 20.0},
    "dahl": {"sigma": 800.0, "Fc": 4.0, "c": 1.0},
    "jenkins": {"k": 800.0, "Fs": 5.0},
    "iwan(2)": {"KT": 900.0, "FS": 6.0, "chi": -0.4, "beta": 0.7},
    "maxwell": {"k": 700.0, "c": 20.0},
    "zener": {"k": 700.0, "k1": 300.0, "c1": 8.0},
    "piezo": {"k": 600.0, "c": 1.0, "theta": 0.05, "C": 5e-5, "R": 4e3},
    "coil": {"k": 600.0, "c": 1.0, "g": 5.0, "L": 0.05, "R": 8.0},
}
HARVESTER = {"alpha": -40.0, "beta": 9e4, "c": 0.3, "theta": 2e-3, "C": 5e-6, "R": 5e4}
SHAKER = "0.004*sin(40*t) + 0.003*sin(57*t + 1) + 0.002*sin(33*t + 2)"


def memory() -> Table:
    """Links with memory, beside a spring where the law alone would let the mass go."""
    drive = {"forces": {"m1": multisine(6.0, 60.0)}}
    for name, values in MEMORY.items():
        spring = link("spring", "m1-ground", "k*d", k=300.0)
        subject = Subject(
            structure({"m1": 1.0}, spring, named("joint", "m1-ground", name, **values)),
            drive,
            rate=200.0,
            duration=4.0,
            snr_db=40.0,
            sensors=("x", "f", "state"),
            unknown=("joint",),
        )
        if name != "iwan(2)":  # which takes half a minute
            yield f"memory/{name}/x/ml", replace(subject, shown=("x:m1", "force:m1")).identify
        if name in ("bouc-wen", "jenkins", "zener", "iwan(2)", "maxwell"):
            yield f"memory/{name}/f/ml", replace(subject, shown=("x:m1", "f:joint", "force:m1")).identify
    plain = Subject(
        structure({"m1": 1.0}, named("joint", "m1-ground", "bouc-wen", **MEMORY["bouc-wen"])),
        drive,
        rate=200.0,
        duration=4.0,
        snr_db=40.0,
        asked=asked_oscillator(HARDENING, 1.0),
    )
    yield "memory/bouc-wen/asked-without/ml", plain.identify
    harvester = structure({"m1": 0.02}, named("piezo", "m1-base", "piezo-harvester", **HARVESTER))
    for shown in (("rel:x:m1", "state:piezo.V"), ("rel:v:m1", "state:piezo.V"), ("rel:x:m1",)):
        subject = Subject(
            harvester,
            {"base": SHAKER},
            sensors=("rel:x", "rel:v", "state", "x:base"),
            shown=(*shown, "x:base"),
        )
        yield f"memory/harvester/{'-'.join(shown).replace(':', '')}/ml", partial(_with_exact_base, subject)
    lower, upper = MEMORY["bouc-wen"], {"k": 300.0, "c": 1.0, "F": 5.0, "x0": 0.01, "s": 0.6}
    two = structure(
        {"m1": 1.0, "m2": 0.5},
        named("lower", "m1-ground", "bouc-wen", **lower),
        named("upper", "m2-m1", "bouc-wen", **upper),
    )
    yield "memory/two-bouc-wen/ml", Subject(two, drive, rate=200.0, duration=4.0, snr_db=40.0).identify


def _with_exact_base(subject: Subject, seed: int) -> lw.Estimate:
    """The answer where the motion of the base is known without noise."""
    noisy, exact = subject.record(seed), replace(subject, snr_db=300.0).record(seed)
    values = noisy.values.copy()
    column = noisy.channels.index("x:base")
    values[:, column] = exact.values[:, column]
    return lw.identify(replace(noisy, values=values, simulated=None), subject.structure.unknown("all"))


HITS = "80*exp(-((t - 0.05)/0.002)**2) + 60*exp(-((t - 0.375)/0.002)**2)"


def sink_on_beam(
    frequencies: Sequence[Any] = CANTILEVER, end: str = "tip", law: str = NES, **values: float
) -> lw.Structure:
    """A cantilever by three modes with a bistable sink at one of its points."""
    sink = link("nes", f"sink-beam.{end}", law, **(values or CANTILEVER_SINK))
    return structure(
        {"sink": 0.03}, sink, hosts=[host("beam", frequencies, 0.01, CANTILEVER_SHAPES)], name="beam"
    )


def hosts() -> Table:
    """Hosts by modes and by matrices: links on them, modes known to within, wrong ones, and modal tests."""
    hit = Subject(
        sink_on_beam(),
        {"forces": {"beam.mid": HITS}, "release": {"x:sink": 0.00707}},
        duration=0.5,
        rate=1000.0,
        snr_db=25.0,
        sensors=("a:beam.tip", "a:beam.root", "a:sink"),
        unknown=("nes",),
    )
    yield "host/sink/ml", hit.identify
    yield "host/sink/40dB/ml", replace(hit, snr_db=40.0).identify
    yield "host/sink/weak", partial(hit.identify, method="weak")
    within = tuple(
        lw.Coefficient.unknown(frequency * factor, sigma=0.01 * frequency)
        for frequency, factor in zip(CANTILEVER, (1.01, 0.992, 1.004), strict=True)
    )
    yield "host/sink/frequencies-within/ml", replace(hit, asked=sink_on_beam(within).unknown("nes")).identify
    wrong = (CANTILEVER[0], 1.03 * CANTILEVER[1], CANTILEVER[2])
    yield (
        "host/sink/wrong-frequency/ml",
        replace(hit, asked=sink_on_beam(wrong).unknown("nes"), duration=0.25).identify,
    )
    at_mid = sink_on_beam(end="mid").unknown("nes")
    yield "host/sink/wrong-point/ml", replace(hit, asked=at_mid, duration=0.25).identify
    linear = sink_on_beam(law="k*d + c*v", k=400.0, c=0.1)
    yield "host/linear/ml", replace(hit, structure=linear).identify
    yield (
        "host/linear/x/weak",
        partial(
            replace(
                hit, structure=linear, sensors=("x:beam.tip", "x:beam.mid", "x:beam.root", "x:sink")
            ).identify,
            method="weak",
        ),
    )
    for residual in (False, True):
        yield f"host/matrices/residual-{residual}/ml".lower(), partial(_on_matrices, residual)
    yield "host/modal-test/tip", lambda seed: lw.modal.identify_host(tapped().with_noise(40.0, seed=seed))
    yield "host/modal-test/20dB", lambda seed: lw.modal.identify_host(tapped().with_noise(20.0, seed=seed))
    yield (
        "host/modal-test/cubic",
        lambda seed: lw.modal.identify_host(tapped(cubic=2e7).with_noise(40.0, seed=seed)),
    )
    yield (
        "host/modal-test/shaken",
        lambda seed: lw.modal.identify_host(shaken(seed).with_noise(40.0, seed=seed)),
    )
    yield (
        "host/modal-test/two-records",
        lambda seed: lw.modal.identify_host(
            [
                tapped(level=level).with_noise(40.0, seed=seed + number)
                for number, level in enumerate((1.0, 0.5))
            ]
        ),
    )
    stop = structure({}, link("stop", "beam.tip-ground", "k3*d**3"), hosts=[beam()])
    yield (
        "host/cubic/ml",
        lambda seed: lw.identify(tapped(cubic=2e7, level=4.0).with_noise(40.0, seed=seed), stop),
    )
    yield (
        "host/cubic/discover",
        lambda seed: lw.discover(
            tapped(cubic=2e7, level=4.0).with_noise(40.0, seed=seed),
            lw.model.PartialStructure((), (), (beam(),)),
            terms="d, d**3",
        ),
    )
    yield "host/sink/discover", partial(_discovered_on_host, hit)
    joint = named("joint", "sink-beam.tip", "bouc-wen", k=400.0, c=0.1, F=1.0, x0=0.002, s=0.6)
    slips = structure({"sink": 0.03}, joint, hosts=[host("beam", CANTILEVER, 0.01, CANTILEVER_SHAPES)])
    yield "host/bouc-wen/ml", replace(hit, structure=slips, unknown=("joint",), snr_db=40.0).identify


def _discovered_on_host(hit: Subject, seed: int) -> lw.Discovery:
    known = lw.model.PartialStructure((hit.structure.mass("sink"),), (), hit.structure.hosts)
    return lw.discover(hit.record(seed), known, terms="v, d, d**3")


def _on_matrices(residual: bool, seed: int) -> lw.Estimate:
    """A sink on a beam of 40 finite elements, reduced to modes."""
    matrices = lw.modal.HostMatrices(*cantilever_matrices(40))
    reduced = matrices.reduce("beam", POINTS, keep=5, modal_damping=0.01, residual=residual)
    sink = link("nes", "sink-beam.tip", NES, **CANTILEVER_SINK)
    subject = Subject(
        structure({"sink": 0.03}, sink, hosts=[reduced.host]),
        {"forces": {"beam.mid": HITS}, "release": {"x:sink": 0.00707}},
        duration=0.4,
        rate=2000.0,
        snr_db=30.0,
        sensors=("a:beam.tip", "a:beam.mid", "a:sink"),
        unknown=("nes",),
    )
    return subject.identify(seed)


def rigs() -> Table:
    """Links alone, whose motion is prescribed and whose force is measured."""

    def ask(
        true: lw.Structure, options: Mapping[str, Any], seed: int, asked: lw.Structure | None = None
    ) -> lw.Estimate:
        record = measured(run(true, duration=4.0), seed)
        return lw.identify(record, true.unknown("damper") if asked is None else asked, **options)

    yield "rig/bouc-wen", partial(ask, hysteretic(), {})
    yield "rig/bouc-wen/offset", partial(ask, hysteretic(), {"offsets": ["f:damper"]})
    law, values = "k*d + k3*d**3 + c*v", {"k": 2000.0, "k3": 4e7, "c": 50.0}
    yield "rig/cubic", partial(ask, rig(law, values), {})
    yield "rig/cubic/gain", partial(ask, rig(law, values), {"calibration": {"f:damper": 0.01}})
    for name, given in (
        ("jenkins", {"k": 8e4, "Fs": 100.0}),
        ("iwan(2)", {"KT": 8e4, "FS": 100.0, "chi": -0.4, "beta": 0.7}),
        ("maxwell", {"k": 2e4, "c": 800.0}),
        ("zener", {"k": 2e3, "k1": 5e3, "c1": 300.0}),
        ("dahl", {"sigma": 5e4, "Fc": 80.0, "c": 30.0}),
    ):
        yield f"rig/{name}", partial(ask, structure({}, named("damper", "base-ground", name, **given)), {})
    slider = structure({}, named("damper", "base-ground", "jenkins"))
    yield "rig/bouc-wen/asked-jenkins", partial(ask, hysteretic(), {}, asked=slider)
    plain = structure({}, link("damper", "base-ground", "k*d + c*v"))
    yield "rig/bouc-wen/asked-linear", partial(ask, hysteretic(), {}, asked=plain)
    yield (
        "rig/validate",
        lambda seed: lw.validate(
            measured(run(hysteretic(), duration=4.0), seed),
            hysteretic().with_values({f"damper.{name}": value for name, value in BOUC_WEN.items()}),
        ),
    )


def rotations() -> Table:
    """Discs on torsion springs, and masses on more than one link or on a base."""
    hit = {"release": {"v:disc1": 20.0}}
    for turns in (True, False):
        subject = Subject(torsion_chain(turns=turns), hit, rate=1000.0, duration=2.0)
        word = "discs" if turns else "masses"
        yield f"torsion/{word}/ml", subject.identify
        yield f"torsion/{word}/weak", partial(subject.identify, method="weak")
    yield (
        "torsion/discs/a/ml",
        Subject(torsion_chain(), hit, rate=1000.0, duration=2.0, sensors=("a",)).identify,
    )
    trio = Subject(rubbing_trio(), {"base": "0.002*sin(150*t) + 0.001*sin(97*t)"}, rate=1000.0, duration=2.0)
    yield "shared-coefficient/ml", replace(trio, options={"starts": {"friction.s": 0.3}}).identify
    row = row_of_masses(
        [1.0, 0.8, 0.5],
        l1=("k*d + c*v", {"k": 2000.0, "c": 1.0}),
        l2=(HARDENING, {"k": 900.0, "k3": 1e6, "c": 0.6}),
        l3=("k*d + c*v + F*tanh(v/0.02)", {"k": 700.0, "c": 0.5, "F": 0.4}),
    )
    drive = {"forces": {"m3": multisine(4.0, 70.0)}}
    yield "row/three/ml", Subject(row, drive).identify
    yield "row/three/weak", partial(Subject(row, drive).identify, method="weak")
    yield "row/three/a/ml", Subject(row, drive, sensors=("a",), snr_db=40.0).identify
    names = [parameter.name for parameter in row.unknown("all").parameters]
    starts = {name: 0.95 * float(row.coefficient(name).value or 0.0) for name in names}
    unseen = Subject(row, drive, sensors=("x:m1", "x:m3"), snr_db=40.0)
    yield "row/three/one-unmeasured/ml", replace(unseen, options={"starts": starts}).identify
    yield "row/three/one-unmeasured/no-starts/ml", unseen.identify


SPRING = "k*d + k2*d**2 + k3*d**3 + c*v + f0"
DAMPED = "k*d + k2*d**2 + k3*d**3 + c*v + c1*v*d + c2*v*d**2 + f0"
AXIS = "fv*v + fc*sign(v) + off"


def _file(name: str) -> Path:
    if not (DATA / name).exists():
        raise Skipped(name)
    return DATA / name


def _axis(start: int, stop: int, seed: int, method: Any = "ml") -> lw.Estimate:
    """A piece of the servo axis, the mass unknown."""
    data = scipy.io.loadmat(_file("emps.mat"))
    force = data["vir"].ravel() * float(data["gtau"].item())
    record = lw.Record.from_arrays(data["t"].ravel(), {"x:m1": data["qm"].ravel(), "force:m1": force})
    return lw.identify(record[start:stop], asked_oscillator(AXIS), method=method)


def _circuit(law: str, seed: int, method: Any = "ml") -> lw.Estimate:
    record = lw.read_record(_file("silverbox_multisine.csv"))
    return lw.identify(record[: round(10.0 * record.rate)], asked_oscillator(law), method=method)


def _strip(law: str, seed: int, method: Any = "ml") -> lw.Estimate:
    return lw.identify(
        lw.read_record(_file("magnet_beam_decay.csv")), asked_oscillator(law, 1.0), method=method
    )


def _storey(options: Mapping[str, Any], seed: int) -> lw.Estimate:
    """A storey on a shake table, which two sensors show that were started together."""
    stamps = {"time[us]": "SampleTimeFine"}
    top, ground = (_file(f"shake_table/stiff1_{place}_elcentro.csv") for place in ("top", "ground"))
    floor = lw.read_record(top, channels={**stamps, "a:floor": "Acc_X"})
    base = lw.read_record(ground, channels={**stamps, "a:base": "Acc_X"})
    storey = structure({"floor": 1.0}, link("frame", "floor-base", "k*d + c*v"))
    record = lw.records.beside(floor, base)
    return lw.identify(record[: len(record) // 4], storey, offsets=["a:floor"], **options)


def _damper(name: str, seed: int) -> lw.Estimate:
    """A magnetorheological damper on a rig, by a named law."""
    channels = {"x:base[mm]": "x_F(:,1)", "f:damper": "x_F(:,3)"}
    record = lw.read_record(
        _file("mr_damper/data_simulation_4.1_MRdamper.mat"), channels=channels, rate=100.0
    )
    return lw.identify(
        record[:1500], structure({}, named("damper", "base-ground", name)), offsets=["f:damper"]
    )


def measured_records() -> Table:
    """Pieces of records that were measured, where they are beside the checkout."""
    for piece in range(3):
        yield f"measured/servo-axis/piece-{piece + 1}/ml", partial(_axis, 4000 * piece, 4000 * (piece + 1))
    yield "measured/servo-axis/piece-1/weak", partial(_axis, 0, 4000, method="weak")
    yield "measured/circuit/six/ml", partial(_circuit, SPRING)
    yield "measured/circuit/eight/ml", partial(_circuit, DAMPED)
    yield "measured/circuit/six/weak", partial(_circuit, SPRING, method="weak")
    yield "measured/magnet-beam/ml", partial(_strip, "k*d + k3*d**3 + c*v + c3*v*d**2")
    yield "measured/magnet-beam/weak", partial(_strip, "k*d + k3*d**3 + c*v + c3*v*d**2", method="weak")
    yield "measured/shake-table/ml", partial(_storey, {})
    yield "measured/shake-table/delay/ml", partial(_storey, {"delays": ["a:floor"]})
    yield "measured/damper/bouc-wen/ml", partial(_damper, "bouc-wen")
