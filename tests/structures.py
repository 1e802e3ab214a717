"""The structures that tests work on: the few words that build them, and those that several tests share."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import linkwise as lw

Value = float | lw.Coefficient
States = Mapping[str, lw.model.LinkState | str]

NES = "alpha*d + beta*d**3 + c*v"
HARDENING = "k*d + k3*d**3 + c*v"

LAWS: dict[
    str, tuple[str, dict[str, float]]
] = {  # with every function that laws may have, and names that no program takes
    "cubic": ("alpha*d + beta*d**3 + c*v", {"alpha": -100.0, "beta": 1e6, "c": 0.02}),
    "friction": ("F*tanh(v/S) + k*d*abs(d) - 1e-3*sign(v)", {"F": 2.5, "S": 0.01, "k": 40.0}),
    "stops": ("k*max(d - g, 0) + k*min(d + g, 0) + c*v", {"k": 1e4, "g": 0.01, "c": 0.3}),
    "roots": ("k*sqrt(d) + p*(d/w)**1.5", {"k": 3.0, "p": 0.2, "w": 0.1}),
    "waves": ("F*sin(d/w)*cos(d/w)/(2 + exp(-d/w)) - c*v/(1 + (d/w)**2)**2", {"F": 7.0, "w": 0.02, "c": 1.5}),
    "clash": ("lambda_*d + np*v + force*d**3", {"lambda_": 3.0, "np": 2.0, "force": 5.0}),
    "constant": ("F", {"F": 1.25}),
    'a"""; import os #': ("k*d", {"k": 1.0}),
    "x'); system('rm')": ("k*d", {"k": 2.0}),
    "+1+1": ("k*d", {"k": 3.0}),
    "κ 1": ("κ*d", {"κ": 4.0}),
    "names": ("float*d + values*v + print*d**3", {"float": 5.0, "values": 6.0, "print": 7.0}),
}
MEMORY_STATES = {"z": "(v - s*abs(v)*z - (1 - s)*v*abs(z))/x0"}
MEMORY = {"k": 400.0, "c": 1.5, "F": 12.0, "s": 0.7, "x0": 0.02}


def coefficient(value: Value) -> lw.Coefficient:
    """A number, or what already is a coefficient."""
    return value if isinstance(value, lw.Coefficient) else lw.Coefficient.number(value)


def link(
    name: str, between: str, law: str | lw.Law, states: States | None = None, /, **values: Value
) -> lw.Link:
    """A link between "m2-m1" with its coefficients by name; those that are not given are unknown."""
    first, second = between.split("-")
    parsed = law if isinstance(law, lw.Law) else lw.Law.parse(law, states)
    given = {key: coefficient(value) for key, value in values.items()}
    unknown = dict.fromkeys(parsed.coefficients, lw.Coefficient.unknown())
    return lw.Link(name, (first, second), parsed, unknown | given)


def named(name: str, between: str, law: str, /, **values: Value) -> lw.Link:
    """A link with a law by its name, within the bounds that this has, between "m2-m1"."""
    first, second = between.split("-")
    given = {key: coefficient(value) for key, value in values.items()}
    return lw.model.named_law(law).link(name, (first, second), given)


def bodies(masses: Mapping[str, Value], rotations: Collection[str] = ()) -> tuple[lw.Mass, ...]:
    """Masses in kg by name; in kg m^2 those of `rotations`, which turn."""
    return tuple(
        lw.Mass(name, coefficient(value), "rad" if name in rotations else "m")
        for name, value in masses.items()
    )


def structure(
    masses: Mapping[str, Value],
    *links: lw.Link,
    hosts: Sequence[lw.Host] = (),
    name: str = "test",
    rotations: Collection[str] = (),
) -> lw.Structure:
    """Masses by name, as `bodies` takes them, and what links them."""
    return lw.Structure(name, bodies(masses, rotations), links, tuple(hosts))


def oscillator(
    law: str, *, mass: Value = 1.0, to: str = "ground", name: str = "link", **values: Value
) -> lw.Structure:
    """One mass on one link, to the ground unless `to` the base."""
    return structure({"m1": mass}, link(name, f"m1-{to}", law, **values), name="oscillator")


def asked_oscillator(law: str, mass: float | None = None, *, name: str = "spring") -> lw.Structure:
    """One mass on one link, of which all is unknown but, where it is given, the mass."""
    return oscillator(law, mass=lw.Coefficient.unknown() if mass is None else mass, name=name)


THREE_TONES = {"m1": "3*sin(25*t) + 2*sin(61*t) + 2*cos(90*t)"}
"""A force on `duffing`."""


def duffing(k: float = 900.0, k3: float = 2e6, c: float = 2.0) -> lw.Structure:
    """One mass on a spring that hardens, and a damper."""
    return oscillator(HARDENING, name="spring", k=k, k3=k3, c=c)


def row_of_masses(masses: Sequence[float], **links: tuple[str, Mapping[str, Value]]) -> lw.Structure:
    """Masses m1, m2, ... each on a link, by its law and coefficients, to the one before, and the first to the ground."""
    names = [f"m{k}" for k in range(1, len(masses) + 1)]
    joined = [
        link(name, f"{mass}-{below}", law, **values)
        for mass, below, (name, (law, values)) in zip(
            names, ["ground", *names[:-1]], links.items(), strict=True
        )
    ]
    return structure(dict(zip(names, masses, strict=True)), *joined, name="row")


def host(
    name: str,
    frequencies: Sequence[Value],
    damping: float | Sequence[Value],
    shapes: Mapping[str, Sequence[float]],
    between: Mapping[tuple[int, int], Value] | None = None,
    rotations: Sequence[str] = (),
) -> lw.Host:
    """A host by the frequencies of its modes in Hz, parts of critical damping, and the shapes of its points by mode.

    Damping `between` modes is in N s/m. The points of `rotations` turn.
    """
    parts: Sequence[Value] = [damping] * len(frequencies) if isinstance(damping, float) else damping
    modes = (
        lw.model.HostMode(
            coefficient(frequency),
            coefficient(part),
            {point: shape[r] for point, shape in shapes.items()},
            rotations=rotations,
        )
        for r, (frequency, part) in enumerate(zip(frequencies, parts, strict=True))
    )
    return lw.Host(name, tuple(modes), damping=between or {})


def with_links(subject: lw.Structure, *links: lw.Link) -> lw.Structure:
    """The structure with these links in place of those of their names, or else after its own."""
    new = {entry.name: entry for entry in links}
    kept = [new.pop(own.name, own) for own in subject.links]
    return replace(subject, links=(*kept, *new.values()))


CANTILEVER = (3.3, 20.6, 57.7)  # Hz, of a slender cantilever
CANTILEVER_SHAPES = {"tip": (3.2, -3.2, 3.2), "mid": (1.1, 2.3, 0.06), "root": (0.3, 1.5, 2.8)}
CANTILEVER_SINK = {"alpha": -200.0, "beta": 4e6, "c": 0.05}


def beam_of_one_mode(*links: lw.Link, damping: float = 0.005) -> lw.Structure:
    """A beam by its first mode, of 20 Hz, which is seen at the tip."""
    return structure({}, *links, hosts=[host("beam", [20.0], damping, {"tip": [1.0]})], name="beam")


def torsion_chain(*, turns: bool = True, sink: str = NES, **values: Value) -> lw.Structure:
    """Two discs on a shaft, the second on a bistable torsion spring; or masses on springs in the same numbers."""
    given = values or {"alpha": -4.0, "beta": 40.0, "c": 0.008}
    shaft = link("shaft", "disc1-ground", "k*d + c*v", k=400.0, c=0.5)
    spring = link("sink", "disc2-disc1", sink, **given)
    discs = {"disc1": 1.0, "disc2": 0.01}
    return structure(discs, shaft, spring, name="torsion chain", rotations=discs if turns else ())


def equal_sinks() -> lw.Structure:
    """The paper's chain of four masses, whose two sinks share alpha."""
    chain = lw.bnes_chain(4)
    second = chain.link("nes2")
    shared = {**second.coefficients, "alpha": lw.Coefficient.shared("nes1.alpha")}
    return with_links(chain, replace(second, coefficients=shared))


def hysteretic_oscillator(mass: Value = 1.0, to: str = "ground", /, **values: Value) -> lw.Structure:
    """One mass on a Bouc-Wen link, whose coefficients keep their bounds where they are made unknown."""
    return structure({"m1": mass}, named("joint", f"m1-{to}", "bouc-wen", **values), name="joint")


def harvester(
    mass: Value, to: str = "base", law: str = "piezo-harvester", /, **values: Value
) -> lw.Structure:
    """A mass on a link with a piezo that feeds a resistor: bistable, unless the law is "piezo"."""
    return structure({"m1": mass}, named("piezo", f"m1-{to}", law, **values), name="harvester")
