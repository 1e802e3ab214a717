"""Faults of sensors, loggers, applied forces, stated structures and laws, one in a record of the paper's chain at a time.

Each is a change of one `Test`: its record, or what a user states of the structure beside what is true.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

import linkwise as lw

DURATION, RATE = 6.0, 1000.0
SPEEDS = {2: 1.0, 6: 3.0}  # m/s, at which the paper releases the first mass


@dataclass(frozen=True, eq=False)
class Test:
    """A test of a chain: what is true, what a user states, the exact record and the noise to add in dB."""

    __test__ = False  # no test of pytest

    truth: lw.Structure
    stated: lw.Structure
    clean: lw.Record
    snr_db: float
    seed: int

    @property
    def sensor(self) -> str:
        """The channel with the fault: displacement of the last sink."""
        return f"x:m{self.truth.size}"

    def rng(self) -> np.random.Generator:
        return np.random.default_rng([self.seed, 20261122])

    def noise(self) -> np.ndarray:
        """(N, C) noise of the responses, of deviations `snr_db` below them; applied forces have none."""
        responses = np.array([not name.startswith("force:") for name in self.clean.channels])
        size = np.sqrt(np.mean(self.clean.values**2, axis=0)) * 10.0 ** (-self.snr_db / 20.0) * responses
        return np.asarray(size * np.random.default_rng([self.seed, 7]).normal(size=self.clean.values.shape))

    def measured(self, values: np.ndarray | None = None, noise: np.ndarray | None = None) -> lw.Record:
        """The record of `values` (N, C), those of the exact motion unless given, with noise."""
        exact = self.clean.values if values is None else values
        added = self.noise() if noise is None else noise
        return replace(self.clean, values=exact + added[: len(exact)], simulated=None)

    def changed(self, change: Change, channel: str | None = None, *, after_noise: bool = False) -> lw.Record:
        """The record in which one channel is what `change` makes of it, before the noise or after it."""
        record = self.measured() if after_noise else self.clean
        values = record.values.copy()
        column = self.clean.channels.index(channel or self.sensor)
        values[:, column] = change(values[:, column].copy(), self)
        return replace(record, values=values, simulated=None) if after_noise else self.measured(values)


Change = Callable[[np.ndarray, Test], np.ndarray]


@dataclass(frozen=True)
class Fault:
    """A fault: how it makes the record and what is stated from a test, and what may name it.

    `causes` are kinds of the diagnosis and `alerts` kinds of `inspect` that are right; `drive` is what moves the chain,
    "release" or "force"; `told` is False where no equation can tell the fault.
    """

    name: str
    make: Callable[[Test], lw.Record]
    causes: tuple[str, ...] = ()
    alerts: tuple[str, ...] = ()
    drive: str = "release"
    told: bool = True
    adds: tuple[tuple[str, tuple[str, str], str, dict[str, float]], ...] = ()
    lacks: Callable[[lw.Structure], lw.Structure] = field(default=lambda structure: structure)


def make_test(fault: Fault, masses: int, snr_db: float, seed: int) -> Test:
    """The test that `fault` is put into: the chain, with what is there and not stated."""
    stated = lw.bnes_chain(masses)
    truth = stated
    for link, between, law, values in fault.adds:
        truth = with_term(truth, link, between, law, values)
    drive: dict[str, object] = {"release": {"v:m1": SPEEDS[masses]}}
    if fault.drive == "force":
        drive = {"forces": {"m1": multisine(seed, 200.0 if masses == 2 else 600.0)}}
    clean = lw.simulate(truth, duration=DURATION, rate=RATE, **drive)  # type: ignore[arg-type]
    return Test(truth, fault.lacks(stated), clean, snr_db, seed)


def multisine(seed: int, size: float) -> str:
    """A force in N of ten lines from 5 to 60 Hz around the chain's lowest modes, as an expression of t."""
    rng = np.random.default_rng([seed, 3])
    lines = np.linspace(5.0, 60.0, 10) + rng.uniform(-2.0, 2.0, 10)
    phases = rng.uniform(0.0, 2.0 * np.pi, 10)
    amplitude = size / np.sqrt(len(lines))
    return " + ".join(
        f"{amplitude:.6f}*sin({2.0 * np.pi * line:.6f}*t + {phase:.6f})"
        for line, phase in zip(lines, phases, strict=True)
    )


def with_term(
    structure: lw.Structure, name: str, between: tuple[str, str], law: str, values: dict[str, float]
) -> lw.Structure:
    """The structure with a term added to a link, or with the link where there is none of that name."""
    given = {key: lw.Coefficient.number(value) for key, value in values.items()}
    if name not in {link.name for link in structure.links}:
        return replace(structure, links=(*structure.links, lw.Link(name, between, lw.Law.parse(law), given)))
    links = tuple(
        replace(
            link, law=lw.Law.parse(f"{link.law.text} + {law}"), coefficients={**link.coefficients, **given}
        )
        if link.name == name
        else link
        for link in structure.links
    )
    return replace(structure, links=links)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def at_times(values: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Samples of the motion at `times` in samples; at its ends the last ones are held."""
    spline = scipy.interpolate.CubicSpline(np.arange(len(values)), values)
    return np.asarray(spline(np.clip(times, 0.0, len(values) - 1.0)))


def one(change: Change, *, after_noise: bool = False) -> Callable[[Test], lw.Record]:
    return lambda test: test.changed(change, after_noise=after_noise)


def everywhere(change: Change) -> Callable[[Test], lw.Record]:
    """`change` in all responses, noise as it is."""

    def make(test: Test) -> lw.Record:
        columns = [
            change(column.copy(), test) if name.startswith("x:") else column
            for name, column in zip(test.clean.channels, test.clean.values.T, strict=True)
        ]
        return test.measured(np.column_stack(columns))

    return make


def on_force(change: Change) -> Callable[[Test], lw.Record]:
    return lambda test: test.changed(change, "force:m1")


def late(samples: float) -> Change:
    return lambda values, test: at_times(values, np.arange(len(values)) - samples)


def clipped(share: float) -> Change:
    return lambda values, test: np.clip(
        values, -share * np.max(np.abs(values)), share * np.max(np.abs(values))
    )


def lost(samples: int) -> Change:
    """Samples that a logger leaves out at an eighth of the record; what follows moves up, and the last are repeated."""
    return lambda values, test: np.concatenate(
        [
            values[: len(values) // 8],
            values[len(values) // 8 + samples :],
            values[-samples:],
        ]
    )


def repeated(samples: int) -> Change:
    return lambda values, test: np.concatenate(
        [
            values[: len(values) // 8],
            np.repeat(values[len(values) // 8], samples),
            values[len(values) // 8 : -samples],
        ]
    )


def sine(decibel: float) -> Change:
    size = np.sqrt(2.0) * 10.0 ** (decibel / 20.0)
    return lambda values, test: (
        values + size * rms(values) * np.sin(2 * np.pi * 50.02 * test.clean.time + 0.4)
    )


def low_pass(values: np.ndarray, test: Test) -> np.ndarray:
    return np.asarray(scipy.signal.sosfilt(scipy.signal.butter(2, 100.0, fs=RATE, output="sos"), values))


def high_pass(values: np.ndarray, test: Test) -> np.ndarray:
    return np.asarray(
        scipy.signal.sosfilt(scipy.signal.butter(1, 0.5, "high", fs=RATE, output="sos"), values)
    )


def smoothed(values: np.ndarray, test: Test) -> np.ndarray:
    return np.asarray(scipy.signal.sosfiltfilt(scipy.signal.butter(4, 100.0, fs=RATE, output="sos"), values))


def walk(values: np.ndarray, test: Test) -> np.ndarray:
    steps = np.cumsum(test.rng().normal(size=len(values)))
    return np.asarray(values + 0.1 * rms(values) * steps / np.sqrt(len(values)))


def held(values: np.ndarray, test: Test) -> np.ndarray:
    return np.asarray(np.repeat(values[::4], 4)[: len(values)])


def eight_bits(values: np.ndarray, test: Test) -> np.ndarray:
    step = 2.0 * np.max(np.abs(values)) / 256.0
    return np.asarray(step * np.round(values / step))


def spiked(values: np.ndarray, test: Test) -> np.ndarray:
    where = test.rng().choice(len(values), 6, replace=False)
    values[where] += 3.0 * rms(values)
    return values


def with_noise_of(draw: Callable[[np.random.Generator, int], np.ndarray]) -> Callable[[Test], lw.Record]:
    """Noise of unit power that `draw` makes in place of white noise in one sensor."""

    def make(test: Test) -> lw.Record:
        noise = test.noise()
        column = test.clean.channels.index(test.sensor)
        noise[:, column] = rms(noise[:, column]) * draw(test.rng(), len(noise))
        return test.measured(noise=noise)

    return make


def autoregressive(rng: np.random.Generator, samples: int) -> np.ndarray:
    white = rng.normal(size=samples + 100)
    return np.asarray(scipy.signal.lfilter([np.sqrt(1.0 - 0.9**2)], [1.0, -0.9], white)[100:])


def student(rng: np.random.Generator, samples: int) -> np.ndarray:
    return rng.standard_t(3.0, size=samples) / np.sqrt(3.0)


def jittered(share: float) -> Callable[[Test], lw.Record]:
    def make(test: Test) -> lw.Record:
        times = np.arange(len(test.clean.values)) + share * test.rng().normal(size=len(test.clean.values))
        return test.measured(np.column_stack([at_times(column, times) for column in test.clean.values.T]))

    return make


def other_rate(test: Test) -> lw.Record:
    return replace(test.measured(), rate=1.01 * RATE)


def decimated(test: Test) -> lw.Record:
    record = test.measured()
    return replace(record, rate=RATE / 8.0, values=record.values[::8])


def crosstalk(test: Test) -> lw.Record:
    values = test.clean.values.copy()
    values[:, test.clean.channels.index(test.sensor)] += (
        0.02 * values[:, test.clean.channels.index(f"x:m{test.truth.size - 1}")]
    )
    return test.measured(values)


def swapped(test: Test) -> lw.Record:
    record = test.measured()
    order = np.arange(len(record.channels))
    order[:2] = 1, 0
    return replace(record, values=record.values[:, order])


def without_force(test: Test) -> lw.Record:
    record = test.measured()
    shown = [number for number, name in enumerate(record.channels) if not name.startswith("force:")]
    return replace(
        record, channels=tuple(record.channels[number] for number in shown), values=record.values[:, shown]
    )


def noisy_force(decibel: float) -> Change:
    return lambda values, test: (
        values + 10.0 ** (-decibel / 20.0) * rms(values) * test.rng().normal(size=len(values))
    )


def plain(test: Test) -> lw.Record:
    return test.measured()


def heavier(factor: float) -> Callable[[lw.Structure], lw.Structure]:
    """A structure whose second mass is stated `factor` times too large."""

    def change(structure: lw.Structure) -> lw.Structure:
        masses = list(structure.masses)
        masses[1] = lw.Mass(masses[1].name, lw.Coefficient.number(factor * float(structure.mass_values[1])))
        return replace(structure, masses=tuple(masses))

    return change


def unknown_mass(structure: lw.Structure) -> lw.Structure:
    return structure.unknown("mass:m1")


def pushed(force: str) -> Callable[[Test], lw.Record]:
    """A force on the second mass that is not recorded, an expression of t."""

    def make(test: Test) -> lw.Record:
        drive = {"m2": force}
        record = lw.simulate(
            test.truth,
            release={"v:m1": SPEEDS[test.truth.size]},
            forces=drive,
            duration=DURATION,
            rate=RATE,
        )
        return without_force(replace(test, clean=record))

    return make


def shaken(test: Test) -> lw.Record:
    """A white force on the second mass that is not recorded."""
    force = lw.model.Sampled(0.0, RATE, 0.1 * test.rng().normal(size=round(DURATION * RATE) + 1))
    record = lw.simulate(
        test.truth,
        release={"v:m1": SPEEDS[test.truth.size]},
        forces={"m2": force},
        duration=DURATION,
        rate=RATE,
    )
    return without_force(replace(test, clean=record))


_SINK = ("nes1", ("m2", "m1"))
_ANY_SENSOR = ("gain", "offset", "drift", "delay", "crosstalk")
FAULTS = (
    Fault("none", plain),
    Fault("gain 1 %", one(lambda x, test: 1.01 * x), ("gain", "mass")),
    Fault("gain 5 %", one(lambda x, test: 1.05 * x), ("gain", "mass")),
    Fault("all gains 1 %", everywhere(lambda x, test: 1.01 * x), told=False),
    Fault("crosstalk 2 %", crosstalk, ("crosstalk", "gain")),
    Fault("offset 5 %", one(lambda x, test: x + 0.05 * rms(x)), ("offset",), ("offset",)),
    Fault("offset 50 %", one(lambda x, test: x + 0.5 * rms(x)), ("offset",), ("offset",)),
    Fault(
        "slow drift",
        one(lambda x, test: x + 0.1 * rms(x) * test.clean.time / DURATION),
        ("drift", "offset"),
        ("drift",),
    ),
    Fault("random walk", one(walk), ("drift", "offset"), ("drift", "coloured")),
    *(
        Fault(
            f"clipped at {share:.0%}",
            one(clipped(share), after_noise=True),
            ("clipped", "gain"),
            ("clipped",),
        )
        for share in (0.95, 0.8, 0.5)
    ),
    Fault("hum -25 dB", one(sine(-25.0)), (), ("hum",)),
    Fault("hum -40 dB", one(sine(-40.0)), (), ("hum",)),
    *(
        Fault(f"{count} samples lost", one(lost(count)), ("delay",), ("dropped", "delay"))
        for count in (1, 5, 60)
    ),
    *(
        Fault(f"{count} samples doubled", one(repeated(count)), ("delay",), ("doubled", "dropped", "delay"))
        for count in (1, 60)
    ),
    *(
        Fault(f"delay of {size:g} samples", one(late(size)), ("delay",), ("delay",))
        for size in (0.1, 0.5, 2.0)
    ),
    Fault("clock 1 % fast", other_rate, told=False),
    Fault(
        "clock drifts 200 ppm",
        one(lambda x, test: at_times(x, np.arange(len(x)) * (1.0 + 2e-4))),
        ("delay", "clock"),
        ("delay",),
    ),
    Fault("low pass at 100 Hz", one(low_pass), ("delay", "gain"), ("coloured", "delay")),
    Fault("low pass in all", everywhere(low_pass), ("filter", "delay", "gain"), ("coloured", "delay")),
    Fault("high pass at 0.5 Hz", one(high_pass), ("high pass", "drift", "offset", "delay"), ("drift",)),
    Fault("aliased by decimation", decimated, alerts=("aliasing", "few-samples", "coloured")),
    Fault("8 bits", one(eight_bits, after_noise=True), alerts=("quantised",)),
    Fault("jitter 10 %", jittered(0.1)),
    Fault("jitter 30 %", jittered(0.3)),
    Fault("mm for m", one(lambda x, test: 1e3 * x, after_noise=True), ("unit", "gain"), ("unit", "gain")),
    Fault("channels swapped", swapped, ("swapped", *_ANY_SENSOR)),
    Fault("samples held", one(held), ("delay",), ("doubled", "coloured", "delay")),
    Fault("smoothed without phase", one(smoothed, after_noise=True), (), ("coloured",)),
    Fault(
        "detrended",
        one(lambda x, test: np.asarray(scipy.signal.detrend(x)), after_noise=True),
        ("offset", "drift"),
        ("offset", "drift"),
    ),
    Fault("AR(1) noise of 0.9", with_noise_of(autoregressive), (), ("coloured",)),
    Fault("Student t noise", with_noise_of(student), (), ("spikes",)),
    Fault("spikes", one(spiked), (), ("spikes",)),
    Fault("force scaled 1.05", on_force(lambda f, test: 1.05 * f), ("force gain",), drive="force"),
    Fault(
        "force scaled 1.05, mass unknown",
        on_force(lambda f, test: 1.05 * f),
        ("force gain",),
        drive="force",
        told=False,
        lacks=unknown_mass,
    ),
    *(
        Fault(f"force delayed {size:g} samples", on_force(late(size)), ("force delay",), drive="force")
        for size in (0.1, 2.0)
    ),
    *(
        Fault(f"force noisy at {decibel:g} dB", on_force(noisy_force(decibel)), drive="force")
        for decibel in (40.0, 20.0)
    ),
    Fault("force held", on_force(late(0.5)), ("force delay",), drive="force"),
    Fault("force of wrong sign", on_force(lambda f, test: -f), ("sign", "force gain"), drive="force"),
    Fault("force not recorded", without_force, drive="force"),
    Fault("small force not recorded", pushed("0.05*sin(90*t)"), ("harmonic force",)),
    Fault("white force not recorded", shaken),
    Fault(
        "spring to ground left out",
        plain,
        ("link", "term"),
        adds=(("extra", ("m2", "ground"), "k*d", {"k": 20.0}),),
    ),
    Fault(
        "tiny link left out", plain, ("link", "term"), adds=(("extra", ("m2", "ground"), "k*d", {"k": 1.0}),)
    ),
    Fault(
        "damper left out", plain, ("link", "term"), adds=(("extra", ("m2", "ground"), "c*v", {"c": 0.02}),)
    ),
    Fault("mass 10 % wrong", plain, ("mass", "gain"), lacks=heavier(1.1)),
    Fault("mass 1 % wrong", plain, ("mass", "gain"), lacks=heavier(1.01)),
    Fault("quintic left out", plain, ("term",), adds=((*_SINK, "q*d**5", {"q": 1e9}),)),
    Fault("small quintic left out", plain, ("term",), adds=((*_SINK, "q*d**5", {"q": 1e8}),)),
    Fault("friction left out", plain, ("term",), adds=((*_SINK, "F*tanh(v/0.01)", {"F": 0.05}),)),
    Fault("small friction left out", plain, ("term",), adds=((*_SINK, "F*tanh(v/0.01)", {"F": 0.01}),)),
    Fault("preload left out", plain, ("term", "offset"), adds=((*_SINK, "P + 0*d", {"P": 0.2}),)),
    Fault("saturation left out", plain, ("term",), adds=((*_SINK, "S*tanh(d/0.01)", {"S": 0.5}),)),
)
"""The faults, that of none first."""
