"""The cases of the corpus of answers: a name, and what is asked of which record. Seeds follow from names; no test has them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any
from zlib import crc32

import numpy as np
from bench_changes import changing_record
from bench_inexact_laws import wrong_offer
from corpus_models import (
    LAWS,
    Subject,
    Table,
    hosts,
    inexact,
    laws,
    measured_records,
    memory,
    multisine,
    rigs,
    rotations,
)
from duffing_ring import noisy as noisy_ring
from fault_catalogue import FAULTS, Fault, make_test
from problems import PROBLEMS, bent_chain, chain_record, linear_chain
from random_structures import random_case
from shaken_chain import NOISE, RATE, STEADY, SUBSTEPS, motion
from shaken_chain import chain as linear_row
from structures import HARDENING, link, named, oscillator, row_of_masses, structure, with_links

import linkwise as lw

CHAIN = lw.bnes_chain(2)
ALL = CHAIN.unknown("all")


def seed(name: str) -> int:
    """Far from those of tests and benchmarks."""
    return 1_000_000_000 + crc32(name.encode())


def chains() -> Table:
    """The paper's chains, all coefficients unknown."""

    def ask(n: int, decibel: float, sensors: str, method: Any, seed: int) -> lw.Estimate:
        record = chain_record(n, duration=3.0, sensors=tuple(sensors)).with_noise(decibel, seed=seed)
        return lw.identify(record, lw.bnes_chain(n).unknown("all"), method=method)

    by_size = {2: (10, 15, 20, 30, 40), 4: (10, 20, 40), 6: (20, 40), 10: (20, 40)}
    for n, levels in by_size.items():
        for decibel in levels:
            yield f"chain/{n}/{decibel}dB/x/ml", partial(ask, n, decibel, "x", "ml")
    for n in (2, 4, 6):
        for decibel in (10, 20, 40):
            yield f"chain/{n}/{decibel}dB/x/weak", partial(ask, n, decibel, "x", "weak")
    others = ((2, "v", 30), (2, "a", 30), (2, "a", 20), (4, "v", 30), (4, "a", 30), (2, "xa", 20))
    for n, sensors, decibel in others:
        yield f"chain/{n}/{decibel}dB/{sensors}/ml", partial(ask, n, decibel, sensors, "ml")
    for n, sensors, decibel in ((2, "x", 40), (4, "x", 60), (2, "xva", 20)):
        yield f"chain/{n}/{decibel}dB/{sensors}/sindy", partial(ask, n, decibel, sensors, "sindy")


def problems() -> Table:
    """The problems of the tests, by two methods."""

    def ask(name: str, method: Any, seed: int) -> lw.Estimate:
        problem = PROBLEMS[name]
        return lw.identify(problem.record(seed), problem.unknown_structure, method=method)

    for name in PROBLEMS:
        for method in ("ml", "weak"):
            yield f"problem/{name.replace(', ', '-').replace(' ', '-')}/{method}", partial(ask, name, method)
    for n in (2, 4):
        problem = linear_chain(n)
        yield f"problem/linear-chain-{n}/ml", partial(_solved, problem)
    for k2 in (10.0, 1000.0):
        yield f"problem/bent-chain-{k2:g}/asked-plain/ml", partial(_asked_plain, k2)


def _solved(problem: Any, seed: int) -> lw.Estimate:
    return lw.identify(problem.record(seed), problem.unknown_structure)


def _asked_plain(k2: float, seed: int) -> lw.Estimate:
    """The chain without the term by which its sink bends to one side."""
    return lw.identify(bent_chain(k2).record(seed), ALL)


def low_signal() -> Table:
    """Random structures, and chains whose sinks hardly move."""

    def ask(number: int, seed: int) -> lw.Estimate:
        case = random_case(700_000 + number)
        record = case.record.between(0.0, 2.0).with_noise(30.0, seed=seed)
        return lw.identify(record, case.structure.unknown("all"))

    def slow(speed: float, decibel: float, seed: int) -> lw.Estimate:
        record = chain_record(2, duration=3.0, speed=speed)
        return lw.identify(record.with_noise(decibel, seed=seed), ALL)

    for number in range(6):
        yield f"random/{number}/ml", partial(ask, number)
    for speed in (0.05, 0.2):
        for decibel in (10.0, 30.0):
            yield f"slow/{speed:g}/{decibel:g}dB/ml", partial(slow, speed, decibel)
    yield "ring/15dB/ml", lambda seed: lw.identify(noisy_ring(seed), _ring_asked(seed))


def _ring_asked(seed: int) -> lw.Structure:
    springs = (link(f"spring{k}", f"m{k}-ground", "k*d + k3*d**3") for k in range(1, 6))
    couplings = (link(f"ring{k}", f"m{k}-m{k % 5 + 1}", "k*d") for k in range(1, 6))
    return structure({f"m{k}": 1.0 for k in range(1, 6)}, *springs, *couplings)


def hit_chain(
    decibel: float, seed: int, duration: float = 2.0, sensors: tuple[str, ...] = ("x",)
) -> lw.Record:
    return chain_record(2, duration=duration, sensors=sensors).with_noise(decibel, seed=seed)


def changed(
    record: lw.Record, channel: str, change: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> lw.Record:
    """The record in which one channel is what `change` makes of it and of the time."""
    values = record.values.copy()
    column = record.channels.index(channel)
    values[:, column] = change(values[:, column], record.time)
    return replace(record, values=values, simulated=None)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


ERRORS: dict[str, tuple[Callable[[np.ndarray, np.ndarray], np.ndarray], dict[str, Any]]] = {
    "gain": (lambda x, t: 1.05 * x, {"gains": ["x:m2"]}),
    "calibration": (lambda x, t: 1.01 * x, {"calibration": {"all": 0.01}}),
    "common-calibration": (lambda x, t: 1.01 * x, {"calibration": {"common": 0.01}}),
    "offset": (lambda x, t: x + 0.1 * _rms(x), {"offsets": ["x:m2"]}),
    "delay": (lambda x, t: np.interp(t - 5e-4, t, x), {"delays": ["x:m2"]}),
    "drift": (lambda x, t: x + 0.3 * _rms(x) * np.sin(1.5 * t), {"drifts": ["x:m2"]}),
    "hum": (lambda x, t: x + 0.1 * _rms(x) * np.sin(314.0 * t + 1.0), {"hums": {"x:m2": 50.0}}),
    "admitted-gain": (lambda x, t: 1.05 * x, {"admit": ["gain", "offset", "delay"]}),
    "admitted-offset": (lambda x, t: x + 0.1 * _rms(x), {"admit": ["gain", "offset", "delay"]}),
    "spikes-student": (
        lambda x, t: x + 2.0 * _rms(x) * (np.arange(len(x)) % 301 == 7),
        {"loss": lw.likelihood.Student()},
    ),
    "spikes-huber": (
        lambda x, t: x + 2.0 * _rms(x) * (np.arange(len(x)) % 301 == 7),
        {"loss": lw.likelihood.Huber()},
    ),
    "exact": (lambda x, t: x, {"exact": True}),
    "starts": (lambda x, t: x, {"starts": {"nes1.alpha": -60.0, "nes1.beta": 7e5}}),
}


def options() -> Table:
    """Errors of a sensor that are found with the laws, robust losses, starts, and what is known beforehand."""

    def ask(name: str, decibel: float, seed: int) -> lw.Estimate:
        change, stated = ERRORS[name]
        return lw.identify(changed(hit_chain(decibel, seed), "x:m2", change), ALL, **stated)

    for name in ERRORS:
        yield f"option/{name}/ml", partial(ask, name, 40.0)
    for name in ("gain", "drift", "spikes-student"):
        yield f"option/{name}/20dB/ml", partial(ask, name, 20.0)
    for start, sigma in ((0.0101, 1e-4), (0.01, 1e-6), (0.0105, 1e-4)):
        yield f"option/mass-within-{start:g}-{sigma:g}/ml", partial(_with_mass, start, sigma)
    sink = CHAIN.link("nes1")
    within = replace(
        sink, coefficients={**sink.coefficients, "alpha": lw.Coefficient.unknown(-98.0, sigma=1.0)}
    )
    prior = with_links(CHAIN, within).unknown("spring1")
    yield "option/coefficient-within/ml", lambda seed: lw.identify(hit_chain(20.0, seed), prior)
    yield (
        "option/coefficient-within/weak",
        lambda seed: lw.identify(hit_chain(20.0, seed), prior, method="weak"),
    )
    bounded = replace(
        sink, coefficients={**sink.coefficients, "c": lw.Coefficient.unknown(0.03, lower=0.025)}
    )
    at_bound = with_links(CHAIN, bounded)
    yield "option/all-at-bound/ml", lambda seed: lw.identify(hit_chain(40.0, seed), at_bound)
    yield (
        "option/one-at-bound/ml",
        lambda seed: lw.identify(hit_chain(40.0, seed), at_bound.unknown("spring1")),
    )


def _with_mass(start: float, sigma: float, seed: int) -> lw.Estimate:
    first, second = CHAIN.masses
    known = replace(second, mass=lw.Coefficient.unknown(start, sigma=sigma))
    return lw.identify(hit_chain(40.0, seed), replace(ALL, masses=(first, known)))


def records() -> Table:
    """Gaps, joined and several records, other rates, clipped samples, stated noise, changes within a record."""
    yield "record/gap/ml", lambda seed: lw.identify(_with_gap(hit_chain(30.0, seed)), ALL)
    yield "record/gap/weak", lambda seed: lw.identify(_with_gap(hit_chain(30.0, seed)), ALL, method="weak")
    yield "record/samples-missing/ml", lambda seed: lw.identify(_sparse(hit_chain(30.0, seed), seed), ALL)
    yield (
        "record/two/ml",
        lambda seed: lw.identify([hit_chain(20.0, seed), hit_chain(30.0, seed + 1, duration=1.0)], ALL),
    )
    yield (
        "record/three-levels/ml",
        lambda seed: lw.identify(
            [chain_record(2, duration=1.5, speed=v).with_noise(30.0, seed=seed) for v in (0.5, 1.0, 2.0)], ALL
        ),
    )
    yield "record/continued/ml", lambda seed: lw.identify(_continued(seed), ALL)
    yield (
        "record/beside/ml",
        lambda seed: lw.identify(
            lw.records.beside(
                hit_chain(30.0, seed),
                chain_record(2, duration=2.0, sensors=("a",)).with_noise(20.0, seed=seed + 1),
            ),
            ALL,
        ),
    )
    yield "record/decimated/ml", lambda seed: lw.identify(hit_chain(30.0, seed).decimate(2), ALL)
    yield (
        "record/one-mass-seen/ml",
        lambda seed: lw.identify(
            hit_chain(40.0, seed).select(["x:m2"]),
            ALL,
            starts={p.name: _true(p.name) for p in ALL.parameters},
        ),
    )
    for share in (0.5, 0.8):
        yield f"record/clipped-{share:g}-marked/ml", partial(_clipped, share)
    for regressor in ("l1", "least-squares"):
        yield f"record/{regressor}/sindy", partial(_by_regressor, regressor)
    for name, change in (("nes1.alpha", 0.05), ("spring1.k", 0.01), ("nes1.beta", 0.005)):
        yield f"record/change-of-{name}-{100 * change:g}%/ml", partial(_changing, name, change)


def _by_regressor(regressor: Any, seed: int) -> lw.Estimate:
    record = chain_record(2, duration=2.0, sensors=("x", "v", "a")).with_noise(40.0, seed=seed)
    return lw.identify(record, ALL, method=lw.PhysicsInformedSindy(regressor=regressor))


def _true(name: str) -> float:
    return float(CHAIN.coefficient(name).value or 0.0)


def _with_gap(record: lw.Record) -> lw.Record:
    values = record.values.copy()
    values[600:680] = np.nan
    return replace(record, values=values, simulated=None)


def _sparse(record: lw.Record, seed: int) -> lw.Record:
    values = record.values.copy()
    values[np.random.default_rng(seed).random(values.shape) < 0.1] = np.nan
    return replace(record, values=values, simulated=None)


def _continued(seed: int) -> lw.Record:
    record = replace(hit_chain(30.0, seed), simulated=None)
    return lw.records.continued(record[:900], record[1000:])


def _clipped(share: float, seed: int) -> lw.Estimate:
    whole = hit_chain(30.0, seed)
    peak = share * np.max(np.abs(whole.values), axis=0)
    overloaded = replace(whole, values=np.clip(whole.values, -peak, peak), simulated=None)
    return lw.identify(lw.inspection.mark_missing(overloaded), ALL)


def _changing(name: str, change: float, seed: int) -> lw.Estimate:
    record, _ = changing_record(CHAIN, name, change, seed)
    return lw.identify(record, ALL)


TWO_STOREYS = structure(
    {"m1": 1.0, "m2": 0.5},
    link("lower", "m1-base", "k*d + c*v", k=2000.0, c=1.0),
    link("upper", "m2-m1", HARDENING, k=1500.0, k3=4e6, c=0.5),
)
BASE = "0.004*sin(31*t) + 0.003*sin(47*t + 1) + 0.002*sin(71*t + 2) + 0.01*sin(9*t)"


def inputs() -> Table:
    """Moving bases, noisy and ambient forces, held forces."""
    relative, absolute = [("rel:x", "a:base"), ("rel:x", "v:base")], [("a", "a:base"), ("x", "x:base")]
    for sensors in (*relative, *absolute, ("rel:x:m1", "a:m2", "a:base")):
        subject = Subject(TWO_STOREYS, {"base": BASE}, rate=400.0, snr_db=40.0, sensors=sensors)
        slug = "-".join(sensors).replace(":", "")
        yield f"base/{slug}/ml", subject.identify
        if sensors[0] in ("rel:x", "a"):
            yield f"base/{slug}/input-noise/ml", replace(subject, options={"input_noise": "all"}).identify
    subject = Subject(TWO_STOREYS, {"base": BASE}, rate=400.0, snr_db=40.0, sensors=relative[0])
    yield "base/relx-abase/weak", partial(subject.identify, method="weak")
    yield "base/relx-abase/mass-unknown/ml", replace(subject, unknown=("all", "mass:m2")).identify
    for n in (1, 2):
        yield f"ambient/{n}/ml", partial(_ambient, n, 0.0, {"ambient": "all"})
        yield f"ambient/{n}/not-stated/ml", partial(_ambient, n, 0.0, {})
    yield "ambient/2/one-stated/ml", partial(_ambient, 2, 0.0, {"ambient": ["m1"]})
    yield "ambient/1/cubic/ml", partial(_ambient, 1, 2e6, {"ambient": "all"})
    for stated in ({"input_noise": "all"}, {"input_noise": {"force:m1": 0.1}}, {}):
        word = "found" if stated == {"input_noise": "all"} else "stated" if stated else "not-stated"
        yield f"load-cell/{word}/ml", partial(_load_cell, stated, True)
    yield "load-cell/found/not-held/ml", partial(_load_cell, {"input_noise": "all"}, False)
    duffing = oscillator(HARDENING, k=900.0, k3=2e5, c=2.0)
    forced = Subject(duffing, {"forces": {"m1": multisine(5.0, 70.0)}}, rate=200.0, snr_db=40.0)
    for name, stated in (
        ("gain", {"gains": ["force:m1"]}),
        ("calibration", {"calibration": {"force:m1": 0.01}}),
        ("delay", {"delays": ["force:m1"]}),
    ):
        yield f"forced/{name}/ml", replace(forced, options=stated).identify
    yield (
        "forced/mass-unknown/calibration/ml",
        replace(forced, unknown=("all", "mass:m1"), options={"calibration": {"force:m1": 0.01}}).identify,
    )


def _ambient(n: int, cubic: float, stated: Mapping[str, Any], seed: int) -> lw.Estimate:
    """Displacements in a white force of 1 N a sample on every mass."""
    rng, count = np.random.default_rng(seed), 1500
    forces = np.sqrt(SUBSTEPS) * rng.standard_normal(((STEADY + count) * SUBSTEPS, n))
    x = motion(forces, cubic)[STEADY:, :n]
    channels = tuple(f"x:m{i}" for i in range(1, n + 1))
    record = lw.Record(0.0, RATE, channels, x + NOISE * rng.standard_normal(x.shape))
    law = "k*d + c*v + k3*d**3" if cubic else "k*d + c*v"
    return lw.identify(record, linear_row(n, law).unknown("all"), **stated)


def _load_cell(stated: Mapping[str, Any], held: bool, seed: int) -> lw.Estimate:
    """Two masses, a force on the first of about 1 N that is held between its samples, whose channel has noise of 0.1 N."""
    rng, count = np.random.default_rng(seed), 1500
    applied = np.convolve(rng.standard_normal(count), np.ones(4) / 2.0, mode="same")
    forces = np.zeros((count * SUBSTEPS, 2))
    forces[:, 0] = np.repeat(applied, SUBSTEPS)
    x = motion(forces)[:, :2]
    columns = [x + 1e-5 * rng.standard_normal(x.shape), applied + 0.1 * rng.standard_normal(count)]
    record = lw.Record(0.0, RATE, ("x:m1", "x:m2", "force:m1"), np.column_stack(columns))
    if held:
        record = replace(record, interpolation={"force:m1": "held"})
    return lw.identify(record, linear_row(2).unknown("all"), **stated)


# ten seconds each
OF_SIX = ("none", "gain 5 %", "delay of 2 samples", "quintic left out", "hum -25 dB", "mass 10 % wrong")
ALSO_NOISY = ("none", "gain 1 %", "offset 5 %", "slow drift", "clipped at 80%", "5 samples lost", "delay of 0.5 samples",
              "low pass at 100 Hz", "8 bits", "jitter 30 %", "spikes", "force noisy at 20 dB", "damper left out",
              "quintic left out", "friction left out")  # fmt: skip
BY_DISCOVERY = ("none", "gain 5 %", "offset 50 %", "mass 10 % wrong", "quintic left out",
                "spring to ground left out", "force scaled 1.05", "AR(1) noise of 0.9")  # fmt: skip


def faults() -> Table:
    """The faults of the catalogue in the chain of two masses, and some in that of six."""

    def ask(fault: Fault, n: int, decibel: float, method: Any, seed: int) -> Any:
        test = make_test(fault, n, decibel, seed)
        record = fault.make(test)
        if method == "discover":
            given = {
                mass.name: mass.mass.value if mass.mass.known else "unknown" for mass in test.stated.masses
            }
            return lw.discover(record, given)
        if method == "inspect":
            return lw.inspect(record)
        return lw.identify(record, test.stated.unknown("all"), method=method)

    for fault in FAULTS:
        slug = fault.name.replace(", ", "-").replace(" %", "%").replace(" ", "-")
        if fault.name not in (
            "friction left out",
            "small friction left out",
        ):  # a minute, longer than all others
            yield f"fault/{slug}/2/40dB/ml", partial(ask, fault, 2, 40.0, "ml")
        if fault.name in ALSO_NOISY:
            yield f"fault/{slug}/2/20dB/ml", partial(ask, fault, 2, 20.0, "ml")
        if fault.name in ALSO_NOISY or fault.name in OF_SIX:
            yield f"fault/{slug}/2/40dB/weak", partial(ask, fault, 2, 40.0, "weak")
        if fault.name in OF_SIX:
            yield f"fault/{slug}/6/40dB/ml", partial(ask, fault, 6, 40.0, "ml")
        if fault.name in BY_DISCOVERY:
            yield f"fault/{slug}/2/40dB/discover", partial(ask, fault, 2, 40.0, "discover")
        if fault.alerts:
            yield f"fault/{slug}/2/40dB/inspect", partial(ask, fault, 2, 40.0, "inspect")


def masses(true: lw.Structure) -> dict[str, float]:
    return dict(zip(true.mass_names, true.mass_values.tolist(), strict=True))


def discoveries() -> Table:
    """Structures from masses alone, with rivals, memory, random forces, and terms that were not offered."""

    def chain(n: int, decibel: float, seed: int) -> lw.Discovery:
        record = chain_record(n, duration=3.0).with_noise(decibel, seed=seed)
        return lw.discover(record, masses(lw.bnes_chain(n)))

    for n, levels in {2: (10.0, 20.0, 40.0), 4: (20.0, 40.0), 6: (30.0,)}.items():
        for decibel in levels:
            yield f"discover/chain/{n}/{decibel:g}dB", partial(chain, n, decibel)
    frame = row_of_masses(
        [1.0, 0.5, 0.3],
        **{
            "m1-ground": ("k*d + k3*d**3 + c*v", {"k": 2e4, "k3": 1e7, "c": 1.0}),
            "m2-m1": ("k*d + c*v", {"k": 1.2e4, "c": 0.8}),
            "m3-m2": ("k*d + c*v", {"k": 9e3, "c": 0.5}),
        },
    )
    hit = Subject(frame, {"release": {"v:m1": 1.0}}, rate=1000.0, duration=2.0)
    for factor in (1.0, 0.99):
        stated = {**masses(frame), "m2": 0.5 * factor}
        yield f"discover/frame/mass-{factor:g}", partial(_discovered, hit, stated, {})
    yield (
        "discover/frame/calibration",
        partial(_discovered, hit, masses(frame), {"calibration": {"all": 0.01}}),
    )
    yield (
        "discover/frame/a",
        partial(_discovered, replace(hit, sensors=("a",), snr_db=40.0), masses(frame), {}),
    )
    for name, terms in (
        ("clearance", "linear, gap(0.008)"),
        ("smooth-friction", "linear, friction"),
        ("asymmetric", "quintic"),
        ("quadratic-damping", "cubic, quadratic-damping"),
    ):
        law, values = LAWS[name]
        drive = {"forces": {"m1": multisine(4.0, 60.0)}}
        subject = Subject(oscillator(law, **values), drive, rate=400.0, snr_db=40.0)
        yield f"discover/law/{name}", partial(_discovered, subject, {"m1": 1.0}, {"terms": terms})
    law, values = LAWS["asymmetric"]
    subject = Subject(oscillator(law, **values), drive, rate=400.0, snr_db=40.0)
    yield "discover/law/asymmetric/mass-unknown", partial(_discovered, subject, {"m1": "unknown"}, {})
    hysteretic = structure(
        {"m1": 1.0, "m2": 1.2},
        link("m1-ground", "m1-ground", "k*d + c*v", k=2000.0, c=1.0),
        named("m2-m1", "m2-m1", "bouc-wen", k=800.0, c=1.0, F=6.0, x0=0.004, s=0.6),
    )
    force = {"forces": {"m2": "9*sin(17*t) + 7*sin(31*t + 1) + 6*sin(53*t + 2)"}}
    subject = Subject(hysteretic, force, duration=4.0, rate=200.0, snr_db=40.0)
    yield "discover/memory/bouc-wen", partial(_discovered, subject, masses(hysteretic), {})
    for number in range(2):
        yield f"discover/wrong-offer/{number}", partial(_wrong_offer, number)
    base = Subject(TWO_STOREYS, {"base": BASE}, rate=400.0, snr_db=40.0, sensors=("x", "x:base"))
    yield "discover/base", partial(_discovered, base, masses(TWO_STOREYS), {})


def _discovered(
    subject: Subject, given: Mapping[str, Any], stated: Mapping[str, Any], seed: int
) -> lw.Discovery:
    return lw.discover(subject.record(seed), dict(given), **stated)


def _wrong_offer(number: int, seed: int) -> lw.Discovery:
    """A random tree with terms that no candidate has."""
    truth, record = wrong_offer(800_000 + number)
    return lw.discover(record.between(0.0, 8.0), masses(truth))


def others() -> Table:
    """Validation, absorption, limits and inspections."""

    def validate(change: float, model: bool, seed: int) -> lw.Validation:
        true = CHAIN.with_values({"nes1.alpha": -100.0 * change})
        answer = lw.identify(hit_chain(30.0, seed), ALL) if model else CHAIN
        fresh = lw.simulate(true, release={"v:m1": 0.8}, duration=2.0, rate=1000.0).with_noise(
            30.0, seed=seed + 1
        )
        return lw.validate(fresh, answer, refit=model)

    for change in (1.0, 1.02, 1.3):
        yield f"validate/alpha-{change:g}/estimate", partial(validate, change, True)
        yield f"validate/alpha-{change:g}/structure", partial(validate, change, False)
    drive: dict[str, Any] = {"duration": 2.0, "release": {"v:m1": 1.0}}
    for n in (2, 4):
        yield f"absorb/chain-{n}", partial(lambda n, seed: lw.absorb(lw.bnes_chain(n), **drive), n)
    yield "absorb/locked", lambda seed: lw.absorb(CHAIN, without="locked", **drive)
    yield "absorb/forced", lambda seed: lw.absorb(CHAIN, duration=2.0, forces={"m1": "20*sin(170*t)"})
    yield (
        "absorb/intervals",
        lambda seed: lw.absorption.absorption_intervals(
            lw.identify(hit_chain(30.0, seed), ALL), draws=20, workers=1, **drive
        ),
    )
    plan: dict[str, Any] = {"duration": 1.0, "rate": 1000.0, "release": {"v:m1": 1.0}}
    for sensors in ("x", "v", "a"):
        yield (
            f"limit/chain-2/{sensors}",
            partial(
                lambda sensors, seed: lw.limit(CHAIN, noise=30.0, unknown=["all"], sensors=[sensors], **plan),
                sensors,
            ),
        )
    yield "limit/chain-4/x", lambda seed: lw.limit(lw.bnes_chain(4), noise=30.0, unknown=["all"], **plan)
    yield (
        "limit/one-sensor",
        lambda seed: lw.limit(CHAIN, noise=30.0, unknown=["all", "mass:m2"], sensors=["x:m1"], **plan),
    )
    for decibel in (10.0, 40.0):
        yield (
            f"inspect/chain/{decibel:g}dB",
            partial(lambda decibel, seed: lw.inspect(hit_chain(decibel, seed)), decibel),
        )


def refusals() -> Table:
    """What is refused, and with which words."""
    nothing = {p.name: 0.0 for p in ALL.parameters}
    known = {
        "no-record": lambda seed: lw.identify([], ALL),
        "nothing-unknown": lambda seed: lw.identify(hit_chain(30.0, seed), CHAIN),
        "no-such-method": lambda seed: lw.identify(hit_chain(30.0, seed), ALL, method="strong"),  # type: ignore[arg-type]
        "no-such-option": lambda seed: lw.identify(hit_chain(30.0, seed), ALL, ofsets=()),  # type: ignore[call-arg]
        "options-of-ml": lambda seed: lw.identify(hit_chain(30.0, seed), ALL, method="weak", offsets=["x:m1"]),
        "no-such-channel": lambda seed: lw.identify(hit_chain(30.0, seed), ALL, gains=["x:m7"]),
        "same-record-twice": lambda seed: lw.identify([hit_chain(30.0, seed)] * 2, ALL),
        "masses-unknown": lambda seed: lw.identify(hit_chain(30.0, seed), CHAIN.unknown("all", "mass:m1", "mass:m2")),
        "needs-a-start": lambda seed: Subject(
            oscillator(LAWS["clearance"][0], **LAWS["clearance"][1]), {"release": {"v:m1": 1.0}}
        ).identify(seed),
        "channel-not-measured": lambda seed: lw.identify(hit_chain(30.0, seed).select(["x:m1"]), ALL, method="weak"),
        "short": lambda seed: lw.identify(hit_chain(30.0, seed)[:4], ALL),
        "at-rest": lambda seed: lw.identify(replace(hit_chain(30.0, seed), values=np.zeros((2001, 2)), simulated=None), ALL),
        "base-not-measured": lambda seed: lw.identify(
            Subject(TWO_STOREYS, {"base": BASE}, sensors=("x", "x:base"), shown=("x:m1", "x:m2")).record(seed),
            TWO_STOREYS.unknown("all"),
        ),
        "diverges": lambda seed: lw.simulate(oscillator("k*d", k=-100.0), release={"x:m1": 0.1}, duration=60.0, rate=100.0),
        "starts-of-zero": lambda seed: lw.identify(hit_chain(30.0, seed), ALL, starts=nothing),
        "discover-no-mass": lambda seed: lw.discover(hit_chain(30.0, seed), {"m1": 1.0}),
        "discover-mass-unknown": lambda seed: lw.discover(hit_chain(30.0, seed), {"m1": "unknown", "m2": "unknown"}),
        "discover-terms": lambda seed: lw.discover(hit_chain(30.0, seed), masses(CHAIN), terms="cubic(3)"),
        "law-text": lambda seed: lw.Law.parse("k*d + "),
        "structure-text": lambda seed: lw.parse_structure('name = "a"\n[[mass]]\nname = "m1"\n'),
    }  # fmt: skip
    for name, ask in known.items():
        yield f"refused/{name}", ask


def _table(*families: Callable[[], Table]) -> dict[str, Callable[[], Any]]:
    return {name: partial(ask, seed(name)) for family in families for name, ask in family()}


CASES = _table(
    discoveries, memory, measured_records, hosts, faults, inexact, chains, problems, low_signal, options, records, inputs,
    laws, rigs, rotations, others, refusals,
)  # fmt: skip
QUICK = (  # a minute and a half; some of each family
    "chain/*dB/x/weak", "chain/[26]/20dB/x/ml", "chain/10/40dB/x/ml", "chain/2/40dB/x/ml", "chain/2/30dB/?/ml",
    "chain/*/sindy", "problem/masses-unknown-a-force-applied/ml", "problem/base-moved/*", "problem/clearance/ml",
    "option/gain/ml",
    "option/calibration/ml", "option/delay/ml", "option/spikes-student/ml", "option/coefficient-within/ml",
    "fault/none/2/20dB/ml", "fault/gain-5%/2/40dB/ml", "fault/delay-of-2-samples/2/40dB/ml", "fault/mass-1%-wrong/2/40dB/ml",
    "fault/hum--25-dB/2/40dB/*", "fault/quintic-left-out/2/40dB/ml", "fault/force-delayed-2-samples/2/40dB/ml",
    "fault/force-noisy-at-40-dB/2/40dB/ml", "fault/clipped-at-80%/2/40dB/*", "inexact/quintic/5%/10s/*",
    "inexact/hysteresis/1%/10s/ml", "law/bistable/*", "law/smooth-friction/ml", "law/hardening/mass-unknown/*",
    "memory/bouc-wen/x/ml", "memory/zener/f/ml", "host/sink/ml", "host/modal-test/20dB", "host/cubic/*", "rig/bouc-wen",
    "rig/jenkins", "torsion/discs/ml", "base/a-abase/ml", "ambient/2/ml", "load-cell/found/ml", "record/two/ml",
    "record/gap/ml", "record/change-of-spring1.k-1%/ml", "measured/magnet-beam/ml", "measured/servo-axis/piece-2/ml",
    "discover/chain/[24]/20dB", "discover/frame/mass-0.99", "discover/base", "validate/alpha-1.3/estimate", "absorb/chain-2",
    "limit/chain-2/x", "refused/no-*",
)  # fmt: skip
