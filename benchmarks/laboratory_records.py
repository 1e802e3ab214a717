"""Records with one fault of a laboratory each, by seed: a sensor or clock that is off, a force nobody recorded, an odd law.

Rigs are those of `input_rigs`, under a shaker, with the noise of their sensors and that of the force.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy
from input_rigs import Rig, rig

import linkwise as lw

G = 9.80665
SHARE = 1e-4  # of the peak of the force: its noise


@dataclass(frozen=True, eq=False)
class Faulty:
    """A record with a fault: what is `asked` of it, the `truth`, and the `fault` and the channel or mass that it is of."""

    truth: lw.Structure
    asked: lw.Structure
    record: lw.Record
    fault: str
    where: tuple[str, ...]
    size: float

    def names(self, cause: lw.estimates.Cause) -> bool:
        """Whether a cause is the fault."""
        kinds = _TOLD_AS.get(self.fault, (self.fault,))
        return cause.kind in kinds and (cause.where in self.where or self.fault in ("clock", "gain step"))

    def errors(self, fit: lw.Estimate) -> np.ndarray:
        """(p,) errors of the coefficients in standard errors."""
        names = [p.name for p in self.asked.parameters]
        places = [
            [p.name for p in fit.parameters].index(name) for name in names
        ]  # of an answer with a term beside them
        true = np.array([self.truth.coefficient(name).value for name in names], dtype=float)
        return np.asarray((fit.values[places] - true) / np.sqrt(fit.covariance.diagonal()[places]))


FINE = 8  # samples of the motion in one of a record whose clock runs apart


def _of_sensor(kind: str, seed: int, rng: np.random.Generator) -> tuple[Rig, str]:
    """A rig with a shaker with at least `two` responses where the fault needs them, and the channel that it falls on."""
    while True:
        made = rig(seed, "shaker", share=SHARE)
        responses = [str(name) for name in made.record.responses]
        enough = len(responses) > 1 or kind not in ("sign", "swapped")
        if enough and (kind != "high pass" or responses[0].startswith("a:")):
            return made, responses[int(rng.integers(len(responses)))]
        seed += 10_000


def of_sensor(kind: str, seed: int) -> Faulty:
    """A record with a "high pass" of 0.1 to 2 Hz, a "clock" of 50 to 500 ppm, a "sign", channels "swapped", or a "unit"."""
    rng = np.random.default_rng([seed, 4949])
    made, channel = _of_sensor(kind, seed, rng)
    record, truth = made.record, made.truth
    values, column = record.values.copy(), list(map(str, record.channels)).index(channel)
    where: tuple[str, ...] = (channel,)
    size = float("nan")
    match kind:
        case "high pass":
            size = float(np.exp(rng.uniform(np.log(0.1), np.log(2.0))))
            values[:, column] = scipy.signal.sosfilt(
                scipy.signal.butter(1, size, "high", fs=record.rate, output="sos"), values[:, column]
            )
        case "clock":
            size = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(50.0), np.log(500.0))))
            fine, noise = made.clean(FINE), values[:, column] - made.clean(1).values[:, column]
            motion = scipy.interpolate.CubicSpline(fine.time, fine.values[:, column])
            values[:, column] = motion(record.time * (1.0 + 1e-6 * size)) + noise
        case "sign":
            values[:, column] *= -1.0
        case "swapped":
            others = [place for place, name in enumerate(record.channels) if str(name) in record.responses]
            other = int(rng.choice([place for place in others if place != column]))
            values[:, [column, other]] = values[:, [other, column]]
            where = (channel, str(record.channels[other]))
        case "unit":
            size = float(rng.choice([1e3, 1e-3, *((G, 1.0 / G) if channel.startswith("a:") else ())]))
            values[:, column] *= size
    record = replace(record, values=values, simulated=None)
    return Faulty(truth, truth.unknown("all"), record, kind, where, size)


def with_machine(seed: int) -> Faulty:
    """A chain on which a machine turns that no channel shows, four sizes, in and off resonance, alone or beside a shaker."""
    rng = np.random.default_rng([seed, 4950])
    made = rig(seed, "shaker", share=SHARE)
    truth, rate, duration = made.truth, 250.0, float(rng.uniform(6.0, 12.0))
    k, m = truth.links[0].values, truth.mass_values[0]
    own = float(np.sqrt(abs(k.get("k", k.get("alpha"))) / m) / (2.0 * np.pi))
    hz = own * float(rng.uniform(0.97, 1.03) if rng.random() < 0.5 else rng.choice([0.55, 1.6]))
    fine = np.arange(round(duration * rate * 4) + 1) / (4.0 * rate)
    scale = 3e-3 * truth.links[0].values["k"]
    size = scale * float(rng.choice([0.01, 0.03, 0.1, 0.3]))
    turning = size * np.cos(2.0 * np.pi * hz * fine + float(rng.uniform(0.0, 2.0 * np.pi)))
    shaken = rng.random() < 0.5
    drive = np.zeros(len(fine))
    if shaken:
        sections = scipy.signal.butter(4, [1.0, 20.0], "band", fs=4.0 * rate, output="sos")
        drive = scipy.signal.sosfiltfilt(sections, rng.standard_normal(len(fine)))
        drive *= 0.3 * scale / drive.std()
    release = {} if shaken else {"x:m1": 3e-3}
    clean = lw.simulate(
        truth,
        duration=duration,
        rate=rate,
        release=release,
        forces={"m1": lw.model.Sampled(0.0, 4.0 * rate, drive + turning)},
    )
    record = clean.with_noise(float(rng.uniform(30.0, 50.0)), seed=seed)
    values = record.values.copy()
    shown = [place for place, name in enumerate(record.channels) if not name.is_force or shaken]
    for place, name in enumerate(record.channels):
        if name.is_force:
            values[:, place] = drive[::4][: len(values)]
    names = tuple(record.channels[place] for place in shown)
    record = lw.Record(record.start, record.rate, names, values[:, shown])
    return Faulty(truth, truth.unknown("all"), record, "harmonic force", ("m1",), hz)


_WELL = "alpha*d + beta*d**3 + c*v"


def asymmetric_well(seed: int) -> Faulty:
    """A bistable sink, on its own or on an oscillator, with q*d**2 of 1 to 10 % of its force at a well, asked without it."""
    rng = np.random.default_rng([seed, 4951])
    host = rng.random() < 0.5
    m1, m2 = float(rng.uniform(1.0, 3.0)), float(rng.uniform(0.1, 0.5))
    carried, name = (m2, "m2") if host else (m1, "m1")
    well = float(rng.uniform(3e-3, 1e-2))
    soft = carried * (2.0 * np.pi * float(rng.uniform(2.0, 5.0))) ** 2
    q = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.01), np.log(0.1)))) * soft / well
    c = 2.0 * float(rng.uniform(0.005, 0.03)) * np.sqrt(soft * carried)
    sink = {"alpha": -soft, "beta": soft / well**2, "c": c}
    k = m1 * (2.0 * np.pi * float(rng.uniform(3.0, 8.0))) ** 2
    spring = {"k": k, "c": 0.02 * np.sqrt(k * m1)}

    def structure(law: str, values: dict[str, float]) -> lw.Structure:
        links = [("host", ("m1", "ground"), "k*d + c*v", spring)] if host else []
        links.append(("sink", (name, "m1" if host else "ground"), law, values))
        return lw.Structure(
            "wells",
            tuple(
                lw.Mass(mass, lw.Coefficient.number(value))
                for mass, value in {"m1": m1, **({"m2": m2} if host else {})}.items()
            ),
            tuple(
                lw.Link(
                    named,
                    ends,
                    lw.Law.parse(text),
                    {key: lw.Coefficient.number(value) for key, value in given.items()},
                )
                for named, ends, text, given in links
            ),
        )

    truth = structure(_WELL + " + q*d**2", {**sink, "q": q})
    speed = float(rng.uniform(0.5, 1.6)) * well * np.sqrt(k / m1 if host else soft / m1)
    clean = lw.simulate(
        truth,
        duration=float(rng.uniform(2.0, 6.0)),
        rate=500.0,
        release={f"x:{name}": well, "v:m1": speed},
        sensors=(["x", "a"][int(rng.integers(2))],),
    )
    record = clean.with_noise(float(rng.uniform(20.0, 50.0)), seed=seed)
    return Faulty(truth, structure(_WELL, sink).unknown("all"), record, "term", ("sink",), q)


SMALL = ("none", "gain step", "gain drift", "nonlinearity", "quintic", "quadratic damping")
_TOLD_AS = {  # kinds of causes
    "gain step": ("event", "gain drift", "change"),
    "quintic": ("term",),
    "quadratic damping": ("term",),
}


def _oscillators(rng: np.random.Generator) -> lw.Structure:
    """A chain of one or two masses with cubic springs from the ground."""
    masses, links, below = [float(rng.uniform(1.0, 3.0)), float(rng.uniform(0.2, 1.0))], [], "ground"
    for number, mass in enumerate(masses[: int(rng.integers(1, 3))], start=1):
        k = mass * (2.0 * np.pi * float(rng.uniform(4.0, 12.0))) ** 2
        c = 2.0 * float(rng.uniform(0.003, 0.02)) * np.sqrt(k * mass)
        law, values = (
            "k*d + k3*d**3 + c*v",
            {"k": k, "k3": float(rng.uniform(0.05, 0.5)) * k / 5e-3**2, "c": c},
        )
        links.append(lw.Link(f"s{number}", (f"m{number}", below), lw.Law.parse(law), values))
        below = f"m{number}"
    named = (lw.Mass(f"m{i}", lw.Coefficient.number(m)) for i, m in enumerate(masses[: len(links)], start=1))
    return lw.Structure("oscillators", tuple(named), tuple(links))


def with_small_fault(kind: str, seed: int) -> Faulty:
    """Oscillators in decay or on a shaker that the laws as asked nearly explain, with one of the `SMALL` faults.

    The gain of a channel steps or drifts by 1 to 5 %; a sensor has a cubic part of 1 % at the peak; a link lacks a quintic of
    3 % of its force at the peak, or a quadratic damping of 1 %.
    """
    rng = np.random.default_rng([seed, 4952])
    structure = truth = _oscillators(rng)
    rate, duration, shaken = 500.0, float(rng.uniform(2.0, 8.0)), bool(rng.random() < 0.4)
    sensor, name = "xva"[int(rng.integers(3))], f"s{int(rng.integers(truth.size)) + 1}"
    drive: dict[str, object] = {"release": {"x:m1": float(rng.uniform(3e-3, 8e-3))}}
    if shaken:
        sections = scipy.signal.butter(4, [1.0, 20.0], "band", fs=4.0 * rate, output="sos")
        force = scipy.signal.sosfiltfilt(sections, rng.standard_normal(round(4.0 * rate * duration) + 1))
        size = 2e-3 * structure.links[0].values["k"] / force.std()
        drive = {"forces": {"m1": lw.model.Sampled(0.0, 4.0 * rate, size * force)}}

    def run(what: lw.Structure, sensors: tuple[str, ...]) -> lw.Record:
        return lw.simulate(what, duration=duration, rate=rate, sensors=sensors, **drive)

    if kind in ("quintic", "quadratic damping"):
        motion = run(structure, ("x", "v"))
        link = next(link for link in structure.links if link.name == name)
        d, v = (
            motion.channel(f"{what}:{link.between[0]}")
            - (0.0 if link.between[1] == "ground" else motion.channel(f"{what}:{link.between[1]}"))
            for what in "xv"
        )
        peak = float(np.abs(link.values["k"] * d + link.values["k3"] * d**3).max())
        share, term, most = (
            (0.03, "d**5", np.abs(d).max() ** 5)
            if kind == "quintic"
            else (0.01, "v*abs(v)", np.abs(v).max() ** 2)
        )
        law = lw.Law.parse(f"{link.law} + q*{term}")
        wider = replace(link, law=law, coefficients={**link.values, "q": share * peak / float(most)})
        truth = replace(truth, links=tuple(wider if one is link else one for one in structure.links))
    clean = run(truth, (sensor,))
    channel = f"{sensor}:m{int(rng.integers(truth.size)) + 1}"
    values, column = clean.values.copy(), list(map(str, clean.channels)).index(channel)
    shown, elapsed = values[:, column], (clean.time - clean.start) / clean.duration
    size = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.01, 0.05))
    match kind:
        case "gain step":
            values[:, column] = shown * (1.0 + size * (elapsed > rng.uniform(0.2, 0.8)))
        case "gain drift":
            values[:, column] = shown * (1.0 + size * elapsed)
        case "nonlinearity":
            values[:, column] = shown * (1.0 + 0.01 * (shown / np.abs(shown).max()) ** 2)
    record = replace(clean, values=values, simulated=None).with_noise(
        float(rng.uniform(30.0, 50.0)), seed=seed
    )
    where = (name,) if kind in ("quintic", "quadratic damping") else (channel,)
    return Faulty(truth, structure.unknown("all"), replace(record, simulated=None), kind, where, size)
